"""The keys of a broker: addresses, TLS, secrets that stand in no text and in nothing that is published, folders for any
name; wills and sessions."""

from __future__ import annotations

import asyncio
import os
import ssl
from pathlib import Path

import aiomqtt
import pytest
from edge_node_rig import GROUP, NODE
from fake_broker import CONNECT, PUBLISH, FakeBroker, text, user_property
from far_ends import until
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.reasoncodes import ReasonCode
from plant_items import FINE, HOIST, VALVES
from tls_kit import CERT, KEY, KEY_WITH_PASSWORD, OTHER_KEY

from dpstack.bridge.mqtt.broker import Broker, read_password, state_folder
from dpstack.bridge.mqtt.connection import LastError, text_of, why_lost
from dpstack.bridge.mqtt.edge_node import EdgeNode
from dpstack.bridge.mqtt.history_keeper import HistoryKeeper
from dpstack.bridge.mqtt.json_node import JsonNode
from dpstack.bridge.mqtt.plant_node import PlantNode
from dpstack.errors import ConfigError
from dpstack.plant.tree import PlantTree
from tests.bridge_mqtt.connector_kit import connector_at, published, serving


@pytest.mark.parametrize(
    ("url", "place"),
    [
        ("mqtt://plant.example", ("plant.example", 1883, False)),
        ("mqtts://plant.example/", ("plant.example", 8883, True)),
        ("mqtt://[::1]:1999", ("::1", 1999, False)),
        ("MQTTS://plant.example", ("plant.example", 8883, True)),
        (" mqtts://plant.example:1883", ("plant.example", 1883, True)),
    ],
)
def test_addresses(url: str, place: tuple[str, int, bool]) -> None:
    broker = Broker(url=url)
    assert (broker.host, broker.port, broker.tls_context() is not None) == place


@pytest.mark.parametrize(
    ("url", "text"),
    [
        ("plant.example", "write mqtt://HOST:PORT"),
        ("http://plant.example", "write mqtt://HOST:PORT"),
        ("mqtt://plant.example:99999", "write mqtt://HOST:PORT"),
        ("mqtt://[::1", "write mqtt://HOST:PORT"),
        ("mqtt://plant.example/x", "write mqtt://HOST:PORT"),
        ("mqtt://me:sesame@plant.example", "user and password have keys of their own"),
    ],
)
def test_an_address_that_is_none_is_refused_and_no_text_holds_a_password(url: str, text: str) -> None:
    with pytest.raises(ConfigError, match=text) as caught:
        Broker(url=url)
    assert "sesame" not in str(caught.value)
    assert "sesame" not in repr(Broker(url="mqtt://a", user="me", password="sesame"))


def test_combinations_that_cannot_be(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="need TLS"):
        Broker(url="mqtt://a", ca=tmp_path)
    with pytest.raises(ConfigError, match="cert and key go together"):
        Broker(url="mqtts://a", cert=tmp_path)
    with pytest.raises(ConfigError, match="a password needs a user"):
        Broker(url="mqtt://a", password="sesame")


def test_certificates_that_cannot_be_used_are_told(tmp_path: Path) -> None:
    for name, pem in (("cert", CERT), ("key", KEY), ("other", OTHER_KEY), ("locked", KEY_WITH_PASSWORD), ("no", "?")):
        (tmp_path / name).write_text(pem)

    def context(*, ca: str = "cert", cert: str = "cert", key: str = "key") -> object:
        return Broker(url="mqtts://a", ca=tmp_path / ca, cert=tmp_path / cert, key=tmp_path / key).tls_context()

    assert context() is not None
    assert Broker(url="mqtt://a").tls_context() is None
    for wrong in ({"ca": "no"}, {"ca": "none"}, {"key": "other"}, {"key": "locked"}, {"cert": "no"}):
        with pytest.raises(ConfigError, match=r"PEM file that fits|No such file"):
            context(**wrong)


def test_passwords_come_from_the_environment_or_from_a_file_of_ones_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SECRET", "sesame")
    file = tmp_path / "password"
    file.write_bytes("öffne dich\r\nmore\n".encode())
    file.chmod(0o600)
    assert read_password("SECRET", None) == "sesame"
    assert read_password("", file) == "öffne dich"
    assert read_password("", None) == ""
    with pytest.raises(ConfigError, match="give one of them"):
        read_password("SECRET", file)
    with pytest.raises(ConfigError, match="the environment has no variable"):
        read_password("NO_SUCH", None)
    file.chmod(0o640)
    with pytest.raises(ConfigError, match="others can read or change it: `chmod 600") as caught:
        read_password("", file)
    assert "dich" not in str(caught.value)
    file.chmod(0o600)
    for octets in (b"", b"\n", b"\xff", b"x" * 5000):
        file.write_bytes(octets)
        with pytest.raises(ConfigError, match="its first line has no password"):
            read_password("", file)
    os.mkfifo(tmp_path / "fifo", 0o600)
    for name in ("fifo", "none"):
        with pytest.raises(ConfigError, match=r"is no file|No such file"):
            read_password("", tmp_path / name)


