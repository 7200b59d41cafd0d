"""An OPC UA connector over literal items of a plant: a server on a free port, with users, and clients of asyncua."""

from __future__ import annotations

import asyncio
import contextlib
import functools
from collections.abc import AsyncIterator, Callable
from datetime import timedelta
from pathlib import Path
from typing import Any, Final

from asyncua import Client, ua
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import NameOID
from far_ends import beside, until

from dpstack.bridge.opcua.certificate import utc_now
from dpstack.bridge.opcua.connector import OpcUaConnector, OpcUaSettings
from dpstack.bridge.opcua.users import hash_password
from dpstack.bridge.orders import Orders
from dpstack.errors import UsageError
from dpstack.plant.orders import DriveOrder, RefusedOrder, SetOutputs
from dpstack.plant.tree import PlantTree
from dpstack.trace import Severity

#: a key is proved by computing when it is read, 50 ms each time: of the few of these tests once
setattr(serialization, "load_pem_private_key", functools.cache(serialization.load_pem_private_key))  # noqa: B010

ANNA, BOB = ("anna", "secret of anna"), ("bob", "secret of bob")
ALLOWED: Final = ("valves.lamp", "valves.flow", "hoist.start", "hoist.stop", "hoist.speed")
FINE: Final[dict[str, Any]] = {
    "state": "data_exchange", "inputs_valid": True, "inputs_age_ms": 1.0, "inputs_limit_ms": 100.0,
}  # fmt: skip


class Rig:
    """``given``: the orders that reached the run; one to `flow` above 1000 is refused by it."""

    def __init__(self, folder: Path, **settings: Any) -> None:
        users = folder / "users"
        users.write_text("".join(f"{name} {right} {hash_password(password)}\n"
                                 for (name, password), right in ((ANNA, "control"), (BOB, "read"))))  # fmt: skip
        users.chmod(0o600)
        self.folder = folder
        self.given: list[SetOutputs | DriveOrder] = []
        self.told: list[str] = []
        self.tree = PlantTree()
        #: the orders that were refused
        self.refused: list[RefusedOrder] = []
        orders = Orders(self.tree, self._carry_out, ALLOWED, refused=self.refused.append, origin="opcua")
        made: dict[str, Any] = {"users_file": users, "anonymous": True, "lock": folder / "lock"} | settings
        chosen = OpcUaSettings("127.0.0.1:0", "plant", folder / "own" / "c.der", folder / "own" / "k.pem", **made)
        self.connector = OpcUaConnector(self.tree, self._tell, chosen, orders)
        self.t = 0.0
        #: a start goes on when this is set
        self.slow = asyncio.Event()
        self.starting = False
        self.slaves: dict[str, dict[str, Any]] = {"8": VALVES, "9": HOIST}
        self.values: dict[str, dict[str, Any]] = {
            "8": FINE | {"fields": {"level": 5.5, "lamp": False, "flow": 7}},
            "9": FINE | {"drive": {"state": "ready", "running": False, "speed": 0.25, "faults": []}},
        }

    def _tell(self, text: str, severity: Severity) -> None:
        self.told.append(text)

    async def _carry_out(self, order: SetOutputs | DriveOrder) -> None:
        if isinstance(order, DriveOrder) and order.operation == "start":
            self.starting = True
            await self.slow.wait()
            self.starting = False
        if isinstance(order, SetOutputs) and order.values.get("flow") == 4000:
            raise UsageError("the run refuses 4000")
        self.given.append(order)

    def plant(self) -> None:
        plant = {"started": 1_700_000_000.0, "baud": 500_000, "port": "virtual", "read_only": False}
        self.connector.take(self.tree.apply({"plant": plant | {"slaves": self.slaves}}, self.t))

    def snapshot(self) -> None:
        self.t += 0.1
        item = {"t": self.t, "whole": True, "bus": {"stale": False, "mode": "operate"}, "slaves": self.values}
        self.connector.take(self.tree.apply({"snapshot": item}, self.t))

    def show(self, address: str, values: dict[str, Any]) -> None:
        """The slave has these values from now on."""
        self.values[address] = values
        self.snapshot()

    @contextlib.asynccontextmanager
    async def serving(self) -> AsyncIterator[Rig]:
        await self.connector.open()
        self.plant()
        self.snapshot()
        try:
            async with beside(self.connector.serve()):
                await self.until(lambda: "slave/9/drive/settings" in self.ids())
                yield self
        finally:
            self.connector.close()

    def ids(self) -> set[object]:
        assert self.connector._space is not None
        return {one.Identifier for one in self.connector._space.values}

    async def until(self, found: Callable[[], object]) -> None:
        await until(found)

    def client(self, user: tuple[str, str] | None = None, *, days: int = 30) -> Client:
        cert, key = make_certificate(self.folder, days)
        client = Client(f"opc.tcp://127.0.0.1:{self.connector.port}", timeout=10)
        client.application_uri = "urn:client"
        self.security = f"Basic256Sha256,SignAndEncrypt,{cert},{key}"
        if user is not None:
            client.set_user(user[0])
            client.set_password(user[1])
        return client

    @contextlib.asynccontextmanager
    async def connected(self, user: tuple[str, str] | None = None, *, days: int = 30) -> AsyncIterator[Client]:
        client = self.client(user, days=days)
        await client.set_security_string(self.security)
        async with client:
            yield client


