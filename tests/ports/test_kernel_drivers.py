"""Classes of Linux's serial drivers: rates that a chip does not make, modes that are not there, marks that do not come.

The answers of the drivers are those that tests/strangers/kernel saw.
"""

from __future__ import annotations

import os
import termios
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fake_adapter import FakeDriver, plug_in
from far_ends import PtyFarEnd
from msgspec import structs

from dpstack.errors import BaudError
from dpstack.ports import termios2, tuning
from dpstack.ports.adapters import probe
from dpstack.ports.kernel_drivers import Marks, kernel_driver
from dpstack.ports.tty import TtyPort

Make = Callable[..., TtyPort]


@pytest.fixture
def driver(monkeypatch: pytest.MonkeyPatch) -> FakeDriver:
    """Of a pty that passes for an adapter: with parity, which a pty does not keep."""
    fake = FakeDriver(monkeypatch)
    really = termios2.set_raw

    def with_parity(fd: int, baud: int | None, *, marks: bool = False) -> termios2.Applied:
        return structs.replace(really(fd, baud, marks=marks), parity=True)

    monkeypatch.setattr(termios2, "set_raw", with_parity)
    monkeypatch.setattr("dpstack.ports.tty.is_pty_path", lambda _name: False)
    return fake


@pytest.fixture
def make(far: PtyFarEnd, driver: FakeDriver, tmp_path: Path) -> Make:
    """A port behind the driver ``name`` of a USB adapter; None: a UART of the computer."""

    def port(name: str | None, baud: int = 187_500, **options: Any) -> TtyPort:
        if name is not None:
            plug_in(tmp_path, os.path.basename(far.path), usb="1a86:7523", driver=name, latency=None)
        return TtyPort(far.path, baud, sysfs=tmp_path, **options)

    return port


@pytest.mark.parametrize(("baud", "made"), [(31_250, 28_800), (45_450, 38_400), (93_750, 115_200), (187_500, 115_200)])
def test_a_rate_that_a_whole_divisor_does_not_make_is_refused(
    make: Make, driver: FakeDriver, baud: int, made: int
) -> None:
    """The 16550 of a PC: its driver reads the wish back, whatever the divisor makes."""
    driver.uart = (4, 115_200)
    with pytest.raises(BaudError, match=rf"makes {made / 1000:g} kbit/s of it"):
        make(None, baud).open_now()


def test_rates_of_a_uart_that_its_divisor_makes(make: Make, driver: FakeDriver) -> None:
    for kind, base, baud in ((4, 115_200, 19_200), (4, 1_500_000, 187_500), (24, 115_200, 93_750), (0, 0, 93_750)):
        driver.uart = (kind, base)
        port = make(None, baud)
        port.open_now()
        assert port.baud == baud
        port.close()


def test_ch341_makes_no_more_than_3_mbit(make: Make) -> None:
    port = make("ch341-uart", 3_000_000)
    port.open_now()
    with pytest.raises(BaudError, match="its driver ch341-uart sends its chip 3 Mbit/s at most"):
        port.set_baud(6_000_000)
    assert port.baud == 3_000_000
    port.close()


