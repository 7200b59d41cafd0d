"""Parameter numbers above 1999 in PKW: pages in the low octet of IND, as SINAMICS and MICROMASTER 4 have them.

Octets: p7841[2] is the example of the SINAMICS G120C operating instructions (p224): AK 6, PNU 1841, subindex 2, page
90h; the table of pages stands there, too.
"""

from __future__ import annotations

import pytest
from acyclic_kit import octets
from drive_bench import PluginBench
from profidrive_kit import DRIVE, NO_REPLY, PARAMETERS, PPO1, READY, Core, Device, over_pkw

from dpstack.profile import PAGED_PKW, ParamSpec, ParamTable, ParamType, Pkw
from dpstack.profile.channel.pkw import PagedPkw

TABLE = ParamTable(
    (
        *PARAMETERS,
        ParamSpec(2000, "p2000", "Reference speed", 6, 210_000, 1500, type=ParamType.F32, unit="rpm"),
        ParamSpec(7841, "serial", "Serial number", type=ParamType.U32, index=2, factory=7),
    )
)


class Paged(Core):
    parameter_table = TABLE
    dialect = PAGED_PKW


class PagedDevice(Device):
    parameter_table = TABLE
    dialect = PAGED_PKW


def bench() -> PluginBench:
    return over_pkw(Paged)


@pytest.mark.parametrize(
    ("number", "page", "pnu"),
    [
        (1999, 0x00, 1999),
        (2000, 0x80, 0),
        (3999, 0x80, 1999),
        (6000, 0x90, 0),
        (8000, 0x20, 0),
        (10_000, 0xA0, 0),
        (20_000, 0x50, 0),
        (29_500, 0x70, 1500),
        (30_000, 0xF0, 0),
        (61_999, 0x74, 1999),
    ],
)
def test_the_pages_of_the_manual(number: int, page: int, pnu: int) -> None:
    built = PagedPkw(1, number).build()
    assert (built[3], int.from_bytes(built[:2], "big") & 0x7FF) == (page, pnu)
    assert PagedPkw.parse(built) == (1, number, 0, 0)


def test_the_example_of_the_manual() -> None:
    drive = bench()
    token = drive.order_and_run(2, "read", number=7841, index=2)
    assert drive.out().startswith("67 31 02 90 00 00 00 00")
    assert drive.value(token, f"57 31 02 90 00 01 E2 40 {READY}") == 123_456
    drive.see(NO_REPLY + READY, 2)
    token = drive.order_and_run(2, "read", number="serial")  # its index is declared
    assert drive.out().startswith("67 31 02 90 00 00 00 00")
    # the answer for the same number of another page is none
    assert drive.see(f"57 31 02 80 00 00 00 05 {READY}").startswith("67 31 02 90")
    assert drive.result(token) is None


def test_a_float_above_1999_is_written() -> None:
    drive = bench()
    token = drive.order_and_run(2, "write", number="p2000", value=3000)
    assert drive.out().startswith("30 00 00 80 45 3B 80 00")
    assert drive.value(token, f"20 00 00 80 45 3B 80 00 {READY}") == 3000


@pytest.mark.parametrize(
    ("core", "args", "says"),
    [
        (Core, {"number": 2048}, "parameter numbers are 1..2047"),
        (Paged, {"number": 64_000}, "parameter numbers are 1..63999"),
        (Paged, {"number": 2000, "data_set": 1}, "profidrive-kit has no data sets"),
        (Paged, {"number": 2000, "index": 256}, "indexes are 0..255"),
        (Core, {"number": 700, "index": 1}, "has neither data sets nor indexes"),
    ],
)
def test_numbers_and_indexes_beyond_the_layout_are_refused(
    core: type[Core], args: dict[str, object], says: str
) -> None:
    assert says in over_pkw(core).misuse("read", **args)


def test_the_simulated_drive_has_pages_and_arrays() -> None:
    drive = PagedDevice(DRIVE, PPO1, {}, {})
    assert drive.channel.step(octets("67 31 02 90 00 00 00 00")) == octets("57 31 02 90 00 00 00 07")
    assert drive.carry_out(Pkw(8, 7841, 2, 9)) == (5, 9)
    assert drive.carry_out(Pkw(6, 7841, 1)) == (7, 3)
    assert drive.carry_out(Pkw(6, 7842, 1)) == (7, 0)
    assert drive.carry_out(Pkw(1, 2000)) == (2, 0x44BB8000)
