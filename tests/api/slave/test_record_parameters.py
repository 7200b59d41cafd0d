"""PROFIdrive's parameter access in an asyncio program, on virtual time."""

from __future__ import annotations

import asyncio

import pytest
from acyclic_kit import octets

import dpstack
from dpstack.api.slave.record_parameters import RecordParameters
from dpstack.profile import ParamSpec, ParamStore, ParamTable
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
from dpstack.units import NS_PER_MS, s_to_ns

pytestmark = pytest.mark.virtual_time


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
            ParamSpec(number=12, name="offset", title="Offset", low=-100, high=100, factory=-3, per_set=True),
            ParamSpec(number=13, name="hours", title="Hours", long=True, high=1e6, factory=70000, read_only=True),
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
