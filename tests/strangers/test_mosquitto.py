"""The connector of MQTT against mosquitto and its own clients: births, wills, restarts, commands, TLS; plain JSON.

A subscriber is mosquitto_sub; what it gets is judged by a host that knows only the specification.
"""

from __future__ import annotations

import asyncio
import gc
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from edge_node_rig import GROUP, NODE, metric
from far_ends import until
from sparkplug_host import tag

from dpstack.bridge.mqtt.broker import Broker
from dpstack.plant.orders import SetOutputs
from tests.strangers.mosquitto_kit import LONGEST_S, Mosquitto, Plant, following, plain, run, valves_file

pytestmark = pytest.mark.strangers


async def test_births_data_and_an_ordered_end(tmp_path: Path, broker: Mosquitto) -> None:
    plant = Plant(tmp_path, plain(broker))
    async with following(broker) as subscriber:
        host = subscriber.host
        async with plant.running():
            await plant.until(lambda: host.alive == {"hoist", "valves"})
            assert host.number == 0
            plant.values["8"]["fields"]["level"] = 99.0
            await plant.until(lambda: host.metric("Inputs/level", "valves").value == 99.0)
            plant.values["8"]["state"] = "offline"
            await plant.until(lambda: host.alive == {"hoist"})
            plant.values["8"]["state"] = "data_exchange"
            await plant.until(lambda: host.alive == {"hoist", "valves"})
        await plant.until(lambda: not host.online)
        # ours, and that of the broker: DISCONNECT has the reason code 0x04
        await plant.until(lambda: subscriber.kinds()[-2:] == ["NDEATH", "NDEATH"])
        assert subscriber.flags == {"0"}
    log = broker.log.read_text()
    assert f"as {GROUP}/{NODE} (p5, c1, k2" in log  # MQTT 5, clean start, keep alive
    assert "(r0, q1)" in log  # the will
    assert f"spBv1.0/{GROUP}/DCMD/{NODE}/+ (QoS 1)" in log


KILLED = """
import asyncio, sys
from pathlib import Path
sys.path[:0] = {path!r}
from tests.strangers.mosquitto_kit import Plant
from dpstack.bridge.mqtt.broker import Broker
async def main():
    plant = Plant(Path({folder!r}), Broker(url={url!r}, keepalive_s=2))
    async with plant.running():
        await asyncio.sleep(60)
asyncio.run(main())
"""


async def test_sigkill_of_the_gateway_gives_its_will_and_the_next_number(tmp_path: Path, broker: Mosquitto) -> None:
    text = KILLED.format(path=sys.path, folder=str(tmp_path), url=plain(broker).url)
    async with following(broker) as subscriber:
        host = subscriber.host
        for number in range(3):
            gateway = await asyncio.create_subprocess_exec(sys.executable, "-c", text, cwd=Path(__file__).parent)
            wait_until = Plant(tmp_path / "unused", plain(broker)).until
            await wait_until(lambda: len(host.alive) == 2)
            assert host.number == number
            gateway.kill()
            await gateway.wait()
            await wait_until(lambda: not host.online)
        assert subscriber.kinds().count("NDEATH") == 3


async def test_the_broker_is_killed_and_comes_back(tmp_path: Path, broker: Mosquitto) -> None:
    plant = Plant(tmp_path, plain(broker))
    async with plant.running():
        await plant.until(lambda: f"connected to 127.0.0.1:{broker.port}" in plant.told)
        for number in range(1, 3):
            broker.kill()
            await plant.until(lambda: "it is tried again" in plant.told[-1])
            broker.start()
            async with following(broker) as subscriber:
                host = subscriber.host
                await run(rebirth(broker))
                await plant.until(lambda: len(host.alive) == 2)  # noqa: B023
                assert host.number is not None
                assert host.number >= number
                host.lose_broker()


def rebirth(broker: Mosquitto) -> list[str]:
    path = broker.folder / "rebirth"
    path.write_bytes(tag(1, round(time.time() * 1000)) + tag(2, metric("Node Control/Rebirth", boolean=True)))
    return broker.clients("mosquitto_pub", "-t", f"spBv1.0/{GROUP}/NCMD/{NODE}", "-f", str(path))


