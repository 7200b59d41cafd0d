"""Drives with odd limits (PNU 974): one parameter a request, blocks of 32 octets, seconds for an answer; both ends."""

from __future__ import annotations

import pytest
from acyclic_kit import Script, Wire, octets, talk

from dpstack.profile import ParamSpec, ParamStore, ParamTable, ParamType
from dpstack.profile.model.jobs import CommandError
from dpstack.profile.record47 import (
    Address,
    Answer,
    ErrorValue,
    ParameterClient,
    ParameterModel,
    ParameterServer,
    Refused,
    Rules,
    Service,
    StoreParameters,
    Values,
    WriteReq,
    describe,
    read_limits,
    read_out,
)
from dpstack.profile.record47.pdu import Limits
from dpstack.units import NS_PER_MS, NS_PER_S

TABLE = ParamTable(
    [
        *(ParamSpec(number=n, name=f"p{n}", title=f"Parameter {n}", factory=n) for n in range(1, 12)),
        ParamSpec(
            number=20, name="sets", title="Sets", type=ParamType.I16, low=-100, high=100, factory=-3, per_set=True
        ),
        ParamSpec(
            number=21,
            name="long",
            title="Long",
            type=ParamType.U32,
            high=1e6,
            factory=70000,
            per_set=True,
            read_only=True,
        ),
    ]
)
ODD = {
    "one parameter a request": Limits(parameters=1),
    "32 octets": Limits(octets=32),
    "16 octets and one parameter": Limits(octets=16, parameters=1),
    "7 elements": Limits(elements=7),
    "no latency": Limits(latency_ns=0),
    "5 s": Limits(latency_ns=5 * NS_PER_S),
    "all of it": Limits(octets=32, parameters=1, elements=3, latency_ns=5 * NS_PER_S),
}


class Watched(Wire):
    """Both ends joined; ``counts``: the number of parameters of each request."""

    def __init__(self, server: ParameterServer) -> None:
        super().__init__(server)
        self.counts: list[int] = []

    def __call__(self, service: Service) -> Answer:
        if isinstance(service, WriteReq):
            self.counts.append(service.data[3])
        return super().__call__(service)


def drive(limits: Limits, busy_ns: int = 0) -> Watched:
    model = StoreParameters(ParamStore(TABLE, {}, sets=8), limits=limits)
    return Watched(ParameterServer(model, Rules(limits=limits, busy_ns=busy_ns)))


