"""Alarms of a slave, literally: blocks in the diagnosis, both modes, Alarm_Ack that fits, does not, or comes again."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from slave_alarm_kit import AlarmBench, prm
from slave_kit import CFG, OTHER, PRM, UNLOCK

from dpstack.dp.pdu.alarm_blocks import Alarm, ModuleState, Status, kind_of, module_status
from dpstack.dp.pdu.diag_blocks import UserDiag, channel_block
from dpstack.dp.slave.application import SlaveAppState
from dpstack.dpv1.slave.alarms import MAX_WAITING, AlarmEnd, AlarmServer, AlarmSupport
from dpstack.errors import AlarmError, ConfigError, PduError, UsageError
from dpstack.fdl.interface import RS_REPLY


def refusal(bench: AlarmBench, raised: str) -> str:
    """The reason why the slave cannot raise that alarm."""
    with pytest.raises(AlarmError) as caught:
        bench.raise_(raised)
    return caught.value.reason


@pytest.fixture
def bench() -> AlarmBench:
    return AlarmBench().start()


@pytest.mark.parametrize(
    ("raised", "block", "ack"),
    [
        ("01 02 01 AA", "05 01 02 01 AA", "02 01 01"),
        ("02 03 00", "04 02 03 00", "03 02 00"),
        ("03 01 00", "04 03 01 00", "01 03 00"),
        ("04 01 03", "04 04 01 03", "01 04 03"),
        ("05 00 02", "04 05 00 02", "00 05 02"),
        ("06 FE 00", "04 06 FE 00", "FE 06 00"),
        ("20 01 00 01 02", "06 20 01 00 01 02", "01 20 00"),
        ("7E 01 00" + " 55" * 59, "3F 7E 01 00" + " 55" * 59, "01 7E 00"),
    ],
)
def test_every_type_is_shown_and_acknowledged(bench: AlarmBench, raised: str, block: str, ack: str) -> None:
    assert not bench.must_fetch
    alarm = bench.raise_(raised)
    assert bench.fetch() == block
    assert not bench.must_fetch
    assert bench.alarms.pending == (alarm,)
    assert bench.ack(ack) == f"5C {ack}"
    assert alarm.end is AlarmEnd.ACKNOWLEDGED
    assert not bench.must_fetch  # that it is gone is no news
    assert bench.ext() == ""


def test_the_additional_acknowledgement_is_a_bit_of_the_specifier(bench: AlarmBench) -> None:
    bench.raise_("01 02 01", add_ack=True)
    assert bench.fetch() == "04 01 02 05"
    assert bench.ack("02 01 05") == "5C 02 01 05"


def test_type_mode_one_of_each_type_at_a_time() -> None:
    bench = AlarmBench(sequence=32).start(prm(mode=0))
    raised = [bench.raise_(text) for text in ("01 01 01", "01 02 01", "02 01 00", "20 01 00", "21 01 00")]
    assert bench.fetch() == "04 01 01 01"
    assert bench.fetch() == "04 02 01 08"  # the second of type 1 waits, and holds up nobody else
    assert bench.fetch() == "04 20 01 10"
    assert not bench.must_fetch  # vendor types count as one
    assert bench.ext() == "04 20 01 10"  # the last stays until acknowledged
    assert bench.ack("01 01 01") == "5C 01 01 01"
    assert bench.fetch() == "04 01 02 19"
    assert bench.ack("01 20 10") == "5C 01 20 10"
    assert bench.fetch() == "04 21 01 20"
    for ack in ("02 01 19", "01 02 08", "01 21 20"):
        assert bench.ack(ack) == f"5C {ack}"
    assert [alarm.end for alarm in raised] == [AlarmEnd.ACKNOWLEDGED] * 5


@pytest.mark.parametrize(
    ("sequence", "mode", "limit"),
    [(0, 7, 0), (4, 0, 0), (2, 1, 2), (32, 2, 4), (5, 3, 5), (32, 7, 32), (24, 7, 24), (32, 4, 12), (32, 5, 16)],
)
def test_the_lesser_limit_of_both_ends_counts(sequence: int, mode: int, limit: int) -> None:
    bench = AlarmBench(sequence=sequence).start(prm(mode=mode))
    assert bench.alarms.limit == limit
    for _ in range(32):
        bench.raise_("02 01 00")
    shown = 0
    while bench.must_fetch:
        assert bench.ext() == f"04 02 01 {shown << 3:02X}"
        shown += 1
    assert shown == (limit or 1)


def test_sequence_mode_keeps_the_order_and_numbers_that_are_used_are_left_out() -> None:
    bench = AlarmBench(sequence=2).start(prm(mode=7))
    first = bench.raise_("01 01 01")
    assert bench.fetch() == "04 01 01 01"
    for number in [*range(1, 32), *range(1, 32)]:  # number 0 is on its way all the time
        bench.raise_("02 01 00")
        assert bench.fetch() == f"04 02 01 {number << 3:02X}"
        bench.raise_("06 01 00")
        assert not bench.must_fetch  # two are on their way
        bench.alarms.withdraw(bench.alarms.pending[-1])
        assert bench.ack(f"01 02 {number << 3:02X}") == f"5C 01 02 {number << 3:02X}"
    assert bench.ack("01 01 01") == "5C 01 01 01"
    assert first.end is AlarmEnd.ACKNOWLEDGED


@pytest.mark.parametrize("ack", ["02 01 01", "01 02 01", "01 01 09"])
def test_an_acknowledgement_of_something_else_is_refused(bench: AlarmBench, ack: str) -> None:
    alarm = bench.raise_("01 01 01")
    bench.fetch()
    assert bench.ack(ack) == "DC 80 B8 00"
    slot, kind, specifier = bytes.fromhex(ack)
    assert bench.texts() == [
        f"slave 8 (recorder): Alarm_Ack of master 2 refused: no alarm of type {kind}, slot {slot}, "
        f"sequence number {specifier >> 3} is on its way"
    ]
    assert alarm.end is None
    assert bench.ack("01 01 01") == "5C 01 01 01"
    assert bench.app.state is SlaveAppState.DATA_EXCH


@pytest.mark.parametrize("octets", ["", "01", "01 01 01 00"])
def test_an_acknowledgement_of_the_wrong_length(octets: str) -> None:
    bench = AlarmBench(extra_sap=True).start()
    assert bench.ack(octets) == "DC 80 B8 00"
    assert bench.ack(octets, 50) == "DC 80 B8 00"


def test_an_alarm_is_not_acknowledged_before_it_was_shown(bench: AlarmBench) -> None:
    alarm = bench.raise_("01 01 01")
    assert bench.ack("01 01 01") == "DC 80 B8 00"
    assert bench.ext(OTHER) == "04 01 01 01"
    assert bench.ack("01 01 01") == "DC 80 B8 00"  # another master read it
    assert alarm.end is None


def test_repeated_acknowledgements_are_answered_and_do_nothing(bench: AlarmBench) -> None:
    first = bench.raise_("01 01 01")
    second = bench.raise_("01 01 01")
    bench.fetch()
    for _ in range(3):  # its answer was lost
        assert bench.ack("01 01 01") == "5C 01 01 01"
    assert (first.end, second.end) == (AlarmEnd.ACKNOWLEDGED, None)
    assert bench.fetch() == "04 01 01 09"  # the same again, with a number of its own
    assert bench.ack("01 01 01") == "5C 01 01 01"
    assert bench.alarms.pending == (second,)
    assert bench.ack("01 01 09") == "5C 01 01 09"
    assert second.end is AlarmEnd.ACKNOWLEDGED
    what = "slave 8 (recorder): diagnosis alarm, slot 1, appears, slot disturbed"
    assert bench.texts() == [f"{what}: acknowledged by master 2"] * 2


def test_an_answer_to_a_poll_that_was_lost_is_given_again() -> None:
    bench = AlarmBench(extra_sap=True).start()
    bench.raise_("01 01 01")
    bench.fetch()
    for sap in (51, 50):
        assert bench.poll(sap) == ""
        bench.ack("01 01 01", sap)
        assert bench.poll(sap) == "5C 01 01 01"


def test_a_diagnosis_that_was_lost_is_fetched_again(bench: AlarmBench) -> None:
    bench.raise_("02 01 00 77")
    bench.raise_("06 01 00")
    assert bench.fetch() == "05 02 01 00 77"
    reply = bench.ask(60, fresh=True)  # not answered: the master takes the station up afresh
    assert reply.data[6:].hex(" ") == "05 02 01 00 77"
    assert bench.fetch() == "04 06 01 08"


def test_an_alarm_that_was_read_but_never_confirmed_is_acknowledged(bench: AlarmBench) -> None:
    alarm = bench.raise_("02 01 00")
    bench.fetch()
    bench.ask(51, bytes.fromhex("5C 01 02 00"), fresh=True)
    assert alarm.end is AlarmEnd.ACKNOWLEDGED


def test_class_2_reading_the_diagnosis_takes_nothing_away(bench: AlarmBench) -> None:
    bench.raise_("02 01 00")
    bench.alarms.status(Status(1, 3, 1))
    for _ in range(2):
        assert bench.ext(OTHER) == "04 02 01 00 04 81 03 01"
    assert bench.fetch() == "04 02 01 00 04 81 03 01"
    assert not bench.must_fetch
    assert bench.ext(OTHER) == "04 02 01 00"


def test_only_alarms_that_the_device_has_and_the_master_enabled() -> None:
    bench = AlarmBench().start(prm(0x40))
    bench.raise_("02 01 00")
    for text in ("01 01 01", "03 01 00", "04 01 00", "05 01 00", "06 01 00", "20 01 00"):
        assert refusal(bench, text) == "not enabled"
    bench.alarms.support = AlarmSupport(frozenset(("update",)))
    assert refusal(bench, "02 01 00") == "not supported"


@pytest.mark.parametrize("octets", [PRM, PRM + b"\x80", PRM + b"\0\xfc\0"])
def test_without_dpv1_enable_there_are_no_alarms(octets: bytes) -> None:
    bench = AlarmBench(extra_sap=True).start(octets)
    enabled = len(octets) == len(PRM) + 1  # DPV1_Enable alone: open, and none enabled
    assert refusal(bench, "02 01 00") == ("not enabled" if enabled else "not in data exchange")
    for sap in (51, 50):
        assert (bench.ask(sap) == RS_REPLY) is not enabled


def test_the_extra_sap_is_open_where_the_device_has_it() -> None:
    without, bench = AlarmBench().start(), AlarmBench(extra_sap=True).start()
    assert without.ask(50, bytes.fromhex("5C 01 02 00")) == RS_REPLY
    assert bench.ask(50, b"", OTHER) == RS_REPLY
    bench.raise_("02 01 00")
    bench.fetch()
    assert bench.ack("01 02 00", 50) == "5C 01 02 00"
    assert bench.poll(51) == ""
    assert bench.ask(50, bytes.fromhex("5E 00 00 F0")).data == b""
    assert bench.poll(50) == "DE 80 A9 00"
    bench.ask(51, bytes.fromhex("5E 00 00 F0"))
    assert bench.poll() == "DE 80 B0 00"  # alarms, and no records


def _break(bench: AlarmBench) -> None:
    bench.recorder.broken = "exchange"
    bench.dx()


WAYS_OUT: dict[str, Callable[[AlarmBench], object]] = {
    "unlock": lambda bench: bench.prm(UNLOCK),
    "parameters": lambda bench: bench.prm(prm()),
    "configuration": lambda bench: bench.cfg(b"\x20"),
    "watchdog": lambda bench: bench.pass_time(200_000_000),
    "length": lambda bench: bench.dx(b"\1\2\3"),
    "restart": lambda bench: bench.app.restart(bench.now),
    "failure": _break,
}


@pytest.mark.parametrize("way", WAYS_OUT)
def test_leaving_data_exchange_ends_alarms(way: str) -> None:
    bench = AlarmBench(extra_sap=True).start()
    raised = [bench.raise_(text) for text in ("01 01 01", "02 01 00", "01 01 02")]
    ends: list[AlarmEnd | None] = []
    for alarm in raised:
        alarm.ended = lambda alarm=alarm: ends.append(alarm.end)
    bench.alarms.status(Status(1, 1))
    bench.fetch()
    WAYS_OUT[way](bench)
    assert ends == [AlarmEnd.LEFT] * 3
    assert bench.alarms.pending == ()
    assert bench.ext() == ""
    assert refusal(bench, "01 01 01") == "not in data exchange"
    with pytest.raises(AlarmError, match="not in data exchange"):
        bench.alarms.status(Status(1, 1))
    if way != "failure":
        bench.prm_and_cfg(prm())
        assert bench.ext() == ""
        assert bench.poll(50) == ""
        bench.raise_("02 01 00")
        assert bench.ext() == ""  # none before the first Data_Exchange
        assert bench.fetch() == "04 02 01 00"


def test_the_same_configuration_again_changes_nothing(bench: AlarmBench) -> None:
    alarm = bench.raise_("02 01 00")
    bench.cfg(CFG)
    assert bench.fetch() == "04 02 01 00"
    assert alarm.end is None


def test_at_most_32_wait(bench: AlarmBench) -> None:
    for _ in range(MAX_WAITING + 1):  # one is shown
        bench.raise_("02 01 00")
    assert refusal(bench, "02 01 00") == "queue full"
    for _ in range(MAX_WAITING):
        bench.alarms.status(Status(1, 1))
    with pytest.raises(AlarmError, match="32 wait already"):
        bench.alarms.status(Status(1, 1))


def test_an_alarm_is_withdrawn_until_the_master_has_it(bench: AlarmBench) -> None:
    shown, second, third = (bench.raise_("02 01 00") for _ in range(3))
    bench.fetch()
    bench.alarms.withdraw(second)
    bench.alarms.withdraw(shown)  # the master has it already
    assert (shown.end, second.end, third.end) == (None, AlarmEnd.WITHDRAWN, None)
    bench.ack("01 02 00")
    bench.alarms.withdraw(third)  # chosen, but in no answer yet
    assert third.end is AlarmEnd.WITHDRAWN
    assert not bench.must_fetch


# --- status messages ----------------------------------------------------------------------------------------------


def test_status_messages_are_shown_once_each(bench: AlarmBench) -> None:
    bench.alarms.status(Status(1, 3, 1, b"\x55"))
    states = (ModuleState.OK, ModuleState.INVALID, ModuleState.WRONG, ModuleState.MISSING, ModuleState.INVALID)
    bench.alarms.status(module_status(states))
    bench.alarms.status(Status(30, 0, 0, bytes.fromhex("01 02")))
    bench.alarms.status(Status(126, 254))
    for block in ("05 81 03 01 55", "06 82 00 00 E4 01", "06 9E 00 00 01 02", "04 FE FE 00"):
        assert bench.fetch() == block
    assert not bench.must_fetch
    assert bench.ext() == ""


def test_between_two_that_are_the_same_there_is_a_diagnosis_without(bench: AlarmBench) -> None:
    for status in (Status(1, 3), Status(1, 3), Status(1, 4), Status(1, 3)):
        bench.alarms.status(status)
    for block in ("04 81 03 00", "", "04 81 03 00", "04 81 04 00", "04 81 03 00"):
        assert bench.fetch() == block
    assert not bench.must_fetch


@pytest.mark.parametrize("kind", [0, 4, 29, 127])
def test_a_status_that_does_not_exist(kind: int) -> None:
    with pytest.raises(PduError):
        AlarmBench().start().alarms.status(Status(kind, 0))


def test_blocks_stand_in_order_and_the_devices_own_are_cut() -> None:
    bench = AlarmBench(room=13).start()
    channels = [channel_block(2, channel, 6) for channel in range(3)]
    bench.recorder.ext = UserDiag.of(*channels).ext
    assert bench.fetch() == "82 00 06 82 01 06 82 02 06"
    bench.raise_("01 02 01")
    bench.alarms.status(Status(1, 2))
    assert bench.must_fetch
    octets = bench.diag()
    assert octets[6:].hex(" ").upper() == "04 01 02 01 04 81 02 00 82 00 06"
    assert octets[0] == 0x08
    assert octets[2] == 0x80  # Ext_Diag_Overflow
    bench.ack("02 01 01")
    assert bench.ext() == "82 00 06 82 01 06 82 02 06"


def test_a_status_that_has_no_room_beside_the_alarm_comes_after_it() -> None:
    bench = AlarmBench(room=10).start()
    bench.raise_("01 02 01 AA BB CC")
    bench.alarms.status(Status(1, 2))
    assert bench.fetch() == "07 01 02 01 AA BB CC"
    assert bench.fetch() == "04 81 02 00"
    assert not bench.must_fetch
    assert bench.ext() == "07 01 02 01 AA BB CC"
    with pytest.raises(UsageError, match="room for 10"):
        bench.raise_("01 02 01 00 00 00 00 00 00 00")


# --- misuse -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("alarm", [Alarm(0, 1), Alarm(7, 1), Alarm(127, 1), Alarm(1, 255), Alarm(1, 1, 4)])
def test_impossible_alarms(alarm: Alarm) -> None:
    with pytest.raises(PduError):
        AlarmBench().start().alarms.alarm(alarm)


def test_too_much_data() -> None:
    with pytest.raises(PduError, match="60 octets"):
        AlarmBench().start().alarms.alarm(Alarm(1, 1, data=bytes(60)))


@pytest.mark.parametrize("sequence", [-1, 1, 33])
def test_impossible_alarm_support(sequence: int) -> None:
    with pytest.raises(ConfigError, match="alarms at a time"):
        AlarmSupport(sequence=sequence)
    with pytest.raises(ConfigError, match="no 'fire' alarm"):
        AlarmSupport(frozenset(("fire",)))


def test_kinds_of_alarm_types() -> None:
    assert [kind_of(number) for number in (1, 2, 3, 4, 5, 6, 32, 126)] == [
        "diagnostic",
        "process",
        "pull_plug",
        "pull_plug",
        "status",
        "update",
        "manufacturer",
        "manufacturer",
    ]


def test_no_alarm_before_data_exchange() -> None:
    server = AlarmServer(AlarmSupport(frozenset(("process",))), 63)
    with pytest.raises(AlarmError, match="not in data exchange"):
        server.alarm(Alarm(2, 1))


# --- The limits of a slave's alarms: those agreed in Set_Prm, those that wait, and the sequence numbers -------------


KINDS = frozenset({"diagnostic", "process"})


def server(sequence: int, status_3: int, *, room: int = 60) -> AlarmServer:
    made = AlarmServer(AlarmSupport(KINDS, sequence), room, "x")
    made.agree(0xFF, status_3)
    made.open()
    return made


@pytest.mark.parametrize("sequence", [0, 2, 5, 32])
def test_the_alarms_at_a_time_are_the_fewer_of_master_and_slave(sequence: int) -> None:
    """EN 50170: 0 is type mode, then 2, 4, 8, 12, 16, 24, 32 in sequence."""
    asked = [0, 2, 4, 8, 12, 16, 24, 32]
    found = [server(sequence, 0xF8 | code).limit for code in range(8)]
    assert found == [min(limit, sequence) for limit in asked]
    assert AlarmServer(AlarmSupport(KINDS, sequence), 60).limit == 0


@pytest.mark.parametrize(("code", "limit"), [(1, 2), (2, 4)])
def test_so_many_alarms_are_on_their_way_and_no_more(code: int, limit: int) -> None:
    alarms = server(32, code)
    for slot in range(limit + 3):
        alarms.alarm(Alarm(type=2, slot=slot, specifier=0))
        alarms._fetched = True
        alarms._advance()
    assert [raised.alarm.slot for raised in alarms.pending] == list(range(limit + 3))
    assert len(alarms._on_its_way) == limit
    assert [raised.alarm.sequence for raised in alarms._on_its_way.values()] == list(range(limit))


def test_so_many_wait() -> None:
    alarms = server(0, 0)
    for slot in range(MAX_WAITING + 1):  # one is on its way
        alarms.alarm(Alarm(type=2, slot=slot % 255, specifier=0))
    with pytest.raises(AlarmError) as refused:
        alarms.alarm(Alarm(type=2, slot=1, specifier=0))
    assert refused.value.reason == "queue full"
    assert f"{MAX_WAITING} alarms wait already; its master does not acknowledge them" in str(refused.value)
    for _ in range(MAX_WAITING):
        alarms.status(Status(type=1, slot=1, specifier=0))
    with pytest.raises(AlarmError) as refused:
        alarms.status(Status(type=1, slot=1, specifier=0))
    assert refused.value.reason == "queue full"
    assert f"{MAX_WAITING} wait already; its master does not fetch them" in str(refused.value)


@pytest.mark.parametrize(("room", "fits"), [(4, True), (3, False)])
def test_the_room_in_the_diagnosis(room: int, fits: bool) -> None:
    alarms = server(0, 0, room=room)
    if fits:
        alarms.alarm(Alarm(type=2, slot=1, specifier=0))
        return
    with pytest.raises(UsageError) as refused:
        alarms.alarm(Alarm(type=2, slot=1, specifier=0))
    assert str(refused.value) == (
        "slave x: a block of 4 octets, its diagnosis has room for 3 (Max_Diag_Data_Len); give fewer octets of data"
    )
