"""The list of adapters, what is found out about one by opening it, and the settings of its driver: made, restored at
the end, a notice where they are missing or refused."""

from __future__ import annotations

import errno
import os
from dataclasses import dataclass
from pathlib import Path

import pytest
from fake_adapter import FakeDriver, plug_in
from far_ends import PtyFarEnd
from msgspec import structs

from dpstack.errors import PortError
from dpstack.ports import Delivery, termios2
from dpstack.ports.adapters import list_adapters, probe
from dpstack.ports.sysfs import CHIPS, Adapter
from dpstack.ports.tty import TtyPort
from dpstack.ports.tuning import Tuning
from dpstack.units import BAUD_RATES


@dataclass
class Found:
    """The attributes of a port that pyserial finds."""

    device: str
    description: str = "n/a"
    vid: int | None = None
    pid: int | None = None
    serial_number: str | None = None


def test_adapters_with_chip_lasting_name_and_holder(tmp_path: Path) -> None:
    usb0, usb1 = tmp_path / "ttyUSB0", tmp_path / "ttyUSB1"
    usb0.touch()
    usb1.touch()
    by_id = tmp_path / "by-id"
    by_id.mkdir()
    (by_id / "usb-FTDI_1").symlink_to(usb0)
    plug_in(tmp_path / "sys", "ttyUSB0")
    holder = tmp_path / "proc" / "41"
    (holder / "fd").mkdir(parents=True)
    (holder / "comm").write_text("minicom\n")
    (holder / "fd" / "3").symlink_to(usb0)
    listed = list_adapters(
        lambda: [
            Found("/dev/ttyS0"),
            Found(str(usb1), "USB2.0-Serial", 0x1111, 0x2222),
            Found(str(usb0), "FT232R USB UART", 0x0403, 0x6001, "A1"),
        ],
        by_id=by_id,
        sysfs=tmp_path / "sys",
        proc=tmp_path / "proc",
    )
    assert [adapter.as_dict() for adapter in listed] == [
        {
            "path": "/dev/ttyS0",
            "by_id": None,
            "chip": "",
            "driver": None,
            "usb": None,
            "serial": None,
            "holder": None,
            "marks": "octet",
            "hamming_distance": 4,
            "max_baud": None,
        },
        {
            "path": str(usb0),
            "by_id": str(by_id / "usb-FTDI_1"),
            "chip": "FTDI FT232R",
            "driver": "ftdi_sio",
            "usb": "0403:6001",
            "serial": "A1",
            "holder": "minicom (pid 41)",
            "marks": "packet",
            "hamming_distance": 4,
            "max_baud": None,
        },
        {
            "path": str(usb1),
            "by_id": None,
            "chip": "USB2.0-Serial",
            "driver": None,
            "usb": "1111:2222",
            "serial": None,
            "holder": None,
            "marks": "unknown",
            "hamming_distance": None,
            "max_baud": None,
        },
    ]


def test_the_real_list_can_be_made() -> None:
    assert all(adapter.path.startswith("/dev/") for adapter in list_adapters())


def test_chips_are_named_by_their_usb_identity() -> None:
    for usb, (chip, most) in CHIPS.items():
        assert len(usb) == 9
        assert usb == usb.lower()
        assert chip
        assert most in BAUD_RATES or most == 2_000_000


def test_a_pty_takes_every_rate_and_has_nothing(far: PtyFarEnd) -> None:
    can = probe(far.path)
    assert tuple(can.rates) == tuple(BAUD_RATES)
    assert (can.parity, can.low_latency, can.rs485, can.counters, can.marks) == (False, False, False, False, True)


