"""A port opened for listening: nothing is written, RTS is dropped first, damaged octets keep their place."""

from __future__ import annotations

import fcntl
import os
import termios
from pathlib import Path
from typing import Any

import pytest
from fake_adapter import FakeDriver, plug_in
from far_ends import PtyFarEnd, Rfc2217FarEnd
from hypothesis import given
from hypothesis import strategies as st

from dpstack.phy.marked import MarkedOctets
from dpstack.ports import open_port
from dpstack.ports.pyserial import PySerialPort
from dpstack.ports.tty import TtyPort, Unmarker


def test_it_is_opened_for_reading_only_and_writes_nothing(far: PtyFarEnd) -> None:
    port = open_port(far.path, 9_600, listen=True)
    port.open_now()
    try:
        assert port.fd is not None
        assert fcntl.fcntl(port.fd, fcntl.F_GETFL) & os.O_ACCMODE == os.O_RDONLY
        assert not port.write(b"\xe5")
        assert far.take() == b""
        far.send(b"\xdc\x02\x02")
        assert port.read_now() == b"\xdc\x02\x02"
    finally:
        port.close()


def test_rts_is_dropped_before_anything_else_and_rs485_is_left_alone(
    far: PtyFarEnd, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver = FakeDriver(monkeypatch)
    asked: list[tuple[int, Any]] = []

    def ioctl(fd: int, request: int, argument: Any = b"", mutate: bool = True) -> int:
        asked.append((request, bytes(argument)))
        return 0 if request == termios.TIOCMBIC else driver.ioctl(fd, request, argument, mutate)

    monkeypatch.setattr(fcntl, "ioctl", ioctl)
    monkeypatch.setattr("dpstack.ports.tty.is_pty_path", lambda _name: False)
    port = TtyPort(far.path, 9_600, listen=True, sysfs=tmp_path)
    port.open_now()
    port.close()
    assert asked[0] == (termios.TIOCMBIC, termios.TIOCM_RTS.to_bytes(4, "little"))
    assert driver.rs485 == [0] * 8
    assert not any("RTS" in notice for notice in port.notices)


def test_a_port_whose_rts_cannot_be_dropped_says_so(
    far: PtyFarEnd, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    FakeDriver(monkeypatch).refuses = {termios.TIOCMBIC}
    monkeypatch.setattr("dpstack.ports.tty.is_pty_path", lambda _name: False)
    plug_in(tmp_path, os.path.basename(far.path))
    port = TtyPort(far.path, 9_600, listen=True, sysfs=tmp_path)
    port.open_now()
    port.close()
    assert any("RTS line cannot be dropped" in notice for notice in port.notices)


async def test_a_port_of_pyserial_writes_nothing(far: PtyFarEnd) -> None:
    port = PySerialPort(far.path, 9_600, listen=True)
    await port.open()
    try:
        assert port._serial.rts is False
        assert not port.write(b"\xe5")
        assert far.take() == b""
    finally:
        port.close()


async def test_a_server_is_asked_to_drop_rts() -> None:
    far = Rfc2217FarEnd()
    port = open_port(far.path, 9_600, listen=True)
    try:
        await port.open()
        assert far.line.rts is False
        assert not port.write(b"\xe5")
        assert far.take() == b""
    finally:
        port.close()
        far.shut()


@given(st.lists(st.tuples(st.integers(0, 255), st.booleans()), max_size=20), st.data())
def test_marked_octets_keep_their_places(characters: list[tuple[int, bool]], data: st.DataObject) -> None:
    wire = bytearray()
    for octet, good in characters:
        wire += bytes((octet,)) * (1 + (octet == 0xFF)) if good else bytes((0xFF, 0, octet))
    unmarker = Unmarker(keep=True)
    kept = b""
    while wire:
        size = data.draw(st.integers(1, len(wire)))
        kept += unmarker.feed(bytes(wire[:size]))
        del wire[:size]
    assert bytes(kept) == bytes(octet for octet, _ in characters)
    marks = kept.marks if isinstance(kept, MarkedOctets) else ()
    assert marks == tuple(place for place, (_, good) in enumerate(characters) if not good)


@pytest.mark.parametrize(
    ("delivered", "driver", "packets"),
    [("1002ff006349", False, False), ("ff0010ff0002", False, True), ("ff0010", False, False), ("ff001002", True, True)],
    ids=["one octet", "all octets", "the only octet", "a driver that marks packets"],
)
def test_marks_of_whole_packets(delivered: str, driver: bool, packets: bool) -> None:
    unmarker = Unmarker(keep=True)
    unmarker.packets = driver
    found = unmarker.feed(bytes.fromhex(delivered))
    assert isinstance(found, MarkedOctets)
    assert found.packets is packets
