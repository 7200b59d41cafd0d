"""What passes between bus process and application: messages (orders, events, answers and errors come back as they
were), and the process image in shared memory: whole pictures, and neither waits for the other."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from enum import Enum
from types import UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import msgspec
import pytest
from far_ends import HANG_S
from hypothesis import given
from hypothesis import strategies as st
from linear_kit import assert_linear
from property_kit import examples

from dpstack.dp.acyclic.job import Outcome, ServiceFailure
from dpstack.dp.master.commands import AddSlave, DriveCommand, ReparameteriseSlave
from dpstack.dp.master.settings import StackSpec
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dp.pdu.prm_blocks import PrmBlock
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.master.alarm_orders import CloseConnection, CloseConnections, ConnectionOver, ConnectionsClosed
from dpstack.dpv1.master.orders import InitiateDone, OpenConnection, RecordDone, RecordOrder
from dpstack.dpv1.pdu.ms2 import Address, InitiateReq
from dpstack.dpv1.pdu.read_write import Function
from dpstack.drivers.process import messages as m
from dpstack.drivers.process.shared_image import SIZE, Outputs, Picture, SharedImage, Word, make_memory
from dpstack.drivers.snapshots import Counters, ImageSnapshot
from dpstack.errors import BusError, ConfigError, DpError, PortBusyError, SlaveFault, UsageError
from dpstack.fdl.interface import LinkStats
from dpstack.gsd.diag_texts import DiagTexts
from dpstack.gsd.model import Device
from dpstack.machine import Order
from dpstack.params import BusParams
from dpstack.trace import Event
from dpstack.units import BAUD_RATES

T = TypeVar("T", m.Question, m.News)
JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-99, 99) | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)  # fmt: skip
NS = st.integers(-(2**63), 2**63 - 1)
SETUPS = st.builds(
    SlaveParams,
    address=st.integers(0, 125),
    name=st.text(max_size=8),
    ident=st.none() | st.integers(0, 0xFFFF),
    config=st.just(b"\x21\x11"),
    user_prm=st.binary(max_size=20),
    watchdog_ms=st.none() | st.integers(0, 650_250),
    groups=st.lists(st.integers(1, 8), max_size=3).map(tuple),
    safe=st.just(b"") | st.binary(min_size=2, max_size=2),
    initial=st.none() | st.binary(min_size=2, max_size=2),
    every=st.integers(1, 100),
    max_tsdr=st.dictionaries(st.sampled_from(BAUD_RATES), st.integers(1, 1000)),
    fail_safe_told=st.just(False),
    wd_base_1ms=st.just(False),
    texts=st.none(),
    on_loss=st.text(max_size=5),
)
PARAMS = st.sampled_from((9_600, 500_000, 12_000_000)).map(lambda baud: BusParams.preset(baud, address=7))

#: what has limits of its own
LIMITED: dict[object, st.SearchStrategy[object]] = {
    SlaveParams: SETUPS,
    BusParams: PARAMS,
    object: JSON,
    int: NS,
    float: st.floats(allow_nan=False, allow_infinity=False),
    str: st.text(max_size=8),
    bytes: st.binary(max_size=8),
    bool: st.booleans(),
    type(None): st.none(),
}


#: without those of other tests
NEWS = [
    kind for kind in (*m.order_classes().values(), *m.event_classes().values()) if kind.__module__.startswith("dpstack")
]
#: in an order that does not depend on what was imported first
KINDS = (*sorted(NEWS, key=lambda kind: kind.__name__), Counters, m.Hello, m.News, LinkStats, StackSpec)


@functools.cache  # a strategy is judged by hypothesis when it is used first
def made(hint: Any) -> st.SearchStrategy[Any]:
    """Values of a type hint, dataclasses by those of their fields."""
    if hint in LIMITED:
        return LIMITED[hint]
    if isinstance(hint, type) and issubclass(hint, Enum):
        return st.sampled_from(hint)
    if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        hints = get_type_hints(hint)
        return st.builds(hint, **{name: made(hints[name]) for name in hint.__struct_fields__})
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        hints = get_type_hints(hint)
        return st.builds(hint, **{field.name: made(hints[field.name]) for field in dataclasses.fields(hint)})
    if hasattr(hint, "_fields"):  # a NamedTuple
        return st.builds(hint, **{name: made(kind) for name, kind in get_type_hints(hint).items()})
    origin, arguments = get_origin(hint), [made(argument) for argument in get_args(hint) if argument is not ...]
    if origin in (Union, UnionType):
        return st.one_of(arguments)
    if origin in (list, frozenset):
        return st.lists(arguments[0], max_size=3).map(origin)
    if origin is tuple and ... in get_args(hint):
        return st.lists(arguments[0], max_size=3).map(tuple)
    if origin is tuple:
        return st.tuples(*arguments)
    assert origin in (dict, Mapping), hint
    return st.dictionaries(*arguments, max_size=3)


def sent(message: T) -> T:
    """``message`` as the other process receives it."""
    assert isinstance(message, m.Question | m.News)
    (received,) = m.Frames(type(message)).feed(m.framed(message))
    return received


def order_sent(order: Order) -> Order:
    return m.order_of(sent(m.Question(1, m.named(order))).order)


def events_sent(*events: Event) -> list[Event]:
    return [m.event_of(event) for event in sent(m.News(events=[m.named(event) for event in events])).events]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_every_order_and_event_comes_back_as_it_was(kind: type) -> None:
    @examples(8)
    @given(made(kind))
    def comes_back(thing: object) -> None:
        answer = sent(m.News(answer=m.Answer(1, value=thing))).answer
        assert answer is not None
        assert m.typed(answer.value, kind) == thing

    comes_back()


def test_every_class_is_found_by_its_name() -> None:
    for kind in m.order_classes().values():
        assert issubclass(kind, msgspec.Struct)
    assert len({getattr(kind, "__name__", "") for kind in KINDS}) == len(KINDS)
    with pytest.raises(BusError, match="'Nonsense' is nothing that"):
        m.order_of(("Nonsense", {}))
    with pytest.raises(BusError, match="SetMode cannot be read"):
        m.order_of(("SetMode", {"mode": "loud"}))
    with pytest.raises(BusError, match="is nothing that"):
        m.event_of(("SetMode", {"mode": 128}))  # an order is no event


def test_a_class_whose_module_is_loaded_after_the_first_message_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    over = ConnectionOver(t_ns=1, connection=3, address=9, server_sap=4, reason="closed")
    with monkeypatch.context() as patch:
        patch.setattr(m, "_below", lambda _kind: iter(()))  # nothing is loaded
        m.event_classes.cache_clear()
        assert m.event_classes() == {}
    name, fields = m.named(over)
    assert m.event_of((name, msgspec.to_builtins(fields))) == over


def test_the_octets_are_json_with_a_length_in_front() -> None:
    octets = m.framed(m.Question(3, m.named(AddSlave(SlaveParams(**SETUP)))))
    assert int.from_bytes(octets[:4], "big") == len(octets) - 4
    question = json.loads(octets[4:])
    assert question["number"] == 3
    name, fields = question["order"]
    assert name == "AddSlave"
    assert fields["setup"]["config"] == "IRE="  # 21 11


SETUP: dict[str, Any] = {"address": 4, "name": "valves", "ident": 0x1234, "config": b"\x21\x11"}


def test_the_texts_of_a_gsd_file_stay_here() -> None:
    setup = SlaveParams(address=4, name="v", ident=1, config=b"\x21", texts=DiagTexts(Device()))
    order = order_sent(ReparameteriseSlave(setup))
    assert order == ReparameteriseSlave(setup)  # texts are not compared
    assert isinstance(order, ReparameteriseSlave)
    assert order.setup.texts is None
    with pytest.raises(TypeError, match="does not go to another process"):
        m.framed(m.News(answer=m.Answer(1, value=print)))


@given(st.lists(st.integers(0, 5), min_size=1, max_size=5), st.integers(1, 40))
def test_messages_are_cut_however_they_arrive(numbers: list[int], size: int) -> None:
    octets = b"".join(m.framed(m.News(answer=m.Answer(n))) for n in numbers)
    frames, got = m.Frames(m.News), []
    for at in range(0, len(octets), size):
        got += [news.answer.number for news in frames.feed(octets[at : at + size]) if news.answer]
    assert got == numbers


@pytest.mark.parametrize(
    "octets", [b"\xff\xff\xff\xff", b"\0\0\0\x02{]", b"\0\0\0\x02[]", b"\0\0\0\x0e" + b'{"answer":{"x":', b"\0\0\0\0"]
)
def test_garbage_is_an_error_of_the_bus(octets: bytes) -> None:
    with pytest.raises(BusError, match="between bus process and application"):
        list(m.Frames(m.News).feed(octets + b" " * 20))


def frame(octets: bytes) -> bytes:
    return len(octets).to_bytes(4, "big") + octets


@pytest.mark.parametrize(
    "octets",
    [
        b'{"over":"\xff\xfe"}',
        b'{"over":"\xed\xa0\x80"}',
        b'{"answer":{"number":1,"value":"\\ud800"}}',
        b'{"answer":{"number":1,"value":' + b"[" * 100_000,
        b'{"answer":{"number":1,"value":' + b'{"a":' * 100_000,
        b'{"answer":{"number":' + b"9" * 5000 + b"}}",
        b'{"answer":{"number":1,"value":' + b"9" * 5000 + b"}}",
        b'{"answer":{"number":1,"value":1e999}}',
    ],
)
def test_octets_that_are_no_json_of_ours(octets: bytes) -> None:
    with pytest.raises(BusError, match="a message between bus process and application cannot be read"):
        list(m.Frames(m.News).feed(frame(octets)))


@given(st.binary(max_size=60))
def test_any_octets_in_a_frame(octets: bytes) -> None:
    for inside in (octets, b'{"number":1,"order":' + octets + b"}"):
        with contextlib.suppress(BusError):
            for question in m.Frames(m.Question).feed(frame(inside)):
                m.order_of(question.order)
    for inside in (octets, b'{"over":"' + octets + b'"}'):
        with contextlib.suppress(BusError):
            list(m.Frames(m.News).feed(frame(inside)))


@given(st.text(max_size=20), st.text(max_size=20))
def test_any_name_of_an_error(name: str, text: str) -> None:
    assert isinstance(m.error_of((name, text)), DpError)


@pytest.mark.parametrize(
    "name", ["annotations", "__doc__", "AlarmError", "AcyclicError", "RecordRefused", "DriveFault"]
)
def test_names_that_are_no_error_of_a_text_alone(name: str) -> None:
    assert type(m.error_of((name, "text"))) is BusError


def test_reading_frames_takes_linear_time() -> None:
    octets = m.framed(m.News(answer=m.Answer(1, value="x" * 200)))

    def work_of(n: int) -> Callable[[], object]:
        whole = octets * n

        def work() -> None:
            frames = m.Frames(m.News)
            assert sum(1 for at in range(0, len(whole), 50) for _ in frames.feed(whole[at : at + 50])) == n

        return work

    assert_linear(work_of, 50)


def test_errors_keep_their_class_and_text() -> None:
    for error in (UsageError("a"), ConfigError("b"), PortBusyError("c"), BusError("d")):
        back = m.error_of(m.error_pair(error))
        assert type(back) is type(error)
        assert str(back) == str(error)
    assert type(m.error_of(m.error_pair(SlaveFault(3, "e")))) is BusError
    assert "defect in dpstack" in str(m.error_of(m.error_pair(KeyError("f"))))
    assert get_type_hints(m.News)  # every name in the hints can be looked up


def test_a_slave_of_dp_v1_and_its_records_survive_the_way() -> None:
    dpv1 = Dpv1(alarms=("process",), blocks=(PrmBlock(0x81, 1, b"\x01"),), c1_response_timeout_ns=7)
    order = AddSlave(SlaveParams(address=3, name="v", ident=1, config=b"\x10", user_prm=bytes(3), dpv1=dpv1))
    outcome = Outcome(ServiceFailure.NEGATIVE, "no", codes=(0x80, 0xB5, 0), data=b"\xff\0")
    done = RecordDone(t_ns=1, token=2, address=3, function=Function.READ, slot=4, index=5, outcome=outcome)
    for sent_order in (
        order,
        RecordOrder(1, Function.READ, 3, 4, address=2),
        RecordOrder(1, Function.WRITE, 3, 4, data=b"\xff", address=2),
    ):
        assert order_sent(sent_order) == sent_order
    assert events_sent(done) == [done]


def test_class_2_connections_survive_the_way() -> None:
    outcome = Outcome(ServiceFailure.ABORTED, "no", codes=(0, 1, 3))
    for order in (
        OpenConnection(1, 2, InitiateReq(3, source=Address(1, 2), destination=Address(net=bytes(7))), 4),
        RecordOrder(1, Function.READ, 3, 4, connection=2),
        RecordOrder(1, Function.WRITE, 3, 4, data=b"\xff", connection=2),
        RecordOrder(1, Function.DATA_TRANSPORT, 3, 4, data=b"\xff", connection=2),
        CloseConnection(1),
        CloseConnections(),
    ):
        assert order_sent(order) == order
    events: tuple[Event, ...] = (
        InitiateDone(t_ns=1, token=2, address=3, outcome=outcome, server_sap=48),
        RecordDone(
            t_ns=1, token=2, address=3, function=Function.DATA_TRANSPORT, slot=4, index=5, outcome=Outcome(data=b"\xff")
        ),
        ConnectionOver(t_ns=1, connection=2, address=3, server_sap=48, reason="why", abort=(0, 1, 3)),
        ConnectionsClosed(t_ns=1),
    )
    assert events_sent(*events) == list(events)


def test_arguments_of_a_drives_order_always_go_over() -> None:
    asked = {"number": "F\udcff", "value": float("nan"), "index": 10**400, "parameters": [{"number": "\ud800"}]}
    told = m.checked_arguments(asked)
    assert told["number"] == "'F\\udcff'"
    assert told["parameters"] == [{"number": "'\\ud800'"}]
    assert m.framed(m.Question(1, m.named(DriveCommand(3, "read", told, 1))))


U64 = st.integers(0, 2**64 - 1)
OCTETS = st.binary(max_size=244)
SLAVES = st.dictionaries(
    st.integers(0, 126),
    st.builds(ImageSnapshot, OCTETS, OCTETS, st.booleans(), U64, U64, st.booleans(), U64, U64),
    max_size=5,
)

#: writes pictures whose octets are all alike, of every length, as quickly as it can
WRITER = """
import sys
from dpstack.drivers.process.shared_image import Picture, SharedImage, Word
from dpstack.drivers.snapshots import ImageSnapshot
image = SharedImage(int(sys.argv[1]))
print(flush=True)
number = 0
while True:
    number += 1
    octets = bytes((number % 251,)) * (number * 7919 % 40_000)
    image.inputs.write(Picture(number, 0, {4: ImageSnapshot(octets, b"", True, 0, 0)}))