def test_a_driver_that_has_all_but_the_high_rates(far: PtyFarEnd, monkeypatch: pytest.MonkeyPatch) -> None:
    FakeDriver(monkeypatch)
    real = termios2.set_raw

    def at_most_1500k(fd: int, baud: int | None, *, marks: bool = False) -> termios2.Applied:
        if baud is not None and baud > 1_500_000:
            raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))
        return structs.replace(real(fd, baud, marks=marks), parity=True)

    monkeypatch.setattr(termios2, "set_raw", at_most_1500k)
    can = probe(far.path)
    assert can.rates == [9600, 19200, 31250, 45450, 93750, 187500, 500000, 1500000]
    assert (can.parity, can.low_latency, can.rs485, can.counters, can.marks) == (True, True, True, True, True)


def test_a_port_without_any_rate(far: PtyFarEnd, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_fd: int, _baud: int | None, *, marks: bool) -> termios2.Applied:
        raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))

    monkeypatch.setattr(termios2, "set_raw", refuse)
    assert probe(far.path).rates == []


def test_the_probe_refuses_devices_that_are_no_ports(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(PortError, match="another device"):
        probe("/dev/null")
    monkeypatch.setattr("sys.platform", "darwin")
    with pytest.raises(PortError, match="on Linux only"):
        probe("/dev/null")


@pytest.fixture
def driver(monkeypatch: pytest.MonkeyPatch) -> FakeDriver:
    return FakeDriver(monkeypatch)


def text(path: Path) -> str:
    return path.read_text().strip()


def test_an_ftdi_is_made_quick_and_left_as_it_was(driver: FakeDriver, tmp_path: Path) -> None:
    folder = plug_in(tmp_path, "ttyUSB0")
    driver.rs485 = None
    tuning = Tuning(7, Adapter("/dev/ttyUSB0", tmp_path))
    assert tuning.notices == []  # a USB adapter without RS-485 mode is none to speak of
    assert driver.flags == 0x2040  # ASYNC_LOW_LATENCY is bit 13
    assert text(folder / "latency_timer") == "1"
    assert text(folder / "event_char") == ""
    tuning.restore()
    assert driver.flags == 0x40
    assert text(folder / "latency_timer") == "16"
    tuning.restore()


def test_settings_that_were_quick_before_are_kept(driver: FakeDriver, tmp_path: Path) -> None:
    folder = plug_in(tmp_path, "ttyUSB0", latency=1)
    driver.flags = 0x2040
    tuning = Tuning(7, Adapter("/dev/ttyUSB0", tmp_path))
    tuning.restore()
    assert driver.flags == 0x2040
    assert text(folder / "latency_timer") == "1"


def test_the_event_character_is_an_option(driver: FakeDriver, tmp_path: Path) -> None:
    folder = plug_in(tmp_path, "ttyUSB0")
    tuning = Tuning(7, Adapter("/dev/ttyUSB0", tmp_path), event_char=True)
    assert text(folder / "event_char") == "278"  # 0x116: enabled, ED
    tuning.restore()
    assert text(folder / "event_char").startswith("0")


def test_the_direction_of_a_uart_is_switched_by_rts(driver: FakeDriver, tmp_path: Path) -> None:
    driver.rs485 = [0x34, 1, 2, 0, 0, 0, 0, 0]  # RTS after send, receiving while sending, terminated
    tuning = Tuning(7, Adapter("/dev/ttyS4", tmp_path))
    assert driver.rs485 == [0x23, 1, 2, 0, 0, 0, 0, 0]
    assert tuning.notices == []
    tuning.restore()
    assert driver.rs485 == [0x34, 1, 2, 0, 0, 0, 0, 0]


def test_rs485_that_is_set_up_already_is_not_touched(driver: FakeDriver, tmp_path: Path) -> None:
    driver.rs485 = [0x05, 0, 0, 0, 0, 0, 0, 0]
    Tuning(7, Adapter("/dev/ttyS4", tmp_path)).restore()
    assert driver.rs485 == [0x05, 0, 0, 0, 0, 0, 0, 0]


def test_rs485_is_left_alone_where_that_is_asked_for(
    far: PtyFarEnd, driver: FakeDriver, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dpstack.ports.tty.is_pty_path", lambda _name: False)
    port = TtyPort(far.path, 9600, rs485=False, sysfs=tmp_path)
    port.open_now()
    assert driver.rs485 == [0] * 8
    assert not any("RS-485" in notice for notice in port.notices)
    port.close()
    port = TtyPort(far.path, 9600, sysfs=tmp_path)
    port.open_now()
    assert driver.rs485[0] == 0x03  # enabled, RTS on send
    port.close()
    assert driver.rs485 == [0] * 8


def test_missing_abilities_of_a_driver_are_named_in_one_line(driver: FakeDriver, tmp_path: Path) -> None:
    driver.flags = driver.rs485 = driver.counts = None
    tuning = Tuning(7, Adapter("/dev/ttyS4", tmp_path))
    assert tuning.notices == [
        "its driver has no low-latency mode, no RS-485 mode, no error counters (see `dpstack doctor`)"
    ]
    assert tuning.damage() == {}
    tuning.restore()


def test_each_refused_setting_is_a_notice_with_a_remedy(driver: FakeDriver, tmp_path: Path) -> None:
    folder = plug_in(tmp_path, "ttyUSB0")
    (folder / "latency_timer").chmod(0o444)
    (folder / "event_char").unlink()
    driver.refuses = {0x542F}
    tuning = Tuning(7, Refusing("/dev/ttyUSB0", tmp_path), event_char=True)
    assert tuning.notices == [
        "its latency timer stays at 16 ms (Permission denied), which every exchange may cost: "
        "run once what `dpstack doctor --fix` says",
        "its driver refuses the RS-485 mode (Invalid argument): who switches the direction?",
        "event_char cannot be set (No such file or directory): it is for FTDI chips, leave it out",
    ]
    tuning.restore()


class Refusing(Adapter):
    """As sysfs refuses those who are not root (tests may run as root)."""

    def set_latency_ms(self, ms: int) -> None:
        raise PermissionError(13, "Permission denied")


def test_error_counters_are_those_since_the_start(driver: FakeDriver, tmp_path: Path) -> None:
    driver.counts = [9] * 6 + [3, 1, 4, 0xFFFFFFFF, 5] + [9] * 9
    tuning = Tuning(7, Adapter("/dev/ttyS4", tmp_path))
    driver.counts[6:11] = [5, 1, 14, 1, 5]
    assert tuning.damage() == {"frame": 2, "overrun": 0, "parity": 10, "brk": 2, "buf_overrun": 0}
    driver.counts = None  # unplugged
    assert tuning.damage() == {}


def test_a_port_tunes_an_adapter_and_leaves_a_pty_alone(
    far: PtyFarEnd, driver: FakeDriver, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = plug_in(tmp_path, os.path.basename(far.path))
    port = TtyPort(far.path, 9600, sysfs=tmp_path)
    port.open_now()
    assert driver.flags == 0x40
    port.close()
    monkeypatch.setattr("dpstack.ports.tty.is_pty_path", lambda _name: False)
    port = TtyPort(far.path, 9600, sysfs=tmp_path)
    assert port.delivery is Delivery.ADAPTER
    for opened in (1, 2):
        port.open_now()
        assert driver.flags == 0x2040
        assert text(folder / "latency_timer") == "1"
        assert driver.counts is not None
        driver.counts[8] += 1
        assert port.damage() == {"marked": 0, "frame": 0, "overrun": 0, "parity": opened, "brk": 0, "buf_overrun": 0}
        port.close()
        assert driver.flags == 0x40
        assert text(folder / "latency_timer") == "16"
    assert port.damage()["parity"] == 2


def test_driver_usb_identity_and_latency_come_from_sysfs(tmp_path: Path) -> None:
    plug_in(tmp_path, "ttyUSB0", usb="10C4:EA60", driver="cp210x", latency=None)
    adapter = Adapter("/dev/ttyUSB0", tmp_path)
    assert (adapter.driver, adapter.usb, adapter.latency_ms()) == ("cp210x", "10c4:ea60", None)
    none = Adapter("/dev/ttyS0", tmp_path)
    assert (none.driver, none.usb, none.latency_ms()) == (None, None, None)
