"""The Linux tty: what is set, what is refused, and that every refusal says what to do; the marks of damaged characters,
by the octets of termios(3)."""

from __future__ import annotations

import asyncio
import errno
import fcntl
import glob
import grp
import itertools
import os
import subprocess
import sys
import termios
from collections.abc import Iterator
from pathlib import Path

import pytest
from far_ends import PtyFarEnd
from hypothesis import given
from hypothesis import strategies as st

from dpstack.errors import BaudError, PortBusyError, PortError
from dpstack.ports import Delivery, termios2, tty
from dpstack.ports.tty import TtyPort, Unmarker
from dpstack.units import BAUD_RATES


@pytest.fixture
def port(far: PtyFarEnd) -> Iterator[TtyPort]:
    """A port at 9.6 kbit/s, not yet opened; closed at the end."""
    port = TtyPort(far.path, 9_600)
    yield port
    port.close()


@pytest.mark.parametrize("baud", BAUD_RATES)
async def test_every_rate_is_set_and_seen_from_the_other_end(far: PtyFarEnd, baud: int) -> None:
    port = TtyPort(far.path, baud)
    for _ in range(2):  # a second open at the same rate is where the C library reports EINVAL on a pty
        await port.open()
        assert termios2.RateReader().read(far.fd) == baud
        assert port.line_baud() == baud
        assert any("no parity" in notice for notice in port.notices)
        port.close()


async def test_the_rate_of_an_open_tty_is_changed_without_closing(far: PtyFarEnd, port: TtyPort) -> None:
    with pytest.raises(BaudError, match="is not open"):
        port.set_baud(19_200)
    await port.open()
    notices = list(port.notices)
    for baud in BAUD_RATES:
        far.send(b"of the old rate")
        port.set_baud(baud)
        assert port.read_now() == b""
        assert termios2.RateReader().read(far.fd) == port.baud == baud
    assert port.notices == notices


async def test_a_rate_that_is_refused_while_open_leaves_the_old_one(
    far: PtyFarEnd, port: TtyPort, monkeypatch: pytest.MonkeyPatch
) -> None:
    await port.open()
    really = termios2.set_raw

    def divided(fd: int, baud: int | None, *, marks: bool) -> termios2.Applied:
        return really(fd, 3_000_000 if baud == 12_000_000 else baud, marks=marks)

    monkeypatch.setattr(termios2, "set_raw", divided)
    with pytest.raises(BaudError, match=r"cannot do 12 Mbit/s, it set itself to 3 Mbit/s"):
        port.set_baud(12_000_000)
    assert termios2.RateReader().read(far.fd) == port.baud == 9_600


async def test_raw_without_echo_and_flow_control(port: TtyPort) -> None:
    await port.open()
    assert port.fd is not None
    iflag, oflag, cflag, lflag, *_ = termios.tcgetattr(port.fd)
    assert (oflag, lflag) == (0, 0)
    assert iflag == termios.INPCK | termios.IGNPAR | termios.IGNBRK
    assert cflag & termios.CSIZE == termios.CS8
    assert not cflag & (termios.CSTOPB | termios.CRTSCTS)
    assert cflag & termios.HUPCL  # at the last close the kernel lowers RTS and DTR


