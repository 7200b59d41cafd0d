"""A client of Channel Access in octets of its own (CA protocol specification 1.6), and a connector over literal items.

Nothing of caproto: the header is command, payload size, type, count, and two parameters.
"""

from __future__ import annotations

import asyncio
import contextlib
import struct
from collections.abc import AsyncIterator
from typing import Any, Final, NamedTuple

from dpstack.bridge.epics.connector import EpicsConnector
from dpstack.bridge.orders import Orders
from dpstack.errors import UsageError
from dpstack.plant.orders import DriveOrder, RefusedOrder, SetOutputs
from dpstack.plant.tree import PlantTree
from dpstack.tcp_address import Listen
from dpstack.trace import Severity

HEADER: Final = struct.Struct(">HHHHII")
VERSION, EVENT_ADD, EVENT_CANCEL, WRITE, SEARCH, EVENTS_OFF, EVENTS_ON, ERROR, CLEAR, NOT_FOUND, READ = (
    0, 1, 2, 4, 6, 8, 9, 11, 12, 14, 15,
)  # fmt: skip
CREATE, WRITE_NOTIFY, USER, HOST, ACCESS, ECHO, CREATE_FAIL, SERVER_DISCONN = 18, 19, 20, 21, 22, 23, 26, 27
STRING, INT, ENUM, CHAR, LONG, DOUBLE = 0, 1, 3, 4, 5, 6
TIME: Final = 14
CTRL_DOUBLE, CTRL_ENUM, PUT_ACKS = 34, 31, 36
#: severities (alarm.h of EPICS base), and some statuses
NO_ALARM, MINOR, MAJOR, INVALID = 0, 1, 2, 3
READ_ALARM, STATE_ALARM, COMM_ALARM, TIMEOUT_ALARM, UDF_ALARM = 1, 7, 9, 10, 17
PUTFAIL, NOWTACCESS, NOCONVERT = 160, 376, 400  # caerr.h
#: of EPICS times
EPOCH: Final = 631_152_000
STARTED: Final = 1_700_000_000.0
FINE: Final[dict[str, Any]] = {
    "state": "data_exchange", "inputs_valid": True, "inputs_age_ms": 1.0, "inputs_limit_ms": 100.0,
}  # fmt: skip
VALVES: Final[dict[str, Any]] = {
    "name": "valves",
    "inputs": [{"name": "level", "at": "i16@0", "scale": 0.1, "unit": "mbar abs"}, {"name": "count", "at": "u32@2"}],
    "outputs": [
        {"name": "lamp", "at": "bool@0.0"},
        {"name": "flow", "at": "u16@1"},
        {"name": "horn", "at": "bool@0.1"},
    ],
}
HOIST: Final[dict[str, Any]] = {"name": "hoist", "drive": {"profile": "profidrive", "telegram": "PPO1"}}


#: value, status, severity, time
Timed = tuple[Any, ...]


class Message(NamedTuple):
    command: int
    type: int
    elements: int
    first: int
    second: int
    payload: bytes


class Channel(NamedTuple):
    sid: int
    type: int
    elements: int
    rights: int


