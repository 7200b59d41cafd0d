"""Record 47 over MS1 on a bus: a drive by name, a whole list, both at the same time; times on the wire."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Any

import pytest
from acyclic_kit import octets
from api_kit import begun, bench_of, device_of, running
from support import WorldFactory, instance

import dpstack
from bench.parameters import MIXER, mixer, read_out
from dpstack import ParameterError, ParameterPlace, UsageError
from dpstack.api.slave.record_parameters import RecordParameters
from dpstack.dpv1.slave.record_requests import RecordRequest
from dpstack.dpv1.slave.record_table import ImRecords
from dpstack.errors import DriveError
from dpstack.profile import ParamSpec, ParamStore, ParamTable, ParamType
from dpstack.profile.record47 import (
    Address,
    ErrorValue,
    ParameterServer,
    ReadReq,
    Refused,
    Rules,
    StoreParameters,
    Values,
    WriteReq,
)
from dpstack.sim.world import World
from dpstack.units import NS_PER_MS, s_to_ns

pytestmark = pytest.mark.virtual_time

PUMP: dict[str, object] = {"name": "pump", "address": 6, "drive": "ls-s100", "telegram": "ST1"}


@pytest.mark.parametrize(
    ("baud", "described", "seconds", "services", "octets"),
    [
        (500_000, False, 0.58, 82, 12_720),
        (1_500_000, False, 0.195, 82, 12_720),
        pytest.param(500_000, True, 3.76, 590, 69_456, marks=pytest.mark.soak),
        pytest.param(1_500_000, True, 1.06, 590, 69_456, marks=pytest.mark.soak),
    ],
)
def test_the_time_of_1000_parameters(baud: int, described: bool, seconds: float, services: int, octets: int) -> None:
    """``described``: with 1000 descriptions and whole arrays; else the first values alone."""
    seen = read_out(baud, described=described)
    assert seen.parameters == 1000
    assert seen.seconds == pytest.approx(seconds, rel=0.05)
    counters = seen.counters
    assert (counters.services, counters.octets) == (services, octets)
    assert counters.busy == counters.strays == counters.repeated == 0


@contextlib.asynccontextmanager
async def mixing(bench: World) -> AsyncIterator[dpstack.Bus]:
    """A bus with the mixer at 9, in data exchange."""
    async with (
        dpstack.slave.serve_slave(mixer(), world=bench, address=9, baud=1_500_000),
        dpstack.open_bus(port="virtual", baud=1_500_000, slaves=[MIXER.table(9)], world=bench) as bus,
    ):
        await bus.operate()
        await bus.slave(9).ready()
        yield bus


async def test_1000_parameters_with_progress(world: WorldFactory) -> None:
    """With the referee on the wire."""
    bench = world()
    async with mixing(bench) as bus:
        told: list[tuple[int, int]] = []
        found = await bus.slave(9).parameters().read_out(described=False, progress=lambda *one: told.append(one))
        assert len(found) == 1000
        assert found[-1].values == (7,)
        assert told[-1] == (1000, 1000)
        assert bus.slave(9).retries == bus.slave(9).timeouts == 0


async def test_a_lost_request_is_written_again(world: WorldFactory) -> None:
    bench = world()
    async with mixing(bench) as bus:
        parameters = bus.slave(9).parameters()
        bench.faults.drop(lambda tx: b"\x33\x33\x5f" in tx.octets, times=2)  # and its repetition
        assert await parameters.read([Address(1)]) == [Values(6, (1,))]
        assert parameters.counters.repeated == 1
        bench.faults.drop(lambda tx: b"\x33\x33\x5f" in tx.octets, times=2)
        with pytest.raises(dpstack.DriveTimeout, match="it may have been carried out: read it back"):
            await parameters.change([(Address(1), Values(6, (2,)))])


async def test_a_drive_by_name_in_a_telegram_without_a_channel() -> None:
    async with running(PUMP) as (bus, pump):
        assert await pump.read(965) == 0x0328
        assert await pump.read(918) == 6
        written = await pump.write("dr-03", 2.5)
        assert (written.value, written.unit, written.raw) == (2.5, "s", 25)
        assert await pump.read(964, index=6) == 0x0A6C
        with pytest.raises(dpstack.ParameterError, match="drive pump: dr-99: error 0, illegal parameter number"):
            await pump.read("dr-99")
        im0 = instance(await bus.slave("pump").im(), dpstack.Im0)
        assert (im0.manufacturer_id, im0.order_id, im0.supported) == (0x0351, "CPDP-S100", 1)
        several = await bus.slave("pump").parameters().read([Address(n) for n in (918, 922, 930, 1, 963)])
        assert several == [Values(6, (6,)), Values(6, (1,)), Values(6, (1,)), ErrorValue(0), Values(6, (4,))]


async def test_plugin_and_programs_that_ask_at_the_same_time_take_turns() -> None:
    async with running(PUMP) as (bus, pump):
        first, second = bus.slave("pump").parameters(), bus.slave("pump").parameters()
        for _ in range(5):
            by_name = asyncio.gather(pump.read(965), pump.read("dr-20"))
            by_number = asyncio.gather(*(one.read([Address(pnu)]) for one in (first, second) for pnu in (918, 930)))
            assert list(await by_name) == [0x0328, 60.0]
            assert list(await by_number) == [[Values(6, (6,))], [Values(6, (1,))]] * 2
        assert first.counters.strays == second.counters.strays == 0
        assert first.counters.requests == second.counters.requests == 10


async def test_without_dp_v1_it_goes_by_pkw_or_says_what_to_do() -> None:
    slaves = [PUMP | {"telegram": "PPO1", "dpv1": False}, PUMP | {"name": "old", "address": 7, "dpv1": False}]
    async with dpstack.open_bus(port="virtual", baud=500_000, slaves=slaves) as bus:
        await bus.operate()
        assert await bus.drive("pump").read(965) == 0x0328
        with pytest.raises(dpstack.UsageError, match="ST1 of ls-s100 has no parameter channel"):
            await bus.drive("old").read(965)


async def test_the_drive_goes_and_comes_in_between() -> None:
    async with running(PUMP) as (bus, pump):
        reading = await begun(pump.read(965), 0.002)
        bench_of(bus).power(6, False)
        with pytest.raises(dpstack.DriveError):
            await reading
        await bus.until(lambda: not bus.slave(6).ready_now, 5)
        bench_of(bus).power(6, True)
        await bus.slave(6).ready()
        assert await pump.read(965) == 0x0328


# --- ``drive.read`` of the five drives: over record 47 where the drive has it, over the telegram's channel where not


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


# --- PROFIdrive's parameter access in an asyncio program, on virtual time -------------------------------------------


def access_to(server: ParameterServer) -> RecordParameters:
    """The parameters of a drive; each service takes 3 ms."""

    async def carry_out(service: ReadReq | WriteReq) -> bytes | Refused:
        await asyncio.sleep(0.003)
        now = s_to_ns(asyncio.get_running_loop().time())
        if isinstance(service, WriteReq):
            return server.write_record(service.slot, service.index, service.data, now) or b""
        return server.read_record(service.slot, service.index, service.length, now)

    return RecordParameters("pump", carry_out, 1)


def drive(busy_ms: int = 10) -> tuple[RecordParameters, ParamStore]:
    """The parameters of a drive with :class:`StoreParameters`, and its store."""
    table = ParamTable(
        [
            ParamSpec(number=11, name="ramp", title="Ramp time", decimals=1, unit="s", high=600, factory=1),
            ParamSpec(
                number=12,
                name="offset",
                title="Offset",
                type=ParamType.I16,
                low=-100,
                high=100,
                factory=-3,
                per_set=True,
            ),
            ParamSpec(
                number=13, name="hours", title="Hours", type=ParamType.U32, high=1e6, factory=70000, read_only=True
            ),
        ]
    )
    store = ParamStore(table, {}, sets=4)
    return access_to(ParameterServer(StoreParameters(store), Rules(busy_ns=busy_ms * NS_PER_MS))), store


async def test_the_whole_list_with_progress_and_a_change() -> None:
    parameters, store = drive()
    assert (await parameters.limits()).parameters == 39
    assert await parameters.defined() == [11, 12, 13]
    steps: list[tuple[int, int]] = []
    found = await parameters.read_out(progress=lambda done, of: steps.append((done, of)))
    assert [(one.pnu, one.values) for one in found] == [(11, (10,)), (12, (-3, -3, -3, -3)), (13, (70000,))]
    assert found[1].description is not None
    assert (found[1].description.name, found[1].description.elements) == ("Offset", 4)
    assert steps == [(3, 3)]
    outcome = await parameters.change([(Address(12, 1, 2), Values(3, (5, -6))), (Address(13), Values(7, (1,)))])
    assert outcome == [Values(0x40), ErrorValue(1, 0)]
    assert [store.value("offset", n) for n in (1, 2, 3, 4)] == [-3, 5, -6, -3]
    assert parameters.counters.busy > 0


async def test_tasks_take_turns_and_a_time_ends() -> None:
    parameters, _ = drive(busy_ms=50)
    both = await asyncio.gather(*(parameters.read([Address(pnu)]) for pnu in (11, 13)))
    assert both == [[Values(6, (10,))], [Values(7, (70000,))]]
    slow, _ = drive(busy_ms=500)
    with pytest.raises(dpstack.DriveTimeout, match="drive pump: record 47 of slot 1: the drive did not answer"):
        await slow.read([Address(11)], timeout=0.1)
    assert await slow.read([Address(11)]) == [Values(6, (10,))]  # 0xB5 until the first one is over


async def test_a_drive_without_the_record_says_so() -> None:
    async def none(service: ReadReq | WriteReq) -> bytes | Refused:
        return Refused(0xB0)

    with pytest.raises(dpstack.ParameterError, match="refuses the request: error B/0, invalid index") as caught:
        await RecordParameters("pump", none, 1).read_out()
    assert caught.value.number == 0xB0


@pytest.mark.parametrize(
    ("request_", "answer"),
    [
        ("01 01 01 01 10 00 00 0C 00 02", "01 01 01 01 03 01 FF FD"),
        ("01 01 01 01 10 05 00 0C 00 00", "01 81 01 01 44 02 00 03 00 04"),
        ("01 01 01 01 10 01 00 0B 00 01", "01 81 01 01 44 01 00 04"),
        ("01 01 01 01 10 02 00 0B 00 00", "01 81 01 01 44 01 00 16"),
        ("01 01 01 01 10 01 00 63 00 00", "01 81 01 01 44 01 00 00"),
        ("01 01 01 01 10 03 03 CE 00 00", "01 01 01 01 06 03 00 F0 00 27 00 00"),
        ("01 01 01 01 10 04 03 D4 00 00", "01 01 01 01 06 04 00 0B 00 0C 00 0D 00 00"),
        ("01 01 01 01 10 02 03 D4 01 2B", "01 81 01 01 44 02 00 03 01 2C"),
        ("01 01 01 01 30 01 00 0B 00 00", "01 81 01 01 44 01 00 0F"),
        ("01 01 01 01 30 01 00 63 00 00", "01 81 01 01 44 01 00 00"),
        ("01 01 01 01 20 01 00 63 00 00", "01 81 01 01 44 01 00 00"),
        ("01 01 01 01 20 01 00 0B 00 01", "01 01 01 01 06 01 00 06"),
        ("01 01 01 01 20 01 00 0C 00 01", "01 01 01 01 06 01 40 03"),
        ("01 01 01 01 20 01 00 0C 00 02", "01 01 01 01 06 01 00 04"),
        ("01 01 01 01 20 01 00 0B 00 03", "01 01 01 01 08 01 3D CC CC CD"),
        ("01 01 01 01 20 01 00 0B 00 04", "01 01 01 01 0A 02 00 00"),
        ("01 01 01 01 20 01 00 0B 00 06", "01 01 01 01 09 10 52 61 6D 70 20 74 69 6D 65 20 20 20 20 20 20 20"),
        ("01 01 01 01 20 01 00 0B 00 08", "01 01 01 01 0A 04 00 00 17 70"),
        ("01 01 01 01 20 01 00 0B 00 0C", "01 01 01 01 06 01 00 00"),
        ("01 01 01 01 20 01 00 0B 00 0D", "01 81 01 01 44 01 00 09"),
        ("01 01 01 01 20 02 00 0B 00 01", "01 81 01 01 44 01 00 16"),
        ("01 02 01 01 10 01 00 0B 00 00 06 01 00 14", "01 02 01 01"),
        ("01 02 01 01 10 01 00 0B 00 00 42 01 00 14", "01 02 01 01"),
        ("01 02 01 01 10 01 00 0B 00 00 07 01 00 00 00 14", "01 82 01 01 44 01 00 05"),  # no double word
        ("01 02 01 01 10 01 00 0B 00 00 7F 01 00 14", "01 82 01 01 44 01 00 17"),  # no format at all
        (
            "01 02 01 02 10 01 00 0B 00 00 10 01 00 0B 00 00 06 01 00 14 20 01 00 14",
            "01 82 01 02 44 01 00 17 44 01 00 17",
        ),
        ("01 02 01 01 10 01 00 0B 00 00 06 01 FF FF", "01 82 01 01 44 02 00 02 00 00"),
        ("01 02 01 01 10 01 03 CE 00 00 06 01 00 00", "01 82 01 01 44 02 00 01 00 00"),
    ],
)
def test_a_drive_over_its_store_in_octets(request_: str, answer: str) -> None:
    store = drive()[1]
    server = ParameterServer(StoreParameters(store))
    assert server.write_record(1, 47, octets(request_), 0) is None
    assert server.read_record(1, 47, 240, 0) == octets(answer)


async def test_texts_of_values_both_ways() -> None:
    store = drive()[1]
    names = ("off", "on", "by itself, and longer than 16")
    parameters = access_to(ParameterServer(StoreParameters(store, texts={11: names})))
    assert await parameters.texts(11, 3) == ["off", "on", "by itself, and l"]
    assert await parameters.texts(11, 1, first=1) == ["on"]
    with pytest.raises(dpstack.ParameterError, match=r"texts of parameter 11: error 3, invalid subindex \(subindex 3"):
        await parameters.texts(11, 2, first=2)
    (description,) = await parameters.describe([11])
    assert description is not None
    assert description.text
    (name,) = await parameters.read([Address(11, 6, 1, 0x20)])
    assert name == Values(9, (b"Ramp time".ljust(16),))


def test_a_locked_parameter_and_a_live_value() -> None:
    store = drive()[1]
    changed: list[str] = []
    model = StoreParameters(
        store,
        live=lambda spec: 42 if spec.name == "hours" else None,
        locked=lambda spec: spec.name == "ramp",
        changed=lambda spec: changed.append(spec.name),
    )
    assert model.read(Address(13)) == Values(7, (42,))
    assert model.change(Address(11), Values(6, (1,))) == ErrorValue(0x11)
    assert model.change(Address(12, 3), Values(3, (7,))) is None
    assert (changed, store.value("offset", 4)) == (["offset"], 7)
