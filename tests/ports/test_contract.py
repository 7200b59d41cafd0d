"""One contract for all kinds of ports: the same tests, a subclass per kind."""

from __future__ import annotations

import asyncio
import select
import socket
import threading
import time
import types
from collections.abc import AsyncIterator, Callable
from typing import Any

import pytest
from far_ends import FarEnd, PtyFarEnd, Rfc2217FarEnd, TcpFarEnd, many_files_open, open_slave, until
from memory_port import MemoryPort, memory_pair
from serial import rfc2217

from dpstack.errors import BaudError, PortError
from dpstack.ports import Delivery, Port, open_port, termios2
from dpstack.ports.pyserial import PySerialPort

EVERY_OCTET = bytes(range(256))
BAUD = 500_000


class Heard:
    """The octets and losses that a port delivered."""

    def __init__(self) -> None:
        self.octets = b""
        self.lost: list[str] = []

    def data(self, chunk: bytes) -> None:
        assert chunk
        self.octets += chunk

    def gone(self, reason: str) -> None:
        self.lost.append(reason)

    async def wait(self, count: int) -> bytes:
        await until(lambda: len(self.octets) >= count, f"{count} octets")
        return self.octets


class PortContract:
    """Subclasses give ``both``: an open port and its other end."""

    delivery = Delivery.HOST
    paced = False
    tells_loss = True
    changes_rate = False

    async def make(self) -> tuple[Port, Any, Callable[[], None]]:
        raise NotImplementedError

    def follow(self, far: Any, baud: int) -> None:
        """The other end is at ``baud`` too; most kinds of line do not show the difference."""

    @pytest.fixture
    async def both(self) -> AsyncIterator[tuple[Port, Any]]:
        port, far, shut = await self.make()
        yield port, far
        port.close()
        await asyncio.sleep(0)
        shut()

    @pytest.fixture
    async def heard(self, both: tuple[Port, Any]) -> Heard:
        heard = Heard()
        both[0].attach(asyncio.get_running_loop(), heard.data, heard.gone)
        return heard

    async def test_every_octet_comes_in(self, both: tuple[Port, Any], heard: Heard) -> None:
        both[1].send(EVERY_OCTET)
        assert await heard.wait(256) == EVERY_OCTET

    async def test_every_octet_goes_out(self, both: tuple[Port, Any], heard: Heard) -> None:
        port, far = both
        assert port.write(EVERY_OCTET[:255])
        assert port.write(EVERY_OCTET[255:])
        assert await far.recv(256) == EVERY_OCTET
        assert port.dropped == 0

    async def test_a_burst_is_handed_over_whole_and_in_order(self, both: tuple[Port, Any], heard: Heard) -> None:
        burst = EVERY_OCTET * 12
        both[1].send(burst)
        assert await heard.wait(len(burst)) == burst

    async def test_read_now_drains_and_does_not_wait(self, both: tuple[Port, Any]) -> None:
        port, far = both
        assert port.read_now() == b""
        far.send(b"\xdc\x02\x02")
        got = b""
        async with asyncio.timeout(10):
            while len(got) < 3:
                got += port.read_now()
                await asyncio.sleep(0.001)
        assert got == b"\xdc\x02\x02"
        assert port.read_now() == b""

    async def test_detached_it_hands_over_nothing_attached_again_it_does(
        self, both: tuple[Port, Any], heard: Heard
    ) -> None:
        port, far = both
        far.send(b"one")
        await heard.wait(3)
        port.detach()
        later = Heard()
        port.attach(asyncio.get_running_loop(), later.data, later.gone)
        far.send(b"two")
        await later.wait(3)
        assert (heard.octets, later.octets) == (b"one", b"two")

    async def test_a_closed_port_drops_and_counts_and_close_may_come_again(
        self, both: tuple[Port, Any], heard: Heard
    ) -> None:
        port = both[0]
        port.close()
        port.close()
        assert not port.write(b"\xe5")
        assert port.dropped == 1
        assert port.read_now() == b""
        assert port.fd is None
        assert not heard.lost

    async def test_a_full_line_drops_and_counts_and_does_not_wait(self, both: tuple[Port, Any], heard: Heard) -> None:
        port, far = both
        far.stall()
        for _ in range(100_000):
            if not port.write(bytes(250)):
                break
        assert port.dropped == 1
        assert not heard.lost

    async def test_a_loss_is_reported_once_with_its_reason(self, both: tuple[Port, Any], heard: Heard) -> None:
        if not self.tells_loss:
            return
        port, far = both
        far.hang_up()
        await until(lambda: bool(heard.lost), "the loss")
        port.write(b"\xe5")
        port.read_now()
        for _ in range(3):
            await asyncio.sleep(0)
        assert len(heard.lost) == 1
        assert heard.lost[0]

    async def test_the_rate_of_an_open_line_is_changed_or_that_is_refused(
        self, both: tuple[Port, Any], heard: Heard
    ) -> None:
        port, far = both
        if self.changes_rate:
            port.set_baud(19_200)
            assert port.baud == 19_200
            self.follow(far, 19_200)
        else:
            with pytest.raises(BaudError, match="give the rate"):
                port.set_baud(19_200)
            assert port.baud == BAUD
        far.send(b"\xdc\x02\x02")
        assert await heard.wait(3) == b"\xdc\x02\x02"

    async def test_its_attributes_describe_the_port(self, both: tuple[Port, Any]) -> None:
        port = both[0]
        assert port.delivery is self.delivery
        assert port.paced is self.paced
        assert port.baud == BAUD
        assert port.name
        assert all(isinstance(notice, str) for notice in port.notices)