"""


@pytest.fixture
def memory() -> Iterator[int]:
    fd = make_memory()
    yield fd
    os.close(fd)


@pytest.fixture
def both(memory: int) -> Iterator[tuple[SharedImage, SharedImage]]:
    """The same memory as the bus process and the application see it."""
    image, there = SharedImage(memory), SharedImage(memory)
    yield image, there
    image.close()
    there.close()


def picture(octets: bytes) -> Picture:
    return Picture(1, 2, {4: ImageSnapshot(octets, b"", True, 3, 4)})


@given(U64, U64, SLAVES, st.dictionaries(st.integers(0, 126), st.builds(Outputs, U64, OCTETS, U64), max_size=5))
def test_pictures_and_outputs_come_back_as_they_were(
    cycle: int, rotations: int, slaves: dict[int, ImageSnapshot], outputs: dict[int, Outputs]
) -> None:
    memory = make_memory()
    image, there = SharedImage(memory), SharedImage(memory)
    os.close(memory)
    image.inputs.write(Picture(cycle, rotations, slaves))
    assert there.inputs.read_new() == Picture(cycle, rotations, slaves)
    there.outputs.write(outputs)
    assert image.outputs.read_new() == outputs
    image.close()
    there.close()


def test_the_octets_of_a_picture_and_of_outputs(memory: int, both: tuple[SharedImage, SharedImage]) -> None:
    image, there = both
    image.inputs.write(Picture(3, 2, {4: ImageSnapshot(b"\x11\x22", b"\x33", True, 5, 6, True, 7, 8)}))
    octets = bytes.fromhex("93 03 02 81 04 98 C4 02 11 22 C4 01 33 C3 05 06 C3 07 08")
    assert os.pread(memory, len(octets) + 1, 4096 + 80 * 1024) == octets + b"\0"
    there.outputs.write({4: Outputs(0x0102, b"\x11\x22", 8), 5: Outputs(3, b"")})
    octets = bytes.fromhex("82 04 93 CD 01 02 C4 02 11 22 08 05 93 03 C4 00 00")
    assert os.pread(memory, len(octets) + 1, 4096 + 4 * 80 * 1024 + 40 * 1024) == octets + b"\0"


def test_126_slaves_with_all_the_octets_there_can_be(memory: int, both: tuple[SharedImage, SharedImage]) -> None:
    image, there = both
    most = 2**64 - 1
    full = {n: ImageSnapshot(b"\x11" * 244, b"\x22" * 244, True, most, most, True, most, most) for n in range(127)}
    image.inputs.write(Picture(most, most, full))
    assert there.inputs.read_new() == Picture(most, most, full)
    outputs = {address: Outputs(most, bytes(244), most) for address in range(127)}
    there.outputs.write(outputs)
    assert image.outputs.read_new() == outputs
    assert os.fstat(memory).st_size == SIZE


def test_a_reader_gets_the_newest_picture_once(both: tuple[SharedImage, SharedImage]) -> None:
    image, there = both
    assert there.inputs.read_new() is None  # nobody has written yet
    image.inputs.write(picture(b"one"))
    image.inputs.write(picture(b"two"))
    assert there.inputs.read_new() == picture(b"two")
    assert there.inputs.read_new() is None
    image.inputs.write(picture(b"x" * 80 * 1024))  # longer than there is room for
    assert there.inputs.read_new() is None
    image.inputs.write(picture(b""))
    assert there.inputs.read_new() == picture(b"")


def test_a_half_written_picture_blocks_no_reader(memory: int, both: tuple[SharedImage, SharedImage]) -> None:
    image, there = both
    image.inputs.write(picture(b"whole"))
    assert there.inputs.read_new() == picture(b"whole")
    os.pwrite(memory, b"torn!", 4096 + 2 * 80 * 1024)  # the second picture, half of it, and not yet its number
    assert there.inputs.read_new() is None
    image.inputs.write(picture(b"again"))
    assert there.inputs.read_new() == picture(b"again")
    os.pwrite(memory, (3).to_bytes(8, sys.byteorder), 0)  # a number without its octets: the check sum is that of none
    assert there.inputs.read_new() is None
    os.pwrite(memory, (2**40).to_bytes(8, sys.byteorder), 8 + 16 * 3)  # a length that cannot be
    assert there.inputs.read_new() is None


def test_no_picture_is_ever_torn(memory: int) -> None:
    """One process writes as quickly as it can, this one reads: whole pictures only, and the newest."""
    image = SharedImage(memory)
    writer = subprocess.Popen([sys.executable, "-c", WRITER, str(memory)], stdout=subprocess.PIPE, pass_fds=(memory,))
    assert writer.stdout is not None
    try:
        writer.stdout.readline()
        whole = 0
        end = time.monotonic() + HANG_S
        while whole < 2_000:
            found = image.inputs.read_new()
            if found is not None:
                octets = found.slaves[4].inputs
                assert octets == bytes((found.cycle % 251,)) * len(octets)
                whole += 1
            assert time.monotonic() < end, f"only {whole} pictures could be read"
    finally:
        writer.kill()
        writer.wait()
        writer.stdout.close()
    image.close()


def test_the_number_of_taken_outputs_is_set_before_they_are_read(both: tuple[SharedImage, SharedImage]) -> None:
    """An application that takes outputs back and then sees an older number knows that nobody will send them."""
    image, there = both
    assert there.take_outputs() is None
    image.outputs.write({4: Outputs(1, b"\x11")})
    image.outputs.write({4: Outputs(2, b"\x22")})
    assert (image.outputs.newest, image.words[Word.OUTPUTS_TAKEN]) == (2, 0)
    assert there.take_outputs() == {4: Outputs(2, b"\x22")}
    assert image.words[Word.OUTPUTS_TAKEN] == 2
    assert there.take_outputs() is None


def test_each_area_and_word_has_its_own_place(both: tuple[SharedImage, SharedImage]) -> None:
    image, there = both
    image.words[Word.HEARTBEAT], image.words[Word.ORDER_TAKEN], image.words[Word.SILENCES] = 2**64 - 1, 2, 3
    assert (there.words[Word.HEARTBEAT], there.words[Word.ORDER_TAKEN], there.words[Word.SILENCES]) == (2**64 - 1, 2, 3)
    assert (there.words[Word.OUTPUTS_TAKEN], there.words[Word.ROUNDS_WATCHED]) == (0, 0)
    image.words[Word.ROUNDS_WATCHED] = True
    assert there.words[Word.ROUNDS_WATCHED] == 1
    counters = Counters(t_ns=1, damage={str(number): number for number in range(40_000)})
    image.counters.write(counters)
    image.drives.write({4: "x" * 260_000})
    image.inputs.write(picture(b"in"))
    assert there.counters.read_new() == counters
    assert there.drives.read_new() == {4: "x" * 260_000}
    assert there.inputs.read_new() == picture(b"in")