@pytest.mark.parametrize(
    ("logged", "text"),
    [
        (
            "failed to receive on socket: [SSL: TLSV13_ALERT_CERTIFICATE_REQUIRED] tlsv13 alert certificate required",
            "it wants a certificate of this program: give cert and key",
        ),
        (
            "failed to receive on socket: [SSL: SSLV3_ALERT_CERTIFICATE_EXPIRED] sslv3 alert certificate expired",
            "it refuses the certificate of this program: it has expired; give a new cert and key",
        ),
        (
            "failed to receive on socket: [Errno 104] Connection reset by peer",
            "Connection reset by peer; is that its port? (mqtts:// is with TLS, mqtt:// without)",
        ),
        ("", "it refuses user or password (Not authorized)"),
    ],
)
def test_a_connection_that_never_stood_has_a_reason_with_a_remedy(logged: str, text: str) -> None:
    last = LastError()
    last.text = logged
    error = aiomqtt.MqttCodeError(ReasonCode(PacketTypes.CONNACK, identifier=0x87))
    assert why_lost(error if not logged else TimeoutError(), last, connected=False) == text


def test_a_connection_that_stood_is_no_matter_of_port_or_password() -> None:
    reset = ConnectionResetError(104, "Connection reset by peer")
    assert why_lost(reset, LastError(), connected=True) == "Connection reset by peer"
    acl = aiomqtt.MqttCodeError(ReasonCode(PacketTypes.DISCONNECT, identifier=0x87))
    assert why_lost(acl, LastError(), connected=True) == "Not authorized"


def test_errors_of_the_connection_are_in_words() -> None:
    lost = aiomqtt.MqttCodeError(ReasonCode(PacketTypes.DISCONNECT, identifier=0x80))
    assert text_of(lost) == "it has ended the connection, or the network has"
    assert text_of(aiomqtt.MqttCodeError(ReasonCode(PacketTypes.CONNACK, identifier=0x87))) == "Not authorized"
    refused = ssl.SSLCertVerificationError(1, "certificate verify failed (_ssl.c:1006)")
    refused.verify_message = "certificate has expired"
    assert text_of(refused).startswith("its certificate is refused (certificate has expired); see url")
    refused.verify_code = 10
    assert text_of(refused).endswith("give the broker a new one, or set the clock of this computer")
    wrapped = aiomqtt.MqttError("gone")
    wrapped.__cause__ = ConnectionRefusedError(111, "Connection refused")
    assert text_of(wrapped) == "Connection refused"
    for hidden, says in ((refused, "its certificate is refused"), (TimeoutError(), "Operation timed out")):
        copied = aiomqtt.MqttError("Operation timed out")
        copied.__context__, copied.__suppress_context__ = hidden, True  # as "from None" does
        assert text_of(copied).startswith(says)
    assert text_of(OSError()) == "OSError"


def test_every_edge_node_has_a_folder_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_STATE_HOME", "/state")
    assert state_folder("plant 1", "node") == Path("/state/dpstack/plant 1.node")
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/dpstack:/other")
    assert state_folder("..", "..") == Path("/var/lib/dpstack/%2E%2E.%2E%2E")
    assert state_folder("a.b", "c") != state_folder("a", "b.c")
    longest = "線" * 40
    assert len(state_folder(longest, longest).name) == 255
    assert state_folder(longest, longest) != state_folder(longest, longest[:39])
    assert len(state_folder("a" * 120, "b" * 120).name) == 241


async def test_without_room_for_the_number_no_session_begins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(fd: int, octets: bytes) -> int:
        raise OSError(28, "No space left on device")

    told: list[str] = []
    connector = connector_at(tmp_path, told, again_s=0.001)
    with monkeypatch.context() as patch:
        async with serving(connector):
            patch.setattr("dpstack.bridge.mqtt.session_file.os.write", full)
            await until(lambda: told)
    assert f"the number of the session cannot be written in {tmp_path}: No space left on device" in told[0]