VALVES: Final[dict[str, Any]] = {
    "name": "valves",
    "inputs": [{"name": "level", "type": "i16", "at": "i16@0", "unit": "mm", "scale": 0.1}],
    "outputs": [
        {"name": "lamp", "type": "bool", "at": "bool@0.0"},
        {"name": "flow", "type": "u16", "at": "u16@1"},
        {"name": "horn", "type": "bool", "at": "bool@0.1"},
        {"name": "a/b.c<d>:#!&\u202e", "type": "u8", "at": "u8@3"},
    ],
}
HOIST: Final[dict[str, Any]] = {"name": "hoist", "drive": {"profile": "vik-namur", "telegram": "1"}}


def id_of(text: str) -> ua.NodeId:
    return ua.NodeId(text, 2)


def make_certificate(folder: Path, days: int) -> tuple[Path, Path]:
    """A client's certificate that is valid for ``days`` more; below 0 it has expired."""
    cert, key = folder / f"client{days}.der", folder / f"client{days}.pem"
    if cert.exists():
        return cert, key
    private = rsa.generate_private_key(public_exponent=65537, key_size=2048)
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "client")])
    now = utc_now()
    usage = x509.KeyUsage(True, True, True, True, False, True, False, False, False)
    made = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(private.public_key())
        .serial_number(7)
        .not_valid_before(now - timedelta(days=60))
        .not_valid_after(now + timedelta(days=days))
        .add_extension(x509.SubjectAlternativeName([x509.UniformResourceIdentifier("urn:client")]), critical=False)
        .add_extension(usage, critical=True)
        .sign(private, hashes.SHA256())
    )
    cert.write_bytes(made.public_bytes(serialization.Encoding.DER))
    key.write_bytes(
        private.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )
    )
    return cert, key


def item(
    node: ua.NodeId,
    attribute: ua.AttributeIds = ua.AttributeIds.Value,
    filter_: object = None,
    *,
    handle: int = 1,
    queue: int = 10,
) -> ua.MonitoredItemCreateRequest:
    """A request to report what ``node`` has."""
    how = ua.MonitoringParameters(handle, 0.0, filter_, queue)
    return ua.MonitoredItemCreateRequest(ua.ReadValueId(node, attribute), ua.MonitoringMode.Reporting, how)


async def subscribed(
    client: Client, *items: ua.MonitoredItemCreateRequest, took: Callable[[Any], object] = lambda _: None
) -> tuple[int, list[ua.MonitoredItemCreateResult]]:
    """A new subscription with ``items``, whose messages ``took`` gets: its number, and the results for the items."""
    params = ua.CreateSubscriptionParameters(100.0, 600, 10, 0, True)
    number = (await client.uaclient.create_subscription(params, took)).SubscriptionId
    create = ua.CreateMonitoredItemsParameters(number, ua.TimestampsToReturn.Both, list(items))
    return number, await client.uaclient.create_monitored_items(create) if items else []