async def test_a_broker_that_stops_costs_nothing_and_gets_births_again(tmp_path: Path, broker: Mosquitto) -> None:
    plant = Plant(tmp_path, plain(broker))
    async with following(broker, "-k", "600") as subscriber, plant.running():
        host = subscriber.host
        await plant.until(lambda: len(host.alive) == 2)
        broker.kill(signal.SIGSTOP)
        stopped = time.monotonic()
        slowest = 0.0
        while "it is tried again" not in plant.told[-1]:
            assert time.monotonic() < stopped + LONGEST_S
            began = time.monotonic()
            plant.values["8"]["fields"]["count"] = int(began * 50) % 100
            await asyncio.sleep(0.01)
            slowest = max(slowest, time.monotonic() - began)
        assert slowest < 2.0  # the loop goes on
        broker.kill(signal.SIGCONT)
        await plant.until(lambda: host.online and (host.number or 0) >= 1 and len(host.alive) == 2)


class Network:
    """A way to the broker that can be cut: octets vanish then, connections stay open, and nobody hears of it."""

    def __init__(self, broker: Mosquitto) -> None:
        self._broker = broker
        self.is_cut = False
        self.connections = 0
        self._tasks: set[asyncio.Task[None]] = set()
        self._writers: list[asyncio.StreamWriter] = []

    async def _take(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        self._writers.append(writer)
        if self.is_cut:  # the handshake of TCP is the relay's; nothing comes behind it
            self._tasks.add(asyncio.create_task(self._pass_on(reader, writer)))
            return
        far_reader, far_writer = await asyncio.open_connection("127.0.0.1", self._broker.port)
        self._writers.append(far_writer)
        for one, other in ((reader, far_writer), (far_reader, writer)):
            self._tasks.add(asyncio.create_task(self._pass_on(one, other)))

    async def _pass_on(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(ConnectionError):
            while octets := await reader.read(65536):
                if not self.is_cut:
                    writer.write(octets)
                    await writer.drain()
            if not self.is_cut:
                writer.close()

    @asynccontextmanager
    async def open(self) -> AsyncIterator[Broker]:
        server = await asyncio.start_server(self._take, "127.0.0.1", 0)
        try:
            yield Broker(url=f"mqtt://127.0.0.1:{server.sockets[0].getsockname()[1]}", keepalive_s=1)
        finally:
            server.close()
            for task in self._tasks:
                task.cancel()
            await asyncio.gather(*self._tasks, return_exceptions=True)
            for writer in self._writers:
                writer.transport.abort()
            await asyncio.sleep(0)


async def test_a_network_that_is_cut_in_silence(tmp_path: Path, broker: Mosquitto) -> None:
    """Both ends find out by the keep alive: the broker publishes the will, and a new session has the next number."""
    network = Network(broker)
    async with network.open() as way, following(broker) as subscriber:
        plant, host = Plant(tmp_path, way), subscriber.host
        async with plant.running():
            await plant.until(lambda: len(host.alive) == 2)
            network.is_cut = True
            plant.values["8"]["fields"]["level"] = 77.0
            await plant.until(lambda: not host.online)
            assert host.number == 0
            await plant.until(lambda: network.connections > 1)
            network.is_cut = False
            await plant.until(lambda: len(host.alive) == 2)
            assert (host.number or 0) >= 1
            assert host.metric("Inputs/level", "valves").value == 77.0


async def command(broker: Mosquitto, device: str, *metrics: bytes, age: float = 0.0) -> None:
    path = broker.folder / "command"
    path.write_bytes(tag(1, round((time.time() - age) * 1000)) + b"".join(tag(2, one) for one in metrics))
    topic = f"spBv1.0/{GROUP}/DCMD/{NODE}/{device}"
    await run(broker.clients("mosquitto_pub", "-q", "1", "-t", topic, "-f", str(path)))


async def test_commands(tmp_path: Path, broker: Mosquitto) -> None:
    plant = Plant(tmp_path, plain(broker))
    async with following(broker) as subscriber, plant.running():
        host = subscriber.host
        await plant.until(lambda: len(host.alive) == 2)

        async def result(name: str, reason: str) -> None:
            await plant.until(lambda: reason in host.metric("Last command/reason").value)
            assert host.metric("Last command/name").value == name

        await command(broker, "valves", metric("Outputs/lamp", boolean=True))
        await plant.until(lambda: host.metric("Outputs/lamp", "valves").value is True)
        await plant.until(lambda: host.metric("Last command/result").value == "done")
        assert plant.carried_out == [SetOutputs(8, {"lamp": True})]
        await command(broker, "valves", metric("Outputs/speed", whole=256))
        await result("valves.speed", "valves.speed takes u8, not 256")
        await command(broker, "valves", metric("Outputs/speed", text="fast"))
        await result("valves: 'Outputs/speed'", "its value is no UINT8")
        await command(broker, "valves", metric("Outputs/pump", boolean=True))
        await result("valves: 'Outputs/pump'", "there is no such metric")
        await command(broker, "hoist", metric("Drive/setpoint", double=0.5))
        await result("hoist: 'Drive/setpoint'", "this metric cannot be written")
        await command(broker, "valves", metric("Outputs/speed", whole=1), age=3.0)
        await result("valves.speed", "s old by the clock of this computer")
        await command(broker, "valves", metric("Outputs/speed", whole=1), age=-3600.0)
        await result("valves.speed", "ahead of the clock of this computer")
        path = broker.folder / "command"
        await command(broker, "valves", metric("Outputs/speed", whole=7))
        topic = f"spBv1.0/{GROUP}/DCMD/{NODE}/valves"
        await run(broker.clients("mosquitto_pub", "-q", "1", "-t", topic, "-f", str(path)))
        await result("valves.speed", "an order with this name and time was given already")
        assert plant.carried_out == [SetOutputs(8, {"lamp": True}), SetOutputs(8, {"speed": 7})]
        path.write_bytes(bytes(1_000_000))
        await run(broker.clients("mosquitto_pub", "-t", topic, "-f", str(path)))
        path.write_bytes(b"\xff" * 100)
        await run(broker.clients("mosquitto_pub", "-t", topic, "-f", str(path)))
        await result("unknown", "the payload is no Sparkplug B payload")
        assert host.number == 0  # one session for all that


async def test_the_primary_host(tmp_path: Path, broker: Mosquitto) -> None:
    async def state(text: str) -> None:
        topic = "spBv1.0/STATE/scada"
        await run(broker.clients("mosquitto_pub", "-r", "-q", "1", "-t", topic, "-m", text))

    plant = Plant(tmp_path, plain(broker), primary_host="scada")
    async with following(broker) as subscriber, plant.running():
        host = subscriber.host
        await plant.until(lambda: f"connected to 127.0.0.1:{broker.port}" in plant.told)
        assert plant.connector.connected
        await state('{"online": false, "timestamp": 1000}')
        await asyncio.sleep(0.5)
        assert host.messages == []
        await state('{"online": true, "timestamp": 1000}')
        await plant.until(lambda: len(host.alive) == 2)
        await state('{"online": false, "timestamp": 1000}')
        await plant.until(lambda: not host.online)
        await asyncio.sleep(0.5)
        assert not host.online
        await state('{"online": true, "timestamp": 2000}')
        await plant.until(lambda: len(host.alive) == 2)
        assert (host.number or 0) >= 1


async def test_two_gateways_with_one_node_are_told(tmp_path: Path, broker: Mosquitto) -> None:
    one, other = Plant(tmp_path / "1", plain(broker)), Plant(tmp_path / "2", plain(broker))
    async with one.running():
        await one.until(lambda: f"connected to 127.0.0.1:{broker.port}" in one.told)
        async with other.running():
            await one.until(lambda: any("give one of them another node" in text for text in one.told))


# --- TLS and users ------------------------------------------------------------------------------------------------


def certificates(folder: Path, *, days: int = 2) -> None:
    """A CA, and certificates for the broker and a client."""

    def openssl(*words: str) -> None:
        subprocess.run(["openssl", *words], cwd=folder, check=True, capture_output=True)

    openssl("req", "-x509", "-newkey", "rsa:2048", "-nodes", "-keyout", "ca.key", "-out", "ca.pem", "-days", "2",
            "-subj", "/CN=a test")  # fmt: skip
    (folder / "names").write_text("subjectAltName=IP:127.0.0.1\n")
    for name, valid in (("broker", 2), ("client", 2), ("expired", -1)):
        openssl("req", "-newkey", "rsa:2048", "-nodes", "-keyout", f"{name}.key", "-out", f"{name}.csr", "-subj",
                f"/CN={name}")  # fmt: skip
        openssl("x509", "-req", "-in", f"{name}.csr", "-CA", "ca.pem", "-CAkey", "ca.key", "-CAcreateserial", "-out",
                f"{name}.pem", "-days", str(valid), "-extfile", "names")  # fmt: skip


@pytest.fixture
def collected() -> Iterator[None]:
    """The garbage of the test is collected at its end, and disturbs no other test."""
    yield
    gc.collect()


# where the handshake fails, paho leaves its socket to the garbage collection
@pytest.mark.filterwarnings("ignore:Exception ignored in. <ssl.SSLSocket:pytest.PytestUnraisableExceptionWarning")
async def test_tls_with_user_password_and_client_certificate(tmp_path: Path, collected: None) -> None:
    certificates(tmp_path)
    await run(["mosquitto_passwd", "-b", "-c", str(tmp_path / "users"), "gateway", "sesame opens"])
    os.chmod(tmp_path / "users", 0o644)
    lines = [
        "cafile ca.pem",
        "certfile broker.pem",
        "keyfile broker.key",
        "require_certificate true",
        "password_file users",
    ]
    broker = Mosquitto(tmp_path, *lines, anonymous=False)
    url = f"mqtts://127.0.0.1:{broker.port}"

    def made(name: str = "client", password: str = "sesame opens", ca: Path | None = tmp_path / "ca.pem") -> Broker:
        cert, key = tmp_path / f"{name}.pem", tmp_path / f"{name}.key"
        return Broker(url=url, ca=ca, user="gateway", password=password, cert=cert, key=key)

    options = [
        "--cafile",
        "ca.pem",
        "--cert",
        "client.pem",
        "--key",
        "client.key",
        "-u",
        "gateway",
        "-P",
        "sesame opens",
    ]
    options = [str(tmp_path / one) if one.endswith((".pem", ".key")) else one for one in options]
    try:
        plant = Plant(tmp_path / "good", made())
        async with following(broker, *options) as subscriber, plant.running():
            await plant.until(lambda: len(subscriber.host.alive) == 2)
        for number, (wrong, text) in enumerate(
            [
                (made(password="wrong secret"), "Not authorized"),
                (made("expired"), "refuses the certificate of this program: it has expired"),
                (made(ca=None), "its certificate is refused"),
            ]
        ):
            plant = Plant(tmp_path / str(number), wrong)
            async with plant.running():
                await plant.until(lambda: plant.told)  # noqa: B023
            assert text in plant.told[0]
            assert "secret" not in " ".join(plant.told)
    finally:
        broker.kill()


# --- dpstack run with the table [mqtt] ---


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
async def test_a_run_publishes_its_plant_and_takes_the_orders_that_are_listed(
    tmp_path: Path, broker: Mosquitto, number: signal.Signals
) -> None:
    config = valves_file(tmp_path, broker, allow_commands=["valves.lamp"])
    environment = os.environ | {"XDG_STATE_HOME": str(tmp_path / "state"), "XDG_RUNTIME_DIR": str(tmp_path)}
    words = (sys.executable, "-m", "dpstack", "run", config, "--json", "--log", str(tmp_path / "log.jsonl"))
    async with following(broker) as subscriber:
        host = subscriber.host
        run = await asyncio.create_subprocess_exec(
            *words, env=environment, stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.PIPE
        )
        await until(lambda: host.alive == {"valves"})
        lamp, speed = (host.metric(f"Outputs/{name}", "valves") for name in ("lamp", "speed"))
        assert lamp.value is False
        assert (lamp.properties["Readonly"], speed.properties["Readonly"]) == (False, True)
        await command(broker, "valves", metric("Outputs/lamp", boolean=True))
        await until(lambda: host.metric("Outputs/lamp", "valves").value is True)
        await until(lambda: host.metric("Last command/result").value == "done")
        await command(broker, "valves", metric("Outputs/speed", whole=1))
        await until(lambda: "written" in host.metric("Last command/reason").value)
        run.send_signal(number)
        _, err = await run.communicate()
        await until(lambda: not host.online)
    assert (tmp_path / "state" / "dpstack" / f"{GROUP}.{NODE}" / "bdseq").read_text() == "0\n"
    assert run.returncode == (-number if number is signal.SIGKILL else 0)
    # a broker that is slow to acknowledge lets a value wait for a moment
    assert err in (b"", b"dpstack: mqtt: all values that waited have been delivered\n")
    if number is not signal.SIGKILL:
        kinds = subscriber.kinds()
        assert "DDEATH" in kinds[-3:], kinds
        told = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
        texts = [line["text"] for line in told if line["text"].startswith("connectors: mqtt")]
        assert '(on_connector_loss = "safe")' in texts[0]
        assert texts[1] == f"connectors: mqtt: connected to 127.0.0.1:{broker.port}"
        assert "connectors: mqtt: order valves.lamp: done" in texts


JSON = f"dpstack/{GROUP}/{NODE}"


async def json_message(broker: Mosquitto, topic: str, *options: str) -> tuple[bool, Any]:
    """The next message: whether the broker had kept it, and its payload."""
    words = broker.clients("mosquitto_sub", "-t", f"{JSON}/{topic}", "-C", "1", "-W", "20", "-F", "%r %p", *options)
    made = await asyncio.to_thread(subprocess.run, words, check=True, capture_output=True, timeout=LONGEST_S)
    kept, _, payload = made.stdout.decode().partition(" ")
    return kept == "1", json.loads(payload)


async def json_until(broker: Mosquitto, topic: str, wanted: str) -> Any:
    end = time.monotonic() + LONGEST_S
    while wanted not in json.dumps((found := await json_message(broker, topic))[1]):
        assert time.monotonic() < end, found
    return found[1]


async def json_order(broker: Mosquitto, name: str, payload: object) -> Any:
    """Send an order; returns its result."""
    before = broker.subscriptions()
    listening = asyncio.create_task(json_message(broker, "result"))
    await until(lambda: broker.subscriptions() > before)
    topic = f"{JSON}/slave/valves/set/{name}"
    await run(broker.clients("mosquitto_pub", "-q", "1", "-t", topic, "-m", json.dumps(payload)))
    kept, result = await listening
    assert not kept
    return result


async def test_plain_json_from_values_and_orders_to_the_will(tmp_path: Path, broker: Mosquitto) -> None:
    config = valves_file(tmp_path, broker, allow_commands=["valves.lamp"], format="json")
    run_ = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "dpstack", "run", config),
        env=os.environ | {"XDG_STATE_HOME": str(tmp_path)},
        stdout=asyncio.subprocess.DEVNULL,
    )
    try:
        await json_until(broker, "slave/valves/online", "true")
        await json_until(broker, "online", "true")
        level = (await json_until(broker, "slave/valves/inputs", '"good"'))["level"]
        assert level["time"].endswith("Z")
        kept = broker.clients("mosquitto_sub", "-t", f"{JSON}/slave/valves/inputs", "-C", "1", "-F", "%E")
        made = await asyncio.to_thread(subprocess.run, kept, check=True, capture_output=True, timeout=LONGEST_S)
        assert 0 < int(made.stdout) <= 30
        result = await json_order(broker, "lamp", {"value": True, "time": time.time()})
        assert (result["order"], result["result"]) == ("valves.lamp", "done"), result
        await json_until(broker, "slave/valves/outputs", '"lamp": {"value": true')
        result = await json_order(broker, "speed", {"value": 1, "time": time.time()})
        assert result["reason"] == "there is no such order, or allow_commands does not list it"
        result = await json_order(broker, "lamp", {"value": False, "time": time.time() - 60})
        assert "s old by the clock of this computer" in result["reason"]
        run_.kill()
        await run_.wait()
        assert await json_until(broker, "online", "false") is False
    finally:
        if run_.returncode is None:
            run_.kill()
            await run_.wait()