class Client:
    """One connection. Puts and reads wait for their answer; other messages meanwhile are kept in ``seen``."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer
        self.seen: list[Message] = []
        self._number = 0

    def send(
        self, command: int, *, type_: int = 0, count: int = 0, first: int = 0, second: int = 0, payload: bytes = b""
    ) -> None:
        payload += bytes(-len(payload) % 8)
        self.writer.write(HEADER.pack(command, len(payload), type_, count, first, second) + payload)

    async def next(self) -> Message:
        async with asyncio.timeout(20):
            command, size, type_, count, first, second = HEADER.unpack(await self.reader.readexactly(16))
            return Message(command, type_, count, first, second, await self.reader.readexactly(size))

    async def answer(self, *commands: int) -> Message:
        """The next message with one of ``commands``."""
        while True:
            for number, one in enumerate(self.seen):
                if one.command in commands:
                    return self.seen.pop(number)
            self.seen.append(await self.next())

    async def channel(self, name: str) -> Channel | None:
        self._number += 1
        self.send(CREATE, first=self._number, second=13, payload=name.encode() + b"\0")
        made = await self.answer(CREATE, CREATE_FAIL)
        if made.command == CREATE_FAIL:
            return None
        rights = await self.answer(ACCESS)
        assert rights.first == made.first == self._number
        return Channel(made.second, made.type, made.elements, rights.second)

    async def found(self, name: str) -> Channel:
        made = await self.channel(name)
        assert made is not None, name
        return made

    async def read(self, name: str, type_: int) -> Message:
        channel = await self.found(name)
        self.send(READ, type_=type_, count=0, first=channel.sid, second=7)
        return await self.answer(READ)

    async def timed(self, name: str) -> Timed:
        """Value, status, severity, time of a variable."""
        channel = await self.found(name)
        self.send(READ, type_=TIME + channel.type, first=channel.sid, second=7)
        return timed(channel.type, await self.answer(READ))

    async def put(self, name: str, type_: int, value: Any, *, count: int = 1) -> Message:
        """The answer to a put: WRITE_NOTIFY, or ERROR with the reason."""
        channel = await self.found(name)
        payload = packed(type_, value)
        self.send(WRITE_NOTIFY, type_=type_, count=count, first=channel.sid, second=9, payload=payload)
        return await self.answer(WRITE_NOTIFY, ERROR)

    async def monitor(self, channel: Channel, number: int, mask: int = 5) -> None:
        payload = struct.pack(">fffHH", 0, 0, 0, mask, 0)
        self.send(EVENT_ADD, type_=TIME + channel.type, first=channel.sid, second=number, payload=payload)

    async def update(self, type_: int) -> Timed:
        return timed(type_, await self.answer(EVENT_ADD))


def packed(type_: int, value: Any) -> bytes:
    if type_ == STRING:
        return str(value).encode() + b"\0"
    return struct.pack(">" + {ENUM: "H", INT: "h", LONG: "i", DOUBLE: "d"}[type_], value)


def timed(type_: int, message: Message) -> Timed:
    status, severity, seconds, nanoseconds = struct.unpack_from(">HHII", message.payload)
    rest = message.payload[12:]
    value: Any
    if type_ == STRING:
        value = rest[:40].partition(b"\0")[0].decode()
    elif type_ == ENUM:
        value = struct.unpack_from(">xxH", rest)[0]
    elif type_ == LONG:
        value = struct.unpack_from(">i", rest)[0]
    elif type_ == CHAR:
        value = rest[3 : 3 + message.elements]
    else:
        value = struct.unpack_from(">xxxxd", rest)[0]
    return value, status, severity, EPOCH + seconds + nanoseconds / 1e9


def reason(message: Message) -> tuple[int, str]:
    """Status and words of an ERROR."""
    assert message.command == ERROR
    return message.second, message.payload[16:].rstrip(b"\0").decode()


class Rig:
    """``given``: the orders that reached the run; one of 4000 to `flow` is refused by it."""

    def __init__(self, allow: tuple[str, ...] = ("valves.lamp", "valves.flow", "hoist.*"), host: str = "127.0.0.1",
                 **more: Any) -> None:  # fmt: skip
        self.given: list[SetOutputs | DriveOrder] = []
        self.told: list[str] = []
        self.refused: list[RefusedOrder] = []
        self.tree = PlantTree()
        orders = Orders(self.tree, self._carry_out, allow, refused=self.refused.append, origin="epics")
        self.connector = EpicsConnector(self.tree, self._tell, Listen.parse(f"{host}:0", "[epics] listen"), "DP:",
                                        orders, **more)  # fmt: skip
        self.t = 0.0
        self.slaves: dict[str, dict[str, Any]] = {"8": VALVES, "9": HOIST}
        self.values: dict[str, dict[str, Any]] = {
            "8": FINE | {"fields": {"level": 55, "count": 4_000_000_000, "lamp": False, "flow": 7, "horn": False}},
            "9": FINE | {"drive": {"state": "ready", "setpoint": 0.0, "running": False, "faults": [], "warnings": []}},
        }

    def _tell(self, text: str, severity: Severity) -> None:
        self.told.append(text)

    async def _carry_out(self, order: SetOutputs | DriveOrder) -> None:
        if isinstance(order, SetOutputs):
            if order.values.get("flow") == 4000:
                raise UsageError("the run refuses 4000")
            self.show("8", self.values["8"] | {"fields": self.values["8"]["fields"] | dict(order.values)})
        elif order.operation == "speed":
            self.show("9", self.values["9"] | {"drive": self.values["9"]["drive"] | {"setpoint": order.value}})
        else:
            for delay in (0.02, 0.05):
                asyncio.get_running_loop().call_later(delay, self.snapshot)
        self.given.append(order)

    def plant(self) -> None:
        plant = {"started": STARTED, "baud": 500_000, "port": "virtual", "read_only": False, "slaves": self.slaves}
        self.connector.take(self.tree.apply({"plant": plant}, self.t))

    def snapshot(self) -> None:
        self.t += 0.1
        item = {"t": self.t, "whole": True, "bus": {"stale": False, "mode": "operate"}, "slaves": self.values}
        self.connector.take(self.tree.apply({"snapshot": item}, self.t))

    def show(self, address: str, values: dict[str, Any]) -> None:
        """The slave has these values from now on."""
        self.values[address] = values
        self.snapshot()

    def end(self, text: str = "the bus has ended") -> None:
        self.connector.take(self.tree.apply({"end": {"text": text, "failed": False}}, self.t))

    @contextlib.asynccontextmanager
    async def serving(self) -> AsyncIterator[asyncio.Task[None]]:
        from far_ends import beside  # here: the fuzz target begins without the kits

        try:
            await self.connector.open()
            self.plant()
            self.snapshot()
            async with beside(self.connector.serve()) as task:
                await asyncio.sleep(0.01)
                yield task
        finally:
            self.connector.close()

    @contextlib.asynccontextmanager
    async def client(self) -> AsyncIterator[Client]:
        reader, writer = await asyncio.open_connection("127.0.0.1", self.connector.port)
        client = Client(reader, writer)
        client.send(VERSION, type_=0, count=13)
        client.send(HOST, payload=b"lab7\0")
        client.send(USER, payload=b"anna\0")
        version = await client.next()
        assert (version.command, version.elements) == (VERSION, 13)
        try:
            yield client
        finally:
            writer.transport.abort()
