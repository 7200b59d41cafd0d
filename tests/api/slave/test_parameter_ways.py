"""``drive.read`` of the five drives: over record 47 where the drive has it, over the telegram's channel where not."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator
from typing import Any

import pytest
from api_kit import bench_of, device_of, running

import dpstack
from dpstack import ParameterError, ParameterPlace, UsageError
from dpstack.dpv1.slave.record_requests import RecordRequest
from dpstack.dpv1.slave.record_table import ImRecords
from dpstack.errors import DriveError

pytestmark = pytest.mark.virtual_time


class Counted:
    """The requests that reach the records of a simulated drive; none where it has no records."""

    def __init__(self, records: object) -> None:
        self.services: list[str] = []
        if isinstance(records, ImRecords):
            self.records = self.ask = records.ask
            vars(records)["ask"] = self._count

    def _count(self, request: RecordRequest) -> None:
        self.services.append(request.service.build().hex(" ").upper())
        self.ask(request)

    @property
    def writes(self) -> list[str]:
        return [one for one in self.services if one.startswith("5F")]


@contextlib.asynccontextmanager
async def drive_at(
    kind: str, telegram: str, baud: int = 1_500_000, **keys: object
) -> AsyncIterator[tuple[dpstack.Drive, Counted]]:
    """A drive in data exchange, and the requests that reach its records."""
    table = {"name": "it", "address": 6, "drive": kind, "telegram": telegram, **keys}
    async with running(table, baud) as (bus, drive):
        yield drive, Counted(device_of(bus, 6).records)


@pytest.mark.parametrize(
    ("kind", "telegram", "number", "way"),
    [
        ("demag-dedrive", "PPO1", 480, "telegram"),
        ("demag-dedrive", "PPO3", 480, None),
        ("fuji-frenic", "PPO1", 918, "telegram"),
        ("fuji-frenic", "PPO3", 918, None),
        ("keb-f5", "PCH+8/8", "oP.3", "telegram"),
        ("keb-f5", "8/8", "oP.3", None),
        ("imo-hd2", "PKW+12", "P00.10", "telegram"),
        ("ls-s100", "PPO1", 930, "record 47"),
        ("ls-s100", "PPO3", 930, "record 47"),
        ("ls-s100", "ST1", 930, "record 47"),
    ],
)
async def test_the_way_of_each_drive_and_telegram(kind: str, telegram: str, number: int | str, way: str | None) -> None:
    async with drive_at(kind, telegram) as (drive, counted):
        if way is None:
            with pytest.raises(UsageError, match="no parameter channel"):
                await drive.read(number)
            with pytest.raises(UsageError, match="no parameter channel"):
                await drive.read_many([number])
            return
        value = await drive.read(number)
        assert bool(counted.services) is (way == "record 47")
        (again,) = await drive.read_many([number])
        assert not isinstance(again, ParameterError)
        assert again.value == pytest.approx(value)


async def test_without_dp_v1_the_ls_is_asked_by_its_telegram() -> None:
    async with drive_at("ls-s100", "PPO1", dpv1=False) as (drive, counted):
        found = await drive.read_many(["dr-03", 918, 930])
        assert [one.value for one in found if not isinstance(one, ParameterError)] == [1.0, 6, 1]
        assert not counted.services


#: its plugin does not read the drive's settings by itself: the requests are the test's
ALONE: dict[str, object] = {"check_settings": False}


async def test_several_in_one_request_and_what_is_refused_in_its_place() -> None:
    async with drive_at("ls-s100", "ST1", options=ALONE) as (drive, counted):
        first, wrong, last = await drive.read_many(["dr-03", "dr-99", 918])
        assert not isinstance(first, ParameterError)
        assert (first.value, first.unit, first.name) == (1.0, "s", "dr-03")
        assert isinstance(wrong, ParameterError)
        assert (wrong.number, wrong.drive) == (0, "it")
        assert "dr-99: error 0, illegal parameter number" in str(wrong)
        assert not isinstance(last, ParameterError)
        assert last.value == 6
        assert len(counted.writes) == 1
        assert await drive.read_many([]) == []
        nothing: Any = [None]
        many = await drive.read_many([918] * 20)  # eight parameters a request is what the LS takes
        assert len(many) == 20
        assert len(counted.writes) == 4
        with pytest.raises(UsageError, match="'dr-xy' is neither a code such as dr-03"):
            await drive.read_many([918, "dr-xy"])
        with pytest.raises(UsageError, match="must be a parameter number or name"):
            await drive.read_many(nothing)


async def test_a_dump_asks_for_as_many_as_a_request_takes() -> None:
    # a slow bus asks the busy drive less often, which costs the test less
    async with drive_at("ls-s100", "ST1", baud=187_500) as (drive, counted):
        found = await drive.dump()
        asked = len(found.parameters) - len(found.unreadable)
        assert drive.per_request == 8
        assert asked / 8 <= len(counted.writes) <= asked / 8 + 10  # arrays are pieces of their own
        assert (await drive.compare(found, read_only=True)).differences == ()
        # one that is not answered is found among the eight
        records = counted.records

        def silent(request: RecordRequest) -> None:
            if request.service.index != 47 or bytes.fromhex("1103") not in request.service.build():
                records(request)

        counted.ask = silent
        after = await drive.dump()
        (lost,) = (one for one in after.parameters if one.unreadable and one not in found.unreadable)
        assert str(lost.unreadable).startswith("dr-03 (Acceleration time): Write of slot 1, index 47 ")
        assert lost.name == "dr-03"


async def test_elements_of_an_array_are_one_address() -> None:
    async with drive_at("ls-s100", "PPO1") as (drive, counted):
        found = await drive.read_array(964, 7)
        assert [one.value for one in found if not isinstance(one, ParameterError)][:2] == [0x0351, 1]
        assert [one[12:] for one in counted.writes] == ["01 01 01 01 10 07 03 C4 00 00"]
        with pytest.raises(UsageError, match=r"PNU 964: indexes are 0\.\.6"):
            await drive.read_array(964, 3, first=5)
        mixed = await drive.read_many([ParameterPlace(964, index=6), ParameterPlace(964, index=0), 918])
        assert [one.value for one in mixed if not isinstance(one, ParameterError)] == [0x0A6C, 0x0351, 6]


async def test_a_drive_that_is_gone_is_no_entry() -> None:
    async with running({"name": "it", "address": 6, "drive": "ls-s100", "telegram": "ST1"}) as (bus, _):
        bench_of(bus).power(6, False)
        with pytest.raises((DriveError, TimeoutError)):
            await bus.drive("it").read_many([918, 930], timeout=0.5)