class Reopens:
    """For kinds whose other end is still there after a close."""

    async def test_opened_again_it_is_empty(self, both: tuple[Port, Any], heard: Heard) -> None:
        port, far = both
        far.send(b"old")
        await heard.wait(3)
        port.close()
        self.send_stale(far)
        await port.open()
        again = Heard()
        port.attach(asyncio.get_running_loop(), again.data, again.gone)
        await self.settled(port, far)
        far.send(b"new")
        await again.wait(3)
        assert again.octets == b"new"

    def send_stale(self, far: Any) -> None:
        """Octets for nobody, where the kind can have them."""

    async def settled(self, port: Port, far: Any) -> None:
        """Until the other end knows."""


class TestTty(PortContract, Reopens):
    changes_rate = True

    async def make(self) -> tuple[Port, FarEnd, Callable[[], None]]:
        far = PtyFarEnd()
        port = open_port(far.path, BAUD)
        await port.open()
        return port, far, far.hang_up

    def send_stale(self, far: FarEnd) -> None:
        far.send(b"stale")


class TestPySerial(PortContract, Reopens):
    delivery = Delivery.ADAPTER
    paced = True
    changes_rate = True

    async def make(self) -> tuple[Port, FarEnd, Callable[[], None]]:
        far = PtyFarEnd()
        port = PySerialPort(far.path, BAUD)
        await port.open()
        return port, far, far.hang_up


class TestPty(PortContract):
    tells_loss = False  # an opener that leaves is normal
    changes_rate = True

    async def make(self) -> tuple[Port, FarEnd, Callable[[], None]]:
        port = open_port("pty", BAUD)
        await port.open()
        far = open_slave(port.name)
        return port, far, far.hang_up

    def follow(self, far: FarEnd, baud: int) -> None:
        termios2.set_raw(far.fd, baud)

    async def test_once_it_follows_a_rate_another_one_is_not_heard(self) -> None:
        port, far, end = await self.make()

        def heard() -> bytes:
            far.send(b"\xe5")
            assert port.fd is not None
            assert select.select([port.fd], [], [], 10)[0]
            return port.read_now()

        assert heard() == b"\xe5"
        port.set_baud(19_200)
        assert heard() == b""  # an opener that sets no rate is at the one the port was made with
        port.set_baud(BAUD)
        assert heard() == b"\xe5"
        self.follow(far, 19_200)
        assert heard() == b""
        end()
        port.close()
        with pytest.raises(BaudError, match="not open"):
            port.set_baud(BAUD)


class TestSocket(PortContract, Reopens):
    async def make(self) -> tuple[Port, FarEnd, Callable[[], None]]:
        far = TcpFarEnd()
        port = open_port(far.path, BAUD)
        await port.open()
        return port, far, far.shut

    def send_stale(self, far: TcpFarEnd) -> None:
        FarEnd.hang_up(far)


