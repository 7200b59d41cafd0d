"""Names of ports, and what is wrong with some. A far end that sends without end: a port hands over a bounded piece,
throws the rest away in blocks and counts it."""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Callable

import pytest
from memory_port import memory_pair

from dpstack.errors import DpError, PortBusyError, PortError
from dpstack.ports import open_port
from dpstack.ports.fdport import CHUNK, FdPort
from dpstack.ports.pyserial import PySerialPort


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("", "no port given"),
        ("http://x:1", "not http://"),
        ("socket://", "socket://host:port"),
        ("socket://host", "socket://host:port"),
        ("socket://host:0", "socket://host:port"),
        ("socket://host:99999", "socket://host:port"),
        ("rfc2217://host:x", "rfc2217://host:port"),
    ],
)
def test_names_that_can_be_no_port(name: str, says: str) -> None:
    with pytest.raises(PortError) as caught:
        open_port(name, 9600)
    assert says in str(caught.value)
    assert isinstance(caught.value, DpError)


def test_a_port_object_is_passed_through() -> None:
    port, _far = memory_pair(9600)
    assert open_port(port, 12_000_000) is port


def test_ipv6_hosts_are_written_in_brackets() -> None:
    assert open_port("socket://[::1]:7000", 9600).name == "socket://[::1]:7000"


def _free_tcp_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


@pytest.mark.parametrize("scheme", ["socket", "rfc2217"])
async def test_a_server_that_is_not_there(scheme: str) -> None:
    port = open_port(f"{scheme}://127.0.0.1:{_free_tcp_port()}", 9600)
    with pytest.raises(PortError, match="running"):
        await port.open()


async def test_a_socket_says_that_the_far_end_has_the_rate() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = open_port(f"socket://127.0.0.1:{server.getsockname()[1]}", 187_500)
        await port.open()
        assert port.notices == ["the far end must be set to 187500 bit/s 8E1 itself"]
        port.close()


async def test_other_systems_use_pyserial(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    port = open_port("/dev/cu.usbserial-1420", 9600)
    assert isinstance(port, PySerialPort)
    with pytest.raises(PortError, match="check the name"):
        await port.open()
    with pytest.raises(PortError, match="needs Linux"):
        open_port("pty", 9600)


async def test_a_port_held_under_pyserial_is_busy() -> None:
    import os

    master, slave = os.openpty()
    path = os.ttyname(slave)
    os.close(slave)
    first, second = PySerialPort(path, 9600), PySerialPort(path, 9600)
    await first.open()
    with pytest.raises(PortBusyError, match="held"):
        await second.open()
    first.close()
    os.close(master)


HANDED_OVER = 64 * CHUNK


class Line(FdPort):
    """A port on ``read`` instead of a descriptor."""

    def __init__(self, read: Callable[[int], bytes]) -> None:
        super().__init__("line", 500_000, paced=False)
        self._read = read


def test_a_backlog_is_handed_over_up_to_its_bound_and_the_rest_counted() -> None:
    near, far = os.pipe()
    os.set_blocking(near, False)
    try:
        port = Line(lambda size: os.read(near, size))
        os.write(far, bytes(60_000))
        assert len(port.read_now()) == HANDED_OVER == 30_080
        assert port.discarded == 60_000 - HANDED_OVER
        assert port.damage() == {"discarded": 60_000 - HANDED_OVER}
        assert port.read_now() == b""
        os.write(far, b"\xe5")
        assert port.read_now() == b"\xe5"
    finally:
        os.close(near)
        os.close(far)


def test_a_far_end_that_never_stops_does_not_hold_the_caller() -> None:
    reads: list[int] = []

    def endless(size: int) -> bytes:
        reads.append(size)
        return b"\x55" * size

    port = Line(endless)
    assert len(port.read_now()) == HANDED_OVER
    assert reads == [CHUNK] * 64 + [65_536] * 16
    assert port.discarded == 16 * 65_536


def test_octets_within_the_bound_are_all_delivered() -> None:
    chunks = [bytes(CHUNK)] * 10 + [b"\xe5"]
    port = Line(lambda _size: chunks.pop(0))
    assert len(port.read_now()) == 10 * CHUNK + 1
    assert port.discarded == 0
    assert port.damage() == {}
