"""Parameters over record 47 as orders of a plugin, for a drive without peculiarities: formats, scales, refusals."""

from __future__ import annotations

from typing import TypeVar

import pytest
from acyclic_kit import outcome

from dpstack.profile import CommandError, ParamKey, ParamSpec, ParamTable, ParamType, Steps
from dpstack.profile.record47 import AcyclicAccess, ParameterClient, RecordQueue, WriteReq, plain_places

TABLE = ParamTable(
    [
        ParamSpec(number=11, name="ramp", title="Ramp time", decimals=1, unit="s", high=600),
        ParamSpec(number=12, name="offset", title="Offset", type=ParamType.I16, low=-100, high=100),
        ParamSpec(number=13, name="hours", title="Hours", type=ParamType.U32, high=1e6, read_only=True),
    ]
)
S = 10**9
T = TypeVar("T")


class Bench:
    """The access alone, against requests and responses in octets."""

    def __init__(self) -> None:
        self.queue = RecordQueue()
        self.now = 0
        self.requests: list[str] = []
        self.access = AcyclicAccess(ParameterClient(0), self.queue, plain_places(TABLE, "mixer"), self)

    def run(self, steps: Steps[T], *responses: str) -> T:
        """Each Write is accepted, each Read answered by the next of ``responses``."""
        waiting = list(responses)
        try:
            while True:
                next(steps)
                self.now += S // 1000
                pending = self.queue.take()
                if pending is None:
                    continue
                if isinstance(pending.request, WriteReq):
                    self.requests.append(pending.request.data.hex(" ").upper())
                    pending.outcome = outcome("")
                else:
                    pending.outcome = outcome(waiting.pop(0))
        except StopIteration as end:
            result: T = end.value
            return result


def read(name: str | int, response: str, index: int | None = None) -> dict[str, object]:
    bench = Bench()
    return bench.run(bench.access.read(ParamKey(name, index=index), 5 * S), response)


@pytest.mark.parametrize(
    ("name", "response", "value", "raw"),
    [
        ("ramp", "01 01 01 01 06 01 00 0A", 1.0, 10),
        ("offset", "01 01 01 01 03 01 FF FB", -5, -5),
        ("offset", "01 01 01 01 42 01 FF FB", -5, -5),  # the drive says only Word
        (13, "01 01 01 01 07 01 00 01 11 70", 70000, 70000),
        (922, "01 01 01 01 06 01 00 05", 5, 5),
        (1520, "01 01 01 01 08 01 41 F0 00 00", 30.0, 0x41F00000),
        (2000, "01 01 01 01 71 01 20 00", 0.5, 0x2000),  # N2
        (2001, "01 01 01 01 01 01 01 00", True, 1),
        (965, "01 01 01 01 0A 02 03 2A", 0x032A, 0x032A),  # an OctetString of two in profile 4.2
        (975, "01 01 01 01 0E 01 81 00", 0x81, 0x81),  # BitString
    ],
)
def test_values_in_their_units(name: str | int, response: str, value: object, raw: int) -> None:
    found = read(name, response)
    assert (found["value"], found["raw"]) == (value, raw)


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_elements_that_follow_each_other_are_one_address(bench: Bench) -> None:
    keys = [*(ParamKey(20, index=at) for at in (1, 2, 3)), ParamKey("ramp"), ParamKey(20, index=3), ParamKey(21)]
    steps = bench.access.read_many(keys, 5 * S)
    found = bench.run(steps, "01 01 01 04 06 03 00 01 00 02 00 03 06 01 00 0A 06 01 00 03 03 01 FF FF")
    assert bench.requests == [
        "01 01 01 04 10 03 00 14 00 01 10 00 00 0B 00 00 10 01 00 14 00 03 10 00 00 15 00 00",
    ]
    assert [(one["number"], one["value"]) for one in found] == [(20, 1), (20, 2), (20, 3), (11, 1.0), (20, 3), (21, -1)]