@pytest.mark.parametrize("limits", ODD.values(), ids=ODD)
def test_the_whole_list_within_odd_limits(limits: Limits) -> None:
    wire = drive(limits, busy_ns=limits.latency_ns * 9 // 10)
    master = ParameterClient(1, limits=Limits(elements=limits.elements))
    told = talk(read_limits(master), wire)
    assert (told.octets, told.parameters, told.latency_ns) == (limits.octets, limits.parameters, limits.latency_ns)
    found = talk(read_out(master), wire)
    assert [one.pnu for one in found] == [*range(1, 12), 20, 21]
    assert [one.values for one in found[:11]] == [(n,) for n in range(1, 12)]
    if limits.octets >= 24:  # a shorter block holds no name
        assert found[0].description is not None
        assert (found[0].description.name, found[0].description.low) == ("Parameter 1", bytes(4))
    assert found[11].values == (-3,) * 8
    assert found[12].values == (70000,) * 8
    assert found[12].description is not None
    assert (found[12].description.elements, found[12].description.read_only) == (8, True)
    assert wire.longest <= limits.octets
    assert max(wire.counts) <= limits.parameters


@pytest.mark.parametrize("limits", ODD.values(), ids=ODD)
def test_changes_within_odd_limits(limits: Limits) -> None:
    wire = drive(limits, busy_ns=limits.latency_ns * 9 // 10)
    master = ParameterClient(1, limits=limits)
    items = [
        (Address(20, 0, 8), Values(3, tuple(range(8)))),
        (Address(1), Values(6, (9,))),
        (Address(2), Values(6, (8,))),
    ]
    assert talk(master.change(items), wire) == [Values(0x40)] * 3
    assert talk(master.read([Address(20, 0, 8), Address(1)]), wire) == [Values(3, tuple(range(8))), Values(6, (9,))]
    assert wire.longest <= limits.octets


def test_a_drive_without_a_latency_has_2_s_and_one_with_5_s_has_10_s() -> None:
    for latency_ns, busy_ns, in_time in (
        (0, 1990 * NS_PER_MS, True),
        (0, 2100 * NS_PER_MS, False),
        (5 * NS_PER_S, 9900 * NS_PER_MS, True),
        (5 * NS_PER_S, 10200 * NS_PER_MS, False),
    ):
        limits = Limits(latency_ns=latency_ns)
        master = ParameterClient(1, limits=limits)
        if in_time:
            assert talk(master.read([Address(1)]), drive(limits, busy_ns)) == [Values(6, (1,))]
            continue
        with pytest.raises(CommandError, match=r"the drive did not answer within (2000|10000) ms"):
            talk(master.read([Address(1)]), drive(limits, busy_ns))


@pytest.mark.parametrize(
    ("address", "number"),
    [
        (Address(974, 0, 3), 6),
        (Address(974, 99, 1), 6),  # behind its end
        (Address(980, 0, 1), 4),  # in another format
    ],
)
def test_the_drives_own_lists_are_read_only_before_any_other_error(address: Address, number: int) -> None:
    model = StoreParameters(ParamStore(TABLE, {}, sets=8))
    assert model.change(address, Values(number, (1,) * max(address.elements, 1))) == ErrorValue(1, address.subindex)


class Bare(ParameterModel):
    """A drive without descriptions: arrays by number; ``sloppy`` numbers answer to any subindex."""

    def __init__(self, sloppy: frozenset[int] = frozenset()) -> None:
        self.values = {980: (1, 2, 3, 4, 0), 1: (7,), 2: tuple(range(300)), 3: (5, 6), 4: (9,)}
        self.sloppy = sloppy

    def read(self, address: Address) -> Values | ErrorValue:
        found = self.values.get(address.pnu)
        if found is None:
            return ErrorValue(0)
        if address.pnu in self.sloppy:
            return Values(6, found[:1] * max(address.elements, 1))
        end = address.subindex + max(address.elements, 1)
        if len(found) == 1 and address.subindex:
            return ErrorValue(4)
        return Values(6, found[address.subindex : end]) if end <= len(found) else ErrorValue(3, address.subindex)

    def change(self, address: Address, values: Values) -> ErrorValue | None:
        return ErrorValue(1)


@pytest.mark.parametrize("limits", [Limits(), Limits(octets=32, parameters=1, elements=5)])
def test_arrays_whole_where_nothing_is_described(limits: Limits) -> None:
    wire = Watched(ParameterServer(Bare(frozenset({4})), Rules(limits=limits)))
    found = talk(read_out(ParameterClient(1, limits=limits)), wire)
    assert [one.values for one in found] == [(7,), tuple(range(300)), (5, 6), (9,)]
    assert all(one.description is None for one in found)
    assert wire.longest <= limits.octets
    first = talk(read_out(ParameterClient(1, limits=limits), described=False), wire)
    assert [one.values for one in first] == [(7,), (0,), (5,), (9,)]


def test_limits_that_were_not_read_are_found_by_smaller_requests() -> None:
    wire = drive(Limits(octets=32, parameters=1))
    master = ParameterClient(1)
    found = talk(master.read([Address(n) for n in range(1, 12)]), wire)
    assert found == [Values(6, (n,)) for n in range(1, 12)]
    (described,) = talk(describe(master, [3]), wire)
    assert described is not None
    assert (described.format, described.name, described.high) == (6, "Parameter 3", b"\0\0\xff\xff")


def test_a_description_longer_than_the_block_in_octets() -> None:
    """Elements 1 to 12 are read one by one: a missing one is zero; without the identifier there is no description."""
    none = "44 01 00 09"
    master = ParameterClient(1)
    drive = Script(
        *("", "01 81 01 01 44 01 00 15"),
        "",
        f"02 81 01 0C 06 01 40 03 06 01 00 04 {none} {none} {none} 09 10 53 65 74 73 {'20 ' * 12}"
        f"0A 04 FF FF FF 9C {none} {none} {none} {none} {none}",
    )
    (told,) = talk(describe(master, [20]), drive)
    assert told is not None
    assert (told.format, told.elements, told.array, told.name) == (3, 4, True, "Sets")
    assert (told.low, told.high, told.factor) == (octets("FF FF FF 9C"), bytes(4), 0.0)
    assert drive.said[2].startswith("5F 01 2F 4C 02 01 01 0C 20 01 00 14 00 01 20 01 00 14 00 02")
    every = " ".join([none] * 12)
    gone = Script("", "01 81 01 01 44 01 00 15", "", f"02 81 01 0C {every}")
    assert talk(describe(ParameterClient(1), [20]), gone) == [None]


@pytest.mark.parametrize(
    ("limits", "write", "refused"),
    [
        (Limits(parameters=1), "01 01 01 02 10 00 00 01 00 00 10 00 00 02 00 00", Refused(0xB7)),
        (Limits(octets=12), "01 01 01 02 10 00 00 01 00 00 10 00 00 02 00 00", Refused(0xB1)),
        (Limits(octets=12), "01 01 01 01 10 00 00 01 00 00", None),
    ],
)
def test_requests_that_the_drive_refuses(limits: Limits, write: str, refused: Refused | None) -> None:
    server = drive(limits).server
    assert server.write_record(1, 47, octets(write), 0) == refused


def test_responses_longer_than_the_block() -> None:
    server = drive(Limits(octets=16, elements=7)).server
    assert server.write_record(1, 47, octets("01 01 01 01 10 07 00 14 00 00"), 0) is None
    assert server.read_record(1, 47, 240, 0) == octets("01 81 01 01 44 01 00 15")
    assert server.write_record(1, 47, octets("02 01 01 01 10 08 00 14 00 00"), 0) is None
    assert server.read_record(1, 47, 240, 0) == octets("02 81 01 01 44 01 00 16")
    assert talk(ParameterClient(1, limits=Limits(elements=1)).read([Address(9999)]), drive(Limits())) == [ErrorValue(0)]