def test_a_driver_that_keeps_its_rate_does_not_name_it(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    applied = termios2.Applied(93_750, True, kept=True)
    monkeypatch.setattr(termios2, "set_raw", lambda _fd, _baud, marks: applied)
    with pytest.raises(BaudError, match="its driver keeps the rate that was set before"):
        make(None).open_now()


def test_zeros_of_tiocgrs485_are_no_rs485_mode(make: Make, driver: FakeDriver, far: PtyFarEnd) -> None:
    driver.lacks = {tuning.TIOCSRS485}  # as the UART of a PC answers
    port = make(None)
    port.open_now()
    assert port.notices == ["its driver has no RS-485 mode (see `dpstack doctor`)"]
    port.close()
    assert not probe(far.path).rs485


def test_a_low_latency_mode_that_does_not_read_back_is_none(make: Make, driver: FakeDriver, far: PtyFarEnd) -> None:
    driver.deaf = {tuning.TIOCSSERIAL}  # ch341, cp210x, pl2303, cdc_acm
    port = make(None)
    port.open_now()
    assert port.notices == ["its driver has no low-latency mode (see `dpstack doctor`)"]
    port.close()
    assert not probe(far.path).low_latency


@pytest.mark.parametrize(
    ("name", "marks", "distance"),
    [
        ("ftdi_sio", Marks.PACKET, 4),
        ("cp210x", Marks.OCTET, 4),
        ("ch341-uart", Marks.NONE, 2),
        ("pl2303", Marks.MISPLACED, None),
        ("cdc_acm", Marks.COUNTED, None),
        ("xr_serial", Marks.UNKNOWN, None),
    ],
)
def test_the_start_says_what_protects_the_data(make: Make, name: str, marks: Marks, distance: int | None) -> None:
    port = make(name)
    port.open_now()
    assert (port.driver.marks, port.driver.distance) == (marks, distance)
    weak = [notice for notice in port.notices if "two" in notice]
    assert len(weak) == (0 if distance == 4 else 1)
    if distance == 2:
        assert "one wrong bit in a telegram is noticed, two may pass as good data (Hamming distance 2)" in weak[0]
    elif distance is None:
        assert "no Hamming distance can be promised" in weak[0]
    assert (port.damaged_octets == "the port drops octets with a parity or framing error") == (
        marks in (Marks.PACKET, Marks.OCTET, Marks.MISPLACED)
    )
    port.close()


def test_a_rate_that_nobody_can_know_is_reported(make: Make) -> None:
    port = make("cdc_acm")
    port.open_now()
    assert "its driver cdc_acm does not say which rate the adapter makes" in port.notices
    port.close()


def test_counted_damage_drops_what_comes_with_it_and_puts_the_rest_in_doubt(
    make: Make, driver: FakeDriver, far: PtyFarEnd
) -> None:
    """cdc_acm: the count comes at another endpoint, perhaps after the octets."""
    port = make("cdc_acm")
    port.open_now()
    doubts: list[int] = []
    port.on_doubt = doubts.append
    assert driver.counts is not None
    far.send(b"\x68\x11")
    assert port.read_now() == b"\x68\x11"
    assert doubts == []
    driver.counts[8] += 1  # parity
    far.send(b"\x22\x33")
    assert port.read_now() == b""
    assert doubts == [255_000_000]
    far.send(b"\x44")
    assert port.read_now() == b"\x44"
    driver.counts[6] += 1  # frame
    assert port.read_now() == b""  # nothing was there: looked at with the next octets
    assert len(doubts) == 1
    far.send(b"\x55")
    assert port.read_now() == b""
    assert len(doubts) == 2
    port.close()


def test_no_other_driver_is_asked_for_its_counters_while_reading(
    make: Make, driver: FakeDriver, far: PtyFarEnd
) -> None:
    port = make("ftdi_sio")
    port.open_now()
    driver.asked.clear()
    far.send(b"\x68\x11")
    assert port.read_now() == b"\x68\x11"
    assert driver.asked == []
    port.close()


def test_a_hardware_tty_is_opened_for_nobody_else(make: Make, driver: FakeDriver, far: PtyFarEnd) -> None:
    port = make("ftdi_sio")
    port.open_now()
    assert termios.TIOCEXCL in driver.asked
    assert termios.TIOCNXCL not in driver.asked
    port.close()
    assert termios.TIOCNXCL in driver.asked


def test_a_pty_is_not(far: PtyFarEnd, monkeypatch: pytest.MonkeyPatch) -> None:
    """There the flag would outlive the last close."""
    driver = FakeDriver(monkeypatch)
    port = TtyPort(far.path, 9_600)
    port.open_now()
    port.close()
    assert not {termios.TIOCEXCL, termios.TIOCNXCL} & set(driver.asked)


def test_space_parity_left_by_another_program_is_cleared_and_the_rest_is_reported(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """CMSPAR makes space parity of even parity."""
    cmspar, sent = 0o10000000000, []
    kept = termios2._LAYOUT.pack(0, 0, cmspar | termios.PARENB | termios.CSTOPB | termios.CS7, 0, 0, bytes(19), 9, 9)

    def ioctl(_fd: int, request: int, argument: bytearray | bytes, _mutate: bool = True) -> int:
        if request == termios2.TCSETS2:
            sent.append(termios2._LAYOUT.unpack(argument)[2])
        else:
            assert isinstance(argument, bytearray)
            argument[:] = kept
        return 0

    monkeypatch.setattr("fcntl.ioctl", ioctl)
    applied = termios2.set_raw(7, 9)
    assert not sent[0] & (cmspar | termios.CSTOPB)
    assert sent[0] & termios.HUPCL
    assert applied.differs == ("not 8 data bits", "two stop bits", "mark or space parity")


def test_settings_that_read_back_otherwise_are_reported(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    applied = termios2.Applied(187_500, True, True, ("two stop bits",))
    monkeypatch.setattr(termios2, "set_raw", lambda _fd, _baud, marks: applied)
    port = make("ftdi_sio")
    port.open_now()
    assert "reads back with two stop bits, where 8E1 was asked for: the bus needs 8E1" in port.notices
    port.close()


def test_a_pulled_plug_is_called_so(make: Make, far: PtyFarEnd) -> None:
    port = make("ftdi_sio")
    port.open_now()
    lost: list[str] = []

    class Loop:
        def add_reader(self, _fd: int, callback: Callable[[], object], /) -> None:
            self.read = callback

        def remove_reader(self, _fd: int, /) -> None: ...

        def is_closed(self) -> bool:
            return False

    loop: Any = Loop()
    port.attach(loop, lambda _octets: None, lost.append)
    far.hang_up()
    loop.read()
    assert lost == ["the adapter is gone: its plug was pulled, or it lost its power"]
    port.close()


def test_every_class_says_which_rates_it_has() -> None:
    assert kernel_driver("ch341-uart", usb=True).rates == "up to 3 Mbit/s"
    assert "the adapter alone knows" in kernel_driver("cdc_acm", usb=True).rates
    assert kernel_driver("serial", usb=False).distance == 4
    assert "its clock divides" in kernel_driver("serial", usb=False).rates
    assert kernel_driver("ftdi_sio", usb=True).rates == "those that read back"
    assert "not so with a counterfeit CP2102" in kernel_driver("cp210x", usb=True).protection


# --- other programs at the port ---


def inspected(port: TtyPort) -> list[str]:
    look = port.inspection()
    assert look is not None
    return look()


def test_settings_of_another_program_are_set_again_and_reported(
    make: Make, far: PtyFarEnd, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dpstack.ports.tty.other_openers", lambda _path: [])
    monkeypatch.setattr("dpstack.ports.tty.hides_programs", lambda: True)
    port = make("ftdi_sio")
    port.open_now()
    assert inspected(port) == []
    other = os.open(far.path, os.O_RDWR | os.O_NOCTTY)
    attributes = termios.tcgetattr(other)
    attributes[2] |= termios.CSTOPB
    attributes[4] = attributes[5] = termios.B9600
    termios.tcsetattr(other, termios.TCSANOW, attributes)
    os.close(other)
    assert inspected(port) == [
        "another program has set it to 9.6 kbit/s, another frame than 8E1; it is set to 187.5 kbit/s 8E1 again: a "
        "process of another user may have it, which only root can see (sudo fuser -v)"
    ]
    assert termios2.RateReader().read(far.fd) == 187_500
    assert inspected(port) == []
    port.close()
    assert port.inspection() is None


def test_another_reader_is_named_with_the_line_that_keeps_it_off(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dpstack.ports.tty.other_openers", lambda _path: ["gpsd (pid 41)", "cat (pid 42)"])
    port = make("ftdi_sio")
    port.open_now()
    gpsd, cat = inspected(port)
    assert gpsd.startswith("gpsd (pid 41) has it open, too, and takes octets away: it opens adapters by itself")
    assert gpsd.endswith('ATTRS{idVendor}=="1a86", ATTRS{idProduct}=="7523", ENV{SYSTEMD_WANTS}=""')
    assert cat == "cat (pid 42) has it open, too, and takes octets away: end that program"
    port.close()


def test_a_pty_has_nothing_to_look_at(far: PtyFarEnd) -> None:
    port = TtyPort(far.path, 9_600)
    port.open_now()
    assert port.inspection() is None
    port.close()