def test_even_parity_is_asked_for_in_the_same_call(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[tuple[int, bytes]] = []
    layout = termios2._LAYOUT

    def ioctl(_fd: int, request: int, argument: bytearray | bytes, _mutate: bool = True) -> int:
        if request == termios2.TCSETS2:
            calls.append((request, bytes(argument)))
        elif calls and isinstance(argument, bytearray):
            argument[:] = calls[-1][1]
        return 0

    monkeypatch.setattr(fcntl, "ioctl", ioctl)
    assert termios2.set_raw(7, 187_500) == termios2.Applied(187_500, True)
    ((_request, octets),) = calls
    _i, _o, cflag, _l, _line, _cc, ispeed, ospeed = layout.unpack(octets)
    assert cflag & termios.PARENB
    assert not cflag & termios.PARODD
    assert (ispeed, ospeed) == (187_500, 187_500)


async def _refused(port: TtyPort, kind: type[PortError] = PortError) -> str:
    with pytest.raises(kind) as caught:
        await port.open()
    text = str(caught.value)
    assert "\n" not in text
    assert port.name in text
    assert port.fd is None
    return text


async def test_a_substituted_rate_is_refused_with_both(far: PtyFarEnd, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(termios2, "set_raw", lambda _fd, _baud, marks: termios2.Applied(9_600, True))
    text = await _refused(TtyPort(far.path, 12_000_000), BaudError)
    assert "12 Mbit/s" in text
    assert "9.6 kbit/s" in text


async def test_a_rate_divided_nearly_right_is_taken_with_a_notice(
    far: PtyFarEnd, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(termios2, "set_raw", lambda _fd, _baud, marks: termios2.Applied(45_455, True))
    port = TtyPort(far.path, 45_450)
    await port.open()
    assert port.notices == ["runs at 45455 bit/s instead of 45450"]
    port.close()


async def test_a_rate_the_driver_refuses(far: PtyFarEnd, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_fd: int, _baud: int, *, marks: bool) -> termios2.Applied:
        raise OSError(errno.EINVAL, "Invalid argument")

    monkeypatch.setattr(termios2, "set_raw", refuse)
    assert "6 Mbit/s 8E1" in await _refused(TtyPort(far.path, 6_000_000), BaudError)


async def test_a_far_end_that_never_stops_does_not_hold_the_reader(port: TtyPort) -> None:
    await port.open()
    port._read = bytes
    assert len(port.read_now()) > 4096  # more than a pty holds for its reader


async def test_a_missing_port_names_those_that_exist(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tty, "existing_ports", lambda: ["/dev/ttyUSB0", "/dev/ttyUSB1"])
    assert "these exist: /dev/ttyUSB0, /dev/ttyUSB1" in await _refused(TtyPort("/dev/ttyUSB9", 9600))
    monkeypatch.setattr(tty, "existing_ports", list)
    text = await _refused(TtyPort("/dev/ttyUSB9", 9600))
    assert "no serial adapter is plugged in" in text


async def test_a_device_that_is_no_tty_is_named(tmp_path: Path) -> None:
    file = tmp_path / "notes.txt"
    file.write_text("hello")
    assert "but a file" in await _refused(TtyPort(str(file), 9600))
    assert "another device" in await _refused(TtyPort("/dev/null", 9600))
    assert "a directory" in await _refused(TtyPort(str(tmp_path), 9600))


@pytest.mark.parametrize(
    ("number", "kind", "says"),
    [
        (errno.EACCES, PortError, "no permission; "),
        (errno.EBUSY, PortBusyError, "held by another program"),
        (errno.ENXIO, PortError, "no device behind it"),
        (errno.EIO, PortError, "no device behind it"),
        (errno.EMFILE, PortError, "cannot be opened (Too many open files)"),
    ],
)
async def test_refusals_of_the_system_name_a_remedy(
    far: PtyFarEnd, monkeypatch: pytest.MonkeyPatch, number: int, kind: type[PortError], says: str
) -> None:
    def refuse(*_args: object) -> int:
        raise OSError(number, os.strerror(number))

    port = TtyPort(far.path, 9600)
    monkeypatch.setattr(os, "open", refuse)
    assert says in await _refused(port, kind)
    monkeypatch.undo()


@pytest.mark.parametrize(
    ("group", "says"),
    [("dialout", "add yourself to the group dialout (sudo usermod -aG dialout $USER)"), ("root", "udev rule")],
)
def test_a_port_without_permission_is_refused_with_advice(
    far: PtyFarEnd, monkeypatch: pytest.MonkeyPatch, group: str, says: str
) -> None:
    class Group:
        gr_name = group

    monkeypatch.setattr(grp, "getgrgid", lambda _gid: Group)
    assert says in tty.how_to_be_permitted(far.path)


async def test_a_held_port_names_its_holder(far: PtyFarEnd, port: TtyPort) -> None:
    await port.open()
    assert f"this program itself (pid {os.getpid()})" in await _refused(TtyPort(far.path, 9600), PortBusyError)
    port.close()
    code = (
        "import fcntl, os, sys; fd = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY);"
        "fcntl.flock(fd, fcntl.LOCK_EX); print('held', flush=True); sys.stdin.read()"
    )
    holder = await asyncio.create_subprocess_exec(
        sys.executable, "-c", code, far.path, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert holder.stdout is not None
    assert await holder.stdout.readline() == b"held\n"
    assert f"(pid {holder.pid})" in await _refused(port, PortBusyError)
    await holder.communicate(b"")
    await port.open()


async def test_a_closed_port_is_free_though_a_process_was_forked_meanwhile(far: PtyFarEnd) -> None:
    """``multiprocessing`` with fork: the child has every descriptor, and lives on."""
    port = TtyPort(far.path, 9600)
    await port.open()
    forked = os.dup(port._fd)  # the same open file, as a fork's
    try:
        port.close()
        again = TtyPort(far.path, 9600)
        await again.open()
        again.close()
    finally:
        os.close(forked)


async def test_a_port_that_cannot_be_locked_is_used_with_a_notice(
    port: TtyPort, monkeypatch: pytest.MonkeyPatch
) -> None:
    def flock(_fd: int, _how: int) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", flock)
    await port.open()
    assert any("cannot be locked" in notice for notice in port.notices)


def test_a_pty_has_no_pace_a_uart_has(far: PtyFarEnd, tmp_path: Path) -> None:
    link = tmp_path / "0"
    link.symlink_to(far.path)
    assert TtyPort(str(link), 9600).delivery is Delivery.HOST
    assert not TtyPort(str(link), 9600).paced
    assert TtyPort(str(link), 9600, paced=True).paced
    assert TtyPort("/dev/ttyUSB9", 9600).paced
    assert TtyPort("/dev/ttyUSB9", 9600).delivery is Delivery.ADAPTER


@pytest.mark.parametrize("marks", [False, True])
async def test_a_genuine_ff_arrives_once_with_marks_and_without(far: PtyFarEnd, marks: bool) -> None:
    port = TtyPort(far.path, 9600, marks=marks)
    await port.open()
    assert port.fd is not None
    iflag = termios.tcgetattr(port.fd)[0]
    assert iflag & (termios.PARMRK | termios.IGNPAR) == (termios.PARMRK if marks else termios.IGNPAR)
    arrived = bytearray()
    done = asyncio.Event()

    def on_data(chunk: bytes) -> None:
        arrived.extend(chunk)
        if len(arrived) == 6:
            done.set()

    port.attach(asyncio.get_running_loop(), on_data, lambda reason: pytest.fail(reason))
    os.write(far.fd, bytes.fromhex("68ff0016ffff"))
    await asyncio.wait_for(done.wait(), 5)
    assert arrived.hex() == "68ff0016ffff"
    assert port.damage() == ({"marked": 0} if marks else {})
    port.close()


async def test_marked_octets_are_dropped_and_counted(far: PtyFarEnd, monkeypatch: pytest.MonkeyPatch) -> None:
    """A pty cannot damage anything: what a UART's tty would deliver is put in front of the reader."""
    port = TtyPort(far.path, 9600, marks=True)
    await port.open()
    chunks = [bytes.fromhex("ff0068"), bytes.fromhex("10ff"), bytes.fromhex("ff03ff00"), bytes.fromhex("5516"), b""]
    monkeypatch.setattr(os, "read", lambda _fd, _size: chunks.pop(0))
    assert port.read_now() == b""  # nothing but a mark is no end of the line
    assert port.read_now().hex() == "10"
    assert port.read_now().hex() == "ff03"
    assert port.read_now().hex() == "16"
    assert port.damage() == {"marked": 2}
    monkeypatch.undo()
    port.close()


def test_adapters_are_listed_with_their_lasting_names(monkeypatch: pytest.MonkeyPatch) -> None:
    found = {
        "/dev/serial/by-id/*": ["/dev/serial/by-id/usb-FTDI_0"],
        "/dev/ttyUSB*": ["/dev/ttyUSB0"],
        "/dev/ttyACM*": ["/dev/ttyACM3"],
    }
    monkeypatch.setattr(glob, "glob", lambda pattern: found.get(pattern, []))
    monkeypatch.setattr(os.path, "realpath", lambda _path: "/dev/ttyUSB0")
    assert tty.existing_ports() == ["/dev/ttyACM3", "/dev/ttyUSB0 (/dev/serial/by-id/usb-FTDI_0)"]


#: delivered, intact, damaged, odd
CASES = [
    ("", "", 0, 0),
    ("6809096803027d16", "6809096803027d16", 0, 0),
    ("68ffff0016", "68ff0016", 0, 0),  # as measured on a tty: a genuine FF is doubled
    ("ff0068", "", 1, 0),
    ("10ff000316", "1016", 1, 0),
    ("ff00ff16", "16", 1, 0),  # the damaged octet is FF itself: it is not doubled in a mark
    ("ff0000", "", 1, 0),
    ("ffffff0003ffff", "ffff", 1, 0),
    ("ff03e5", "ff03e5", 0, 1),
    ("ffffffff", "ffff", 0, 0),
]


@pytest.mark.parametrize(("delivered", "intact", "damaged", "odd"), CASES)
def test_marks_cut_at_any_place_are_read(delivered: str, intact: str, damaged: int, odd: int) -> None:
    octets = bytes.fromhex(delivered)
    cuts = range(len(octets) + 1)
    for first, second in itertools.combinations_with_replacement(cuts, 2):
        unmarker = Unmarker()
        chunks = (octets[:first], octets[first:second], octets[second:])
        assert b"".join(unmarker.feed(chunk) for chunk in chunks).hex() == intact
        assert (unmarker.damaged, unmarker.odd) == (damaged, odd)


def test_a_mark_that_has_begun_is_forgotten_when_the_line_is_opened_anew() -> None:
    for begun in ("ff", "ff00"):
        unmarker = Unmarker()
        assert unmarker.feed(bytes.fromhex("e5" + begun)) == b"\xe5"
        unmarker.reset()
        assert unmarker.feed(b"\x00\x16") == b"\x00\x16"
        assert unmarker.damaged == 0


def test_a_chunk_without_ff_is_not_copied() -> None:
    chunk = bytes(range(200))
    assert Unmarker().feed(chunk) is chunk


@given(st.lists(st.tuples(st.integers(0, 255), st.booleans())), st.data())
def test_the_marks_of_a_tty_are_undone(characters: list[tuple[int, bool]], data: st.DataObject) -> None:
    wire = bytearray()
    for octet, good in characters:
        if not good:
            wire += bytes((0xFF, 0, octet))
        elif octet == 0xFF:
            wire += b"\xff\xff"
        else:
            wire.append(octet)
    unmarker = Unmarker()
    kept = bytearray()
    while wire:
        size = data.draw(st.integers(1, len(wire)))
        kept += unmarker.feed(bytes(wire[:size]))
        del wire[:size]
    assert bytes(kept) == bytes(octet for octet, good in characters if good)
    assert unmarker.damaged == sum(not good for _, good in characters)
