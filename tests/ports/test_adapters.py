"""The list of adapters, and what is found out about one by opening it."""

from __future__ import annotations

import errno
import os
from dataclasses import dataclass
from pathlib import Path

import pytest
from fake_adapter import FakeDriver, plug_in
from far_ends import PtyFarEnd

from dpstack.errors import PortError
from dpstack.ports import termios2
from dpstack.ports.adapters import list_adapters, probe
from dpstack.ports.sysfs import CHIPS
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
        return real(fd, baud, marks=marks)._replace(parity=True)

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