def test_after_a_refusal_each_element_is_read_by_itself(bench: Bench) -> None:
    steps = bench.access.read_many([ParamKey(20, index=0), ParamKey(20, index=1), ParamKey("ramp")], 5 * S)
    found = bench.run(
        steps,
        *("01 81 01 02 44 02 00 03 00 01 06 01 00 0A", "02 01 01 01 06 01 00 05", "03 81 01 01 44 02 00 03 00 01"),
    )
    assert (found[0]["value"], found[2]["value"]) == (5, 1.0)
    assert found[1] == {
        "error": "parameter",
        "text": "parameter 20: error 3, invalid subindex (subindex 1)",
        "number": 3,
    }
    assert len(bench.requests) == 3


def test_a_value_that_is_no_number_is_refused_with_its_format() -> None:
    with pytest.raises(CommandError, match="parameter 919 is no number but VisibleString: 'LS'"):
        read(919, "01 01 01 01 09 02 4C 53")
    with pytest.raises(CommandError, match="parameter 919 is no number but OctetString: b'12345'"):
        read(919, "01 01 01 01 0A 05 31 32 33 34 35 00")
    with pytest.raises(CommandError, match="parameter 1520 is no number: the drive answers nan"):
        read(1520, "01 01 01 01 08 01 7F C0 00 00")
    with pytest.raises(CommandError, match="parameter 1520 is no number: the drive answers -inf"):
        read(1520, "01 01 01 01 08 01 FF 80 00 00")


@pytest.mark.parametrize(
    ("name", "value", "format_", "written"),
    [
        ("ramp", 2.5, "06 01 00 00", "06 01 00 19"),
        ("offset", -5, "03 01 00 00", "03 01 FF FB"),
        ("offset", -5, "42 01 00 00", "42 01 FF FB"),
        (1520, 30.0, "08 01 00 00 00 00", "08 01 41 F0 00 00"),
        (2000, 0.5, "71 01 00 00", "71 01 20 00"),
        (2002, 9, "05 01 00 00", "05 01 09 00"),
    ],
)
def test_a_change_in_the_format_that_the_drive_gives(name: str | int, value: float, format_: str, written: str) -> None:
    bench = Bench()
    steps = bench.access.write(ParamKey(name), value, 5 * S)
    assert bench.run(steps, f"01 01 01 01 {format_}", "02 02 01 01")["value"] == value
    assert bench.requests[1].startswith("02 02 01 01 10 00 ")
    assert bench.requests[1].endswith(written)
    again = bench.run(bench.access.write(ParamKey(name), value, 5 * S), "03 02 01 01")
    assert again["value"] == value
    assert len(bench.requests) == 3  # the format is known now


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        (ParamKey("hours"), 1, "hours|13 .* is read only"),
        (ParamKey("ramp"), 601, r"601 s is outside 0\.\.600 s"),
        (ParamKey("rampp"), 1, "no parameter is called 'rampp'; did you mean ramp"),
        (ParamKey(70000), 1, r"parameter numbers are 1\.\.65535"),
        (ParamKey(11, data_set=2), 1, "mixer has no data sets"),
        (ParamKey(11, ram=True), 1, "mixer has no writes to RAM only"),
        (ParamKey(11, index=70000), 1, r"indexes are 0\.\.65535"),
    ],
)
def test_misuse_is_refused_before_a_request_is_sent(bench: Bench, key: ParamKey, value: float, text: str) -> None:
    with pytest.raises(CommandError, match=text) as caught:
        bench.run(bench.access.write(key, value, 5 * S))
    assert caught.value.kind == "usage"
    assert bench.requests == []


def test_a_value_that_the_format_cannot_hold() -> None:
    for value, text in ((300, r"whole numbers 0\.\.255"), (0.5, "its scale is unknown here")):
        bench = Bench()
        with pytest.raises(CommandError, match=text):
            bench.run(bench.access.write(ParamKey(2002), value, 5 * S), "01 01 01 01 05 01 00 00")


def test_elements_go_by_index(bench: Bench) -> None:
    bench.run(bench.access.read(ParamKey(947, index=3), 5 * S), "01 01 01 01 06 01 00 22")
    assert bench.requests == ["01 01 01 01 10 01 03 B3 00 03"]


def test_the_slave_is_lost_in_between(bench: Bench) -> None:
    steps = bench.access.read(ParamKey(11), 5 * S)
    next(steps)
    bench.access.reset()
    assert bench.queue.take() is None
    steps.close()
    found = bench.run(bench.access.read(ParamKey(11), 5 * S), "02 01 01 01 06 01 00 0A")
    assert found["value"] == 1.0
