"""Limits of dpv1 at their edges: lengths, numbers and times, on both sides of each edge."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import pytest
from alarm_kit import AlarmBus, block
from ms1_kit import MS, Ms1Bus, answer
from ms2_kit import connected
from octet_class2 import ABORT, ABORT_TIMEOUT, IDLE, RS, SC
from octet_slave import SC as SC_OCTET
from order_bus import OrderBus
from slave_alarm_kit import AlarmBench, prm
from slave_kit import PRM

from dpstack.dp.acyclic.job import CancelService, Outcome, RequestEnd, ServiceFailure
from dpstack.dp.acyclic.queue import Provider
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dpv1 import timeouts
from dpstack.dpv1.master.alarm_handler import Alarms
from dpstack.dpv1.master.ms1 import Ms1
from dpstack.dpv1.master.ms2 import Ms2
from dpstack.dpv1.master.orders import RecordOrder
from dpstack.dpv1.master.srd_polling import Polling, Reply
from dpstack.dpv1.pdu.im import IM_ANSWER, IM_FI, IM_INDEX, IM_LEN, Im0, Im1, Im2, build_call, parse_call
from dpstack.dpv1.pdu.ms2 import Address, InitiateReq, ResourceManagerRes
from dpstack.dpv1.pdu.read_write import DataTransport, Function, ReadReq, WriteReq, parse_request, parse_response
from dpstack.dpv1.slave.description import SlaveDescription, SlaveModule, SlaveParameter
from dpstack.dpv1.slave.description_to_gsd import as_gsd_file, gsd_octets
from dpstack.dpv1.slave.record_requests import NOBODY, RecordRequest
from dpstack.dpv1.slave.record_table import ImRecords, RecordTable
from dpstack.errors import ConfigError, PduError
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import Kind, Req, Telegram
from dpstack.gsd.model import DiagText
from tests.dpv1.ms2_slave_kit import TIMEOUT, Later, Slave, reach

ProviderT = TypeVar("ProviderT", bound=Provider)


def possible(call: Callable[..., object], *values: object, error: type[Exception] = PduError) -> bool:
    try:
        call(*values)
    except error:
        return False
    return True


def provider(kit: OrderBus[Any], kind: type[ProviderT]) -> ProviderT:
    """The part of the acyclic services that is a ``kind``."""
    return next(one for one in kit.acyclic.providers if isinstance(one, kind))


# --- PDUs -----------------------------------------------------------------------------------------------------------


def test_data_of_a_record_are_0_to_240_octets() -> None:
    for kind, head in ((WriteReq, 0x5F), (DataTransport, 0x51)):
        for length in (0, 1, 240):
            octets = bytes((head, 0, 0, length)) + bytes(length)
            assert kind(0, 0, bytes(length)).build() == octets
        assert not possible(kind(0, 0, bytes(241)).build)
    assert ReadReq(0, 0, 0).build() == bytes.fromhex("5E000000")
    for length, well in ((0, True), (240, True), (241, False)):
        data = bytes(length)
        assert possible(parse_request, bytes((0x5E, 0, 0, length))) is well
        assert possible(parse_request, bytes((0x5F, 0, 0, length)) + data) is well
        assert possible(parse_response, bytes((0x5E, 0, 0, length)) + data) is well
        assert possible(DataTransport.parse, bytes((0x51, 0, 0, length)) + data) is well


def test_answers_are_cut_to_what_was_asked_for() -> None:
    for asked, data in ((0, b""), (2, b"\1\2"), (3, b"\1\2\3"), (240, b"\1\2\3")):
        assert ReadReq(1, 2, asked).response(b"\1\2\3").data == data
    assert WriteReq(1, 2, b"\1\2").response(b"ignored").build() == bytes.fromhex("5F010202")
    assert DataTransport(1, 2, b"\1").response(b"\5\6").build() == bytes.fromhex("510102020506")
    request = RecordRequest(ReadReq(1, 2))
    assert (request.asker, request.at, request.open, request.response) == (NOBODY, 0, True, None)
    assert (NOBODY.master, NOBODY.sap, NOBODY.open) == (-1, -1, True)
    with pytest.raises(PduError) as refused:
        request.answer(bytes(241))
    assert str(refused.value) == "241 octets of data, 240 are possible in one record"
    request.answer(bytes(240))
    assert request.response is not None
    transport = RecordRequest(DataTransport(1, 2, b""))
    assert transport.title == "Data_Transport to slot 1, index 2"
    assert request.title == "Read of slot 1, index 2"
    with pytest.raises(PduError, match=r"^241 octets of data, 240 are possible in one service$"):
        transport.answer(bytes(241))
    refusing = RecordRequest(WriteReq(1, 2, b""))
    refusing.refuse(0x1B6, 0x103)
    assert refusing.response is not None
    assert refusing.response.build() == bytes.fromhex("DF80B603")


def test_a_send_timeout_counts_10_ms_and_is_rounded_up() -> None:
    for ns, counts in ((0, 0), (1, 1), (10 * MS, 1), (10 * MS + 1, 2), (655_350 * MS, 65535)):
        assert ResourceManagerRes(0, ns).build() == bytes((0x56, 0)) + counts.to_bytes(2, "big")
    for ns in (-1, 655_350 * MS + 1):
        with pytest.raises(PduError, match=r"is not possible: 0\.\.655\.35 s$"):
            ResourceManagerRes(0, ns).build()
    for sap, well in ((0, True), (48, True), (49, False)):
        assert possible(ResourceManagerRes(sap, 0).build) is well
        assert possible(ResourceManagerRes.parse, bytes((0x56, sap, 0, 0))) is well


@pytest.mark.parametrize(
    ("kind", "length", "well"),
    [(0, 1, False), (0, 2, True), (0, 3, False), (1, 7, False), (1, 8, True), (1, 9, True), (2, 2, False)],
)
def test_lengths_of_addresses_in_initiate(kind: int, length: int, well: bool) -> None:
    for octets in (
        bytes((kind, length, 0, 2)) + bytes(range(1, length + 1)) + b"\7\7",
        bytes((0, 2, kind, length)) + b"\7\7" + bytes(range(1, length + 1)),
    ):
        request = bytes.fromhex("57000000 0064 0100 0000 0000") + octets
        assert possible(InitiateReq.parse, request) is well
        if well:
            found = InitiateReq.parse(request)
            ends = (Address(1, 2, bytes(range(3, length + 1))), Address(7, 7))
            assert {found.source, found.destination} == set(ends)
            assert found.source == (ends[1] if octets[-2:] != b"\7\7" else ends[0])
            assert found.build() == request


def test_numbers_of_an_address_in_initiate_are_octets() -> None:
    for value in (-1, 256, 1 << 53):
        with pytest.raises(PduError, match=f"api = {value} and scl = 0 are octets: give 0..255"):
            InitiateReq(1, source=Address(api=value)).build()
        with pytest.raises(PduError, match=f"api = 0 and scl = {value} are octets"):
            InitiateReq(1, destination=Address(scl=value)).build()
    assert Address(255, 255).build() == b"\xff\xff"


def test_calls_of_im() -> None:
    assert (255, 64, 68, range(65000, 65200)) == (IM_INDEX, IM_LEN, IM_ANSWER, IM_FI)
    for number, octets in ((0, "0800FDE8"), (4, "0800FDEC"), (199, "0800FEAF")):
        assert build_call(number).hex().upper() == octets
        assert parse_call(bytes.fromhex(octets)) == (65000 + number, b"")
    for wrong in ("0800FDE7", "0800FEB0", "0700FDE8", "0800FD"):
        assert not possible(parse_call, bytes.fromhex(wrong))
    assert not possible(Im0.parse, Im0().build()[:63])
    assert Im0.parse(Im0().build() + b"x") == Im0()


@pytest.mark.parametrize("slot", [-1, 0, 254, 255])
def test_slots_of_im(slot: int) -> None:
    if 0 <= slot <= 254:
        assert ImRecords({slot: [Im1("x")]}).of(slot)[1] == Im1("x")
        assert ImRecords({slot: []}).of(slot) == (Im0(),)
        return
    with pytest.raises(PduError) as refused:
        ImRecords({slot: []})
    assert str(refused.value) == f"I&M of slot {slot}: slots are 0..254"


def test_writes_of_im_and_of_a_table() -> None:
    def written(records: Any, *writes: str) -> list[str]:
        answers = []
        for octets in writes:
            request = RecordRequest(parse_request(bytes.fromhex(octets)))
            records.ask(request)
            assert request.response is not None
            answers.append(request.response.build().hex(" "))
        return answers

    im = ImRecords({1: [Im1("a")]}, RecordTable({(1, 7): b"\1"}))
    whole = "0800FDE9" + Im1("b").build().hex()
    assert written(
        im,
        "5F01FF04 0800FDE9",
        f"5F01FF44 {whole}",
        f"5F01FF43 {whole[:-2]}",
        f"5F01FF45 {whole}00",
        "5F01FF44 0800FDE8" + Im0().build().hex(),
        "5F01FF04 0800FDEA",
        "5F02FF04 0800FDE9",
        "5E0107F0",
        "5E0108F0",
    ) == [
        "5f 01 ff 04", "5f 01 ff 44", "df 80 b1 00", "df 80 b1 00", "df 80 b6 00", "df 80 b7 00", "df 80 b2 00",
        "5e 01 07 01 01", "de 80 b0 00",
    ]  # fmt: skip
    assert im.of(1)[1] == Im1("b")
    table = RecordTable({(1, 2): b"\1\2", (1, 3): b""}, [(1, 2)])
    assert written(table, "5F01020103", "5F0102020304", "5F0102030304 05", "5F010300", "5E0102F0") == [
        "df 80 b1 00", "5f 01 02 02", "df 80 b1 00", "df 80 b6 00", "5e 01 02 02 03 04",
    ]  # fmt: skip


# --- descriptions ---------------------------------------------------------------------------------------------------


def test_user_parameters_of_modules_in_a_gsd_file() -> None:
    def file_with(octets: int, *parameters: SlaveParameter) -> Callable[[], bytes]:
        module = SlaveModule("m", b"\x10", bytes(octets), parameters)
        return lambda: gsd_octets(SlaveDescription(ident=1, name="x", modules=(module, SlaveModule("e", b"\0"))))

    assert b"Ext_Module_Prm_Data_Len = 237\r\n" in file_with(237)()
    assert b"Ext_Module_Prm_Data_Len = 237\r\n" in file_with(0, SlaveParameter("P", 236))()
    for file in (
        file_with(238),
        file_with(0, SlaveParameter("P", 237)),
        file_with(0, SlaveParameter("P", 236, "Unsigned16")),
    ):
        with pytest.raises(ConfigError) as refused:
            file()
        assert str(refused.value) == "module m: more than 237 octets of user parameters; Set_Prm has no room"


def test_limits_of_a_fixed_slave_are_not_in_its_gsd_file() -> None:
    limits: dict[str, Any] = {"max_input_len": 5, "max_output_len": 6, "max_data_len": 7, "max_modules": 2}
    fixed, remarks = as_gsd_file(SlaveDescription(ident=1, configs=(b"\x10\x20",), **limits))
    assert (fixed.max_input_len, fixed.max_output_len, fixed.max_data_len, fixed.max_modules) == (244, 244, 488, 1)
    assert remarks == ()
    modules = (SlaveModule("m", b"\x10"), SlaveModule("e", b"\0"))
    modular, _ = as_gsd_file(SlaveDescription(ident=1, modules=modules, **limits))
    assert {name: getattr(modular, name) for name in limits} == limits
    for name in limits:
        limits[name] = 1000
    most, _ = as_gsd_file(SlaveDescription(ident=1, modules=modules, **limits))
    assert (most.max_input_len, most.max_output_len, most.max_data_len, most.max_modules) == (244, 244, 488, 244)


@pytest.mark.parametrize(
    ("what", "changes"),
    [
        ("the name", {"name": "x" * 33}),
        ("vendor", {"vendor": "x" * 33}),
        ("revision", {"revision": "x" * 33}),
        ("the name of a module", {"configs": (), "modules": (SlaveModule("x" * 201, b"\x10"),)}),
        ("the name of a parameter", {"parameters": (SlaveParameter("x" * 201, 0),)}),
        ("parameter P: the text", {"parameters": (SlaveParameter("P", 0, texts={1: "x" * 201}),)}),
        ("a text", {"diag_texts": (DiagText("bit", 1, 1, 1, "x" * 201, ""),)}),
        ("a help text", {"diag_texts": (DiagText("bit", 1, 1, 1, "t", "x" * 201),)}),
    ],
)
def test_texts_that_are_too_long_for_a_gsd_file(what: str, changes: dict[str, Any]) -> None:
    most = 32 if "x" * 33 in changes.values() else 200
    base: dict[str, Any] = {"ident": 1, "configs": (b"\x10",)}
    with pytest.raises(ConfigError) as refused:
        as_gsd_file(SlaveDescription(**base | changes))
    shown = "x" * 33 if most == 32 else "x" * 37 + "..."
    assert str(refused.value) == f"{what} '{shown}' has {most + 1} characters; a GSD file allows {most}"


def test_diagnosis_texts_of_neighbours_are_kept_apart() -> None:
    texts = tuple(DiagText("bit", bit, bit, 1, f"bit {bit}", "") for bit in (0, 1, 2))
    texts += (
        DiagText("area", 0, 1, 0, "a", ""),
        DiagText("area", 0, 2, 0, "b", ""),
        DiagText("area", 1, 2, 0, "c", ""),
    )
    said, _ = as_gsd_file(SlaveDescription(ident=1, configs=(b"\x10",), diag_texts=texts[::-1]))
    assert said.diag_texts == texts
    again = (DiagText("bit", 0, 0, 1, "another", ""), *texts)
    assert as_gsd_file(SlaveDescription(ident=1, configs=(b"\x10",), diag_texts=again))[0].diag_texts == texts


def test_texts_of_im_in_octets() -> None:
    for text in ("", "X", "XX X", "x" * 16, " x"):
        octets = Im2(text).build()
        assert octets[10:26] == text.encode().ljust(16)
        assert Im2.parse(octets).date == text
    for text, error in (("x" * 17, "date = 'xxxxxxxxxxxxxxxxx' has 17 characters, 16 are possible"),
                        ("\u20ac", "date = '\u20ac' has characters outside ISO 8859-1")):  # fmt: skip
        with pytest.raises(PduError) as refused:
            Im2(text).build()
        assert str(refused.value) == error
    padded = Im2("x").build()[:11] + b"\0 " + bytes(51)
    assert Im2.parse(padded).date == "x"


@pytest.mark.parametrize(
    ("changes", "well"),
    [
        ({"max_diag_len": 6}, True), ({"max_diag_len": 5}, False), ({"max_diag_len": 244}, True),
        ({"max_diag_len": 245}, False), ({"max_data_len": 2}, True), ({"max_data_len": 1}, False),
        ({"max_input_len": 1}, True), ({"max_input_len": 0}, False), ({"max_output_len": 1}, True),
        ({"user_prm_len": (0, 0)}, True), ({"user_prm_len": (237, 237)}, True), ({"ident": 0}, True),
        ({"ident": 0xFFFF}, True), ({"dpv1": True, "alarms": ("process",), "max_diag_len": 10}, True),
        ({"dpv1": True, "max_diag_len": 9}, True), ({"dpv1": True, "user_prm_len": (3, 3)}, True),
        ({"ms2": 49}, True), ({"ms2": 50}, False), ({"ms2_max_len": 1}, True), ({"ms2_max_len": 240}, True),
        ({"ms2_max_initiate": 20}, True), ({"ms2_max_initiate": 244}, True),
        ({"dpv1": True, "alarm_sequence": 2}, True),
        ({"dpv1": True, "alarm_sequence": 32}, True),
    ],
)  # fmt: skip
def test_descriptions(changes: dict[str, Any], well: bool) -> None:
    base: dict[str, Any] = {"ident": 1, "configs": (b"\x10\x20",)}
    assert possible(lambda: SlaveDescription(**base | changes), error=ConfigError) is well


# --- polling --------------------------------------------------------------------------------------------------------


def test_pauses_and_times() -> None:
    assert [timeouts.pause_before(polls) // MS for polls in range(10)] == [0, 0, 0, 0, 1, 2, 5, 10, 10, 10]
    rates = (9600, 499_999, 500_000, 1_499_999, 1_500_000, 12_000_000)
    assert [timeouts.least_send_timeout(baud) // MS for baud in rates] == [4000, 4000, 2000, 2000, 1000, 1000]
    for response_s, s in ((0, 10), (9, 10), (10, 11)):
        assert timeouts.service_timeout(response_s * 1000 * MS) == s * 1000 * MS


ACK = Telegram(Kind.SC, 2, 4, 0)


def polled(
    limit: int, answers: Sequence[tuple[Telegram | Failure, int]], call: Callable[[Polling], Any]
) -> tuple[Any, list[int]]:
    """The result of ``call``, and the pauses before its requests; each answer has the time it takes."""
    polling = Polling(lambda octets: Request(4, Req.SRD_HIGH, octets), limit)
    steps, pauses, now = call(polling), [], 0
    try:
        step = next(steps)
        for heard, took in answers:
            pauses.append(step.pause_ns)
            begun, now = now, now + took
            step = steps.send(RequestEnd(heard, begun, now))
    except StopIteration as end:
        return end.value, pauses
    raise AssertionError("it asks for more")


@pytest.mark.parametrize(("took", "reply"), [(99, Reply.DATA), (100, Reply.LATE), (101, Reply.LATE)])
def test_the_slave_has_had_its_time(took: int, reply: Reply) -> None:
    data = Telegram(Kind.SD2, 2, 4, 8, 51, 51, b"\1")
    assert polled(100, [(ACK, took), (data, 1)], lambda polling: polling.poll())[0] is reply


@pytest.mark.parametrize("attempts", [1, 2, 3])
def test_requests_and_polls_without_an_answer(attempts: int) -> None:
    lost: list[tuple[Telegram | Failure, int]] = [(Failure.NO_ANSWER, 1)] * attempts
    for call in (lambda one: one.send(b"\1", attempts), lambda one: one.poll(attempts)):
        reply, pauses = polled(10**12, lost, call)
        assert (reply, len(pauses)) == (Reply.NOTHING, attempts)
    found: list[Polling] = []

    def kept(polling: Polling) -> Any:
        found.append(polling)
        return polling.send(b"\1", attempts)

    polled(10**12, lost, kept)
    assert (found[0].unanswered, found[0].busy, found[0].now) == (attempts, False, attempts)
    assert found[0].answer is Failure.NO_ANSWER
    assert found[0].pdu == b""


def test_the_pauses_between_polls() -> None:
    data = Telegram(Kind.SD2, 2, 4, 8, 51, 51, b"\1")
    reply, pauses = polled(10**12, [(ACK, 1)] * 9 + [(data, 1)], lambda polling: polling.poll())
    assert (reply, [pause // MS for pause in pauses]) == (Reply.DATA, [0, 0, 0, 0, 1, 2, 5, 10, 10, 10])


def test_an_answer_between_two_silences_begins_the_count_anew() -> None:
    lost, data = Failure.NO_ANSWER, Telegram(Kind.SD2, 2, 4, 8, 51, 51, b"\1")
    replies: list[tuple[Telegram | Failure, int]] = [(lost, 1), (ACK, 1), (lost, 1), (ACK, 1), (lost, 1), (lost, 1)]
    first = polled(10**12, replies, lambda polling: polling.poll(2))
    assert first[0] is Reply.NOTHING
    assert polled(10**12, [*replies[:5], (data, 1)], lambda polling: polling.poll(2))[0] is Reply.DATA
    # the pause after silence is that of the first silence each time
    assert first[1][1] == first[1][3] == first[1][5]


# --- turns at record 47 ---------------------------------------------------------------------------------------------


def drive_bus(unready: int) -> Ms1Bus:
    """A drive whose record 47 has no answer before ``unready`` Reads of it."""
    kit = Ms1Bus()
    reads = 0

    def ms1(data: bytes) -> bytes:
        nonlocal reads
        if data[:1] == b"\x5f":
            return answer(4, f"5F 01 2F {len(data) - 4:02X}")
        reads += 1
        return answer(4, "DE 80 B5 00" if reads <= unready else "5E 01 2F 01 07")

    kit.slave.ms1 = ms1
    return kit


def test_a_turn_without_a_read_ends_after_2_s() -> None:
    kit = drive_bus(0)
    kit.write(1, 47, b"\1")
    turn = provider(kit, Ms1).turns[4]
    begun = kit.done[-1].t_ns
    assert (turn.user, turn.until, turn.longest) == (0, begun + 2_000 * MS, begun + 10_000 * MS)
    read = kit.read(1, 47)
    assert turn.until == read.t_ns


def test_a_turn_goes_on_while_the_drive_is_not_ready_10_s_at_most() -> None:
    kit = drive_bus(3)
    kit.write(1, 47, b"\1")
    turn = provider(kit, Ms1).turns[4]
    written = kit.done[-1].t_ns
    for _ in range(3):
        kit.run(50)
        read = kit.read(1, 47)
        assert read.outcome.codes == (0x80, 0xB5, 0)
        assert turn.until == read.t_ns + 2_000 * MS
    turn.longest = read.t_ns + 2_000 * MS  # as if the Write was 8 s ago
    last = kit.read(1, 47)
    assert turn.until == last.t_ns
    assert written < last.t_ns


def test_a_write_that_never_began_leaves_the_turn_as_it_is() -> None:
    kit = drive_bus(0)
    kit.write(1, 47, b"\1")
    turn = provider(kit, Ms1).turns[4]
    until = turn.until
    token = kit.next_token()
    kit.send(RecordOrder(token, Function.WRITE, 1, 47, data=b"\2", address=4))
    kit.send(CancelService(token))
    assert kit.end(token).text == "Write of slot 1, index 47 to slave 4 was cancelled"
    assert turn.until == until
    kit.send(CancelService(kit.order_read(1, 47)))  # but a program that does not want its answer ends it
    kit.run(1)
    assert turn.until < until


# --- times of alarms ------------------------------------------------------------------------------------------------


def test_an_acknowledgement_without_answer_is_repeated_after_100_200_500_and_1000_ms() -> None:
    kit = AlarmBus(dpv1=Dpv1(alarms=("process",), alarm_mode=0))
    kit.alarm_slave.says[51] = lambda octets: SC_OCTET
    kit.alarm_slave.raises(block(2, 3))
    kit.until(lambda: kit.raised)
    alarms = provider(kit, Alarms)._alarms[4]
    (known,) = alarms._open.values()
    known.attempts, alarms._asked, alarms._read_after = 0, None, -1
    for number, wanted in enumerate((100, 200, 500, 1000, 1000, 1000), 1):
        alarms.begin_ack(known)
        assert known.attempts == number
        alarms.ended(known, Outcome(ServiceFailure.SILENT, "slave 4 does not answer"), 7)
        assert known.not_before == 7 + wanted * MS
        assert alarms.next_ack(known.not_before - 1) is None
        assert alarms.next_ack(known.not_before) is known
    assert kit.counts.repeated == 5
    assert kit.ends == []


def test_without_dpv1_enable_no_alarm_is_agreed() -> None:
    for octets, limit in (("80 FC 07", 32), ("00 FC 07", 0), ("40 FC 07", 0), ("80 FC", 0), ("", 0)):
        made = AlarmBench(sequence=32).start(PRM + bytes.fromhex(octets))
        assert made.alarms.limit == limit


def test_acknowledgements_of_the_last_31_alarms_may_come_again() -> None:
    made = AlarmBench().start(prm())
    acks = []
    for slot in range(33):
        made.raise_(f"02 {slot:02X} 00")
        made.fetch()
        acks.append(f"{slot:02X} 02 {(slot % 32) << 3:02X}")
        assert made.ack(acks[-1]) == f"5C {acks[-1]}"
    assert [made.ack(ack)[:2] for ack in acks] == ["DC"] * 2 + ["5C"] * 31


# --- connections of class 2 -----------------------------------------------------------------------------------------


def test_a_silent_slave_loses_its_connection_after_the_send_timeout() -> None:
    kit = connected(send_timeout_ns=200 * MS)
    ms2 = provider(kit, Ms2)
    (connection,) = ms2.connections.values()
    at = connection.answered_at + 200 * MS
    assert ms2.wake_at() == at
    assert (ms2.tick(at - 1), ms2.tick(at)) == (False, True)
    assert ms2.wake_at() > at


@pytest.mark.parametrize(("step", "times"), [("opened", 2), ("asked", 1), ("fetched", 2), ("idle", 1), ("manager", 1)])
def test_a_silent_master_loses_its_connection(step: str, times: int) -> None:
    """After its send time-out while anything is under way, after twice that while nothing is (VPC3+)."""
    for early, answer_ in ((1, None), (0, ABORT_TIMEOUT)):
        later = Later()
        slave = Slave(later)
        reach(slave, later, step)
        app, now = slave.app, slave.wire.now
        last = max(one.last_request for one in app.services[1]._connections.values())  # type: ignore[attr-defined]
        deadline = last + times * TIMEOUT
        assert app.services[1].at <= deadline
        app.services[1].tick(deadline - early)
        assert bool(slave.saps()) is bool(early)
        assert now < deadline
        if answer_ is not None:
            assert slave.master.ask(48) == answer_
            assert slave.master.ask(48) == RS


def test_a_slave_that_works_says_idle_after_half_of_its_send_timeout() -> None:
    for early, found in ((1, SC), (0, IDLE)):
        later = Later()
        slave = Slave(later)
        reach(slave, later, "asked")
        server = next(iter(slave.app.services[1]._connections.values()))  # type: ignore[attr-defined]
        answered = server.poll(server._last_sign + TIMEOUT // 2 - early)
        assert answered == (None if found == SC else bytes.fromhex(IDLE))
        assert slave.master.ask(48, ABORT) == SC