def _talk_nonsense(listener: socket.socket, garbage: bytes) -> None:
    client, _ = listener.accept()
    with client:
        client.sendall(garbage)
        while client.recv(4096):
            pass


class TestRfc2217(PortContract, Reopens):
    delivery = Delivery.ADAPTER
    paced = True

    @pytest.fixture(autouse=True)
    def hurried(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """pyserial sleeps 0.3 s when it has hung up, and 0.05 s between two looks for an answer."""
        hurried = types.SimpleNamespace(**vars(time) | {"sleep": lambda seconds: time.sleep(min(seconds, 0.01))})
        monkeypatch.setattr(rfc2217, "time", hurried)

    async def make(self) -> tuple[Port, FarEnd, Callable[[], None]]:
        far = Rfc2217FarEnd()
        port = open_port(far.path, BAUD)
        await port.open()
        assert (far.line.baudrate, far.line.parity) == (BAUD, "E")
        return port, far, far.shut

    @pytest.mark.parametrize(
        "garbage",
        [
            "FF FA 2C 65 00 FF F0",  # IAC SB COM-PORT-OPTION 101 IAC SE: the answer to a rate nobody has set yet
            "FF FA FF F0 FF F1 FF FB 63 FF FD 63 68 65 6C 6C 6F",
        ],
    )
    async def test_a_server_that_does_not_speak_rfc_2217_is_refused_in_one_line_and_without_a_traceback(
        self, garbage: str, capfd: pytest.CaptureFixture[str]
    ) -> None:
        with socket.create_server(("127.0.0.1", 0)) as listener:
            server = threading.Thread(target=_talk_nonsense, args=(listener, bytes.fromhex(garbage)))
            server.start()
            port = open_port(f"rfc2217://127.0.0.1:{listener.getsockname()[1]}?timeout=0.2", BAUD)
            with pytest.raises(PortError, match="does it speak RFC 2217"):
                await port.open()
            port.close()
            server.join()
        assert capfd.readouterr().err == ""

    async def test_more_than_anybody_reads_is_thrown_away_and_counted(self, both: tuple[Port, Any]) -> None:
        port, far = both
        far.send(b"\x55" * 100_000)
        await until(lambda: port.discarded > 0, "octets thrown away")
        assert 0 < len(port.read_now()) < 100_000
        assert port.damage() == {"discarded": port.discarded}


@pytest.mark.parametrize("kind", [TestTty, TestSocket, TestRfc2217])
async def test_a_program_with_a_thousand_open_files(kind: type[PortContract]) -> None:
    """select() takes no descriptor of 1024 and more. pyserial's own serial ports use it: TestPySerial is not here."""
    heard = Heard()
    with many_files_open():
        port, far, shut = await kind().make()
        port.attach(asyncio.get_running_loop(), heard.data, heard.gone)
        far.send(b"in")
        assert await heard.wait(2) == b"in"
        assert port.write(b"out")
        assert await far.recv(3) == b"out"
        port.close()
        shut()


class MemoryFarEnd:
    """The other MemoryPort with the manners of a far end."""

    def __init__(self, far: MemoryPort, near: MemoryPort) -> None:
        self._far, self._near = far, near

    def send(self, octets: bytes) -> None:
        assert self._far.write(octets)

    async def recv(self, _count: int) -> bytes:
        return self._far.read_now()

    def stall(self) -> None:
        """Nothing to do: this end reads only on request."""

    def hang_up(self) -> None:
        self._near.unplug("pulled out")


class TestMemory(PortContract, Reopens):
    changes_rate = True

    async def make(self) -> tuple[Port, MemoryFarEnd, Callable[[], None]]:
        port, far = memory_pair(BAUD)
        await far.open()
        await port.open()
        return port, MemoryFarEnd(far, port), far.close

    def send_stale(self, far: MemoryFarEnd) -> None:
        far.send(b"stale")

    async def test_unplugged_it_cannot_be_opened_until_it_is_plugged(self, both: tuple[MemoryPort, Any]) -> None:
        port = both[0]
        port.unplug("pulled out")
        with pytest.raises(PortError, match="pulled out"):
            await port.open()
        port.plug()
        await port.open()
        assert port.line_baud() == BAUD