async def test_a_broker_that_is_not_there_is_told_once_in_a_row_and_the_end_waits_for_nobody(tmp_path: Path) -> None:
    told: list[str] = []
    async with serving(connector_at(tmp_path, told, again_s=0.001)):
        await until(lambda: len(told) >= 3)
    assert len(set(told)) == 1
    assert "Connection refused; it is tried again" in told[0]
    assert int((tmp_path / "bdseq").read_text()) >= 2  # each try has a number of its own


@pytest.mark.parametrize("drawn", [0.0, 1.0])
async def test_the_first_connection_of_a_program_waits_a_moment_by_chance(tmp_path: Path, drawn: float) -> None:
    told: list[str] = []
    async with serving(connector_at(tmp_path, told, draw=lambda: drawn)):
        await asyncio.sleep(0.1)
        if not drawn:
            await until(lambda: told)
        assert (tmp_path / "bdseq").exists() == (not drawn)


async def test_the_end_of_the_way_to_the_disk_is_told_and_the_connector_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def step(_: HistoryKeeper) -> None:
        raise ZeroDivisionError("a fault")

    monkeypatch.setattr(HistoryKeeper, "step", step)
    told: list[str] = []
    text = "values that cannot be delivered are not kept on the disk any more (ZeroDivisionError: a fault)"
    async with serving(connector_at(tmp_path, told, store_mb=1, again_s=0.001)):
        await until(lambda: text in told and len(told) >= 3)


async def test_results_that_were_lost_are_counted(tmp_path: Path) -> None:
    connector = connector_at(tmp_path, make_node=JsonNode)
    await connector.open()
    assert connector._node is not None
    connector._node.connect(0, 1.0)
    connector._node.connected()
    for _ in range(300):
        connector._node.receive(f"dpstack/{GROUP}/{NODE}/slave/valves/set/lamp", b"", 1.0)
    connector.take([])
    assert connector.dropped == 300 - 256
    connector.close()


BASE, SPARKPLUG = f"dpstack/{GROUP}/{NODE}", f"spBv1.0/{GROUP}"
SESSION = user_property("session", "0")
#: topics that are published, the last one last; and the end of the will
JSON = (
    [f"{BASE}/{one}" for one in ("status", "slave/valves/inputs", "slave/hoist/drive", "bus/state", "online")],
    bytes([len(SESSION)]) + SESSION + text(f"{BASE}/online") + text("false"),
)
BIRTHS = (
    [f"{BASE}/status", *(f"{SPARKPLUG}/{one}" for one in (f"NBIRTH/{NODE}", f"DBIRTH/{NODE}/valves"))],
    b"\0" + text(f"{SPARKPLUG}/NDEATH/{NODE}"),
)


@pytest.mark.parametrize(("make_node", "topics", "will"), [(JsonNode, *JSON), (EdgeNode, *BIRTHS)])
async def test_no_secret_is_published_and_a_will_has_the_number_of_its_session(
    tmp_path: Path, make_node: type[PlantNode], topics: list[str], will: bytes
) -> None:
    secret = tmp_path / "hidden.password"
    secret.touch(mode=0o600)
    secret.write_text("sesame opens\n")
    told: list[str] = []
    async with FakeBroker(topics=1) as broker:
        tree = PlantTree()
        connector = connector_at(
            tmp_path / "state",
            told,
            broker=Broker(url=broker.url, user="the gateway", password=read_password("", secret)),
            tree=tree,
            versions={"dpstack": "0.1.0"},
            make_node=make_node,
        )
        async with serving(connector, tree, s3=HOIST, s8=VALVES | FINE):
            await published(broker, topics[-1])
    sent = [body for kind, body in broker.received if kind == PUBLISH]
    for topic in topics:
        assert any(body.startswith(text(topic)) for body in sent), topic
    (connect,) = [body for kind, body in broker.received if kind == CONNECT]
    assert text("sesame opens") in connect
    assert will in connect
    # MQTT 5, Clean Start, a Session Expiry Interval of 0 (tck-id-principles-persistence-clean-session-50)
    assert (connect[6], connect[7] & 2) == (5, 2)
    assert b"\x11\0\0\0\0" in connect[11 : 11 + connect[10]]
    # with a Message Expiry Interval of 30 s
    assert any(body.startswith(text(f"{BASE}/status") + b"\x05\x02\0\0\0\x1e") for body in sent)
    for body in (*sent, *(remark.encode() for remark in told)):
        for hidden in (b"sesame", b"the gateway", b"hidden.password", str(tmp_path).encode()):
            assert hidden not in body
