"""A slave of DP-V1 under requests in octets: each answer, and each report with its full text and its time."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from slave_alarm_kit import KINDS, AlarmBench, prm
from slave_kit import PRM_NO_WD, Bench, Recorder

from dpstack.dp.pdu.alarm_blocks import Alarm, Status
from dpstack.dpv1.slave.alarms import AlarmEnd, AlarmServer, AlarmSupport
from dpstack.dpv1.slave.record_requests import RecordRequest
from dpstack.dpv1.slave.resource_manager import ms2_of
from dpstack.errors import AlarmError, PduError, UsageError
from dpstack.fdl.interface import RS_REPLY, SC_REPLY

INITIATE = "57 00 00 00 00 64 01 00 00 00 00 00 00 02 00 02 00 00 00 00"
NO_SERVICE = "57 00 00 00 00 64 01 00 00 00 00 00 00 02 00 02 00 00 00"
FAR = "57 00 00 00 00 64 01 00 00 00 00 00 00 02 01 08 00 00 01 02 00 00 00 00 00 00"
OPENED = "570401000000000000020002 00000000".replace(" ", "")


class _Records:
    """Three octets each; number 9 fails, number 8 is never answered."""

    def ask(self, request: RecordRequest) -> None:
        if request.service.index == 9:
            raise ZeroDivisionError("no record")
        if request.service.index != 8:
            request.answer(b"\1\2\3")


@pytest.fixture
def made() -> Bench:
    """In data exchange with master 2, with every alarm and two connections of 4 octets."""
    device = Recorder()
    device.records = _Records()
    device.ms2, device.ms2_max_len = 2, 4
    device.alarm_server = AlarmServer(AlarmSupport(KINDS, 0, extra_sap=True), 60, "recorder")
    made = Bench(device)
    made.prm_and_cfg(PRM_NO_WD + b"\x80\xfc\0")
    made.dx()
    made.app.take_events()
    return made


def ask(made: Bench, sap: int, octets: str, sa: int) -> tuple[str, list[str]]:
    """The answer ("SC", "RS" or octets), and what the slave reports at this moment."""
    made.now += 7
    reply = made.ask(sap, bytes.fromhex(octets), sa)
    events = made.app.take_events()
    assert [event.t_ns for event in events] == [made.now] * len(events)
    answer = {SC_REPLY: "SC", RS_REPLY: "RS"}.get(reply) or reply.data.hex()
    return answer, [event.text.removeprefix("slave 8 (recorder): ") for event in events]


FAILED = "refused: its function failed (ZeroDivisionError: no record), in ask(), test_v1_slave_reports.py line "


@pytest.mark.parametrize(
    ("sap", "request_", "answer", "report"),
    [
        (51, "5E0102F0", "5e010203010203", ""),
        (51, "5E0109F0", "de80a000", f"Read of slot 1, index 9 of master 2 {FAILED}"),
        (51, "5F01090101", "df80a100", f"Write of slot 1, index 9 of master 2 {FAILED}"),
        (51, "5E01", "de80b800", "MS1 of master 2 refused: DP-V1 service ends after 2 octets: octet 3 (record) is "
                                 "missing"),
        (51, "5EFF02F0", "de80b200", "MS1 of master 2 refused: octet 2: there is no slot 255"),
        (51, "5E0102F1", "de80b100", "MS1 of master 2 refused: octet 4: 241 octets of data, 240 are possible"),
        (51, "5E0102F000", "de80b800", "MS1 of master 2 refused: 1 octet too many: octet 4 is the last one of a Read "
                                       "request"),
        (51, "5F01020201", "df80b100", "MS1 of master 2 refused: octet 4 says 2 octets of data, 1 came"),
        (51, "4801", "c880a900", "MS1 of master 2 refused: octet 1: Idle is no service here"),
        (51, "51010200", "d180a900", "MS1 of master 2 refused: octet 1: Data_Transport is no service here"),
        (51, "4A01", "ca80a900", "MS1 of master 2 refused: octet 1: no service 0x4A"),
        (51, "5C01", "dc80b800", "Alarm_Ack of master 2 refused: Alarm_Ack ends after 2 octets: octet 3 (kind) is "
                                 "missing"),
        (51, "5C01020304", "dc80b800", "Alarm_Ack of master 2 refused: Alarm_Ack has 5 octets, octet 4 is the last "
                                       "one"),
        (51, "5C010208", "dc80b800", "Alarm_Ack of master 2 refused: no alarm of type 2, slot 1, sequence number 1 is "
                                     "on its way"),
        (50, "5C010208", "dc80b800", "Alarm_Ack of master 2 refused: no alarm of type 2, slot 1, sequence number 1 is "
                                     "on its way"),
        (50, "5E01", "de80a900", "Alarm_Ack of master 2 refused: octet 1: no service 0x5E at SAP 50"),
    ],
)  # fmt: skip
def test_ms1(made: Bench, sap: int, request_: str, answer: str, report: str) -> None:
    for time in range(2):
        told = [*ask(made, sap, request_, 2)[1]]
        found, more = ask(made, sap, "", 2)
        told += more
        assert found == answer
        if report.endswith(" line "):
            told = [text.rstrip("0123456789") for text in told]
        assert told == ([report] if report and not time else [])  # each once
    assert made.app.stats.refused == 2 * bool(report)


SERVICE = "class 2 connection of master 1 (server SAP 48) is over after"


@pytest.mark.parametrize(
    ("request_", "answer", "report"),
    [
        ("5E0102F0", "5e010203010203", ""),
        ("5E010202", "5e0102020102", ""),
        ("5F01020401020304", "5f010204", ""),
        ("4801", "4801", ""),
        ("5E0109F0", "de80a000", f"Read of slot 1, index 9 of master 1 {FAILED}"),
        ("5F01020501", "df80b100", "MS2 of master 1 refused: octet 4 says 5 octets of data, 1 came"),
        ("5F0102050102030405", "df80b100", "MS2 of master 1 refused: 5 octets of data, 4 are possible"),
        ("51010201", "d180b800", "MS2 of master 1 refused: Data_Transport: octet 4 says 1 octet of data, 0 came"),
        ("51FF020101", "d180b200", "MS2 of master 1 refused: octet 2: there is no slot 255"),
        ("5101020501 02030405", "d180b100", "MS2 of master 1 refused: 5 octets of data, 4 are possible"),
        ("5101020101", "d180a900", ""),  # it has no Data_Transport
        ("4A", "580012", f"{SERVICE} 0 services: octet 1: no service 0x4A"),
        ("57", "580011", f"{SERVICE} 0 services: Initiate came in the state 'open'"),
        ("56300000", "580011", f"{SERVICE} 0 services: Resource_Manager came in the state 'open'"),
        ("5C010203", "580011", f"{SERVICE} 0 services: Alarm_Ack came in the state 'open'"),
        ("58", "RS", f"{SERVICE} 0 services: its master aborted it: an Abort that cannot be read: "
                     "Abort ends after 1 octet: octet 2 (subnet) is missing"),
        ("580013", "RS", f"{SERVICE} 0 services: its master aborted it: nothing was heard from the other end in time "
                         "(ABT_TO)"),
        ("580225", "RS", f"{SERVICE} 0 services: its master aborted it: its user, reason 5 in a remote subnet"),
    ],
)  # fmt: skip
def test_a_connection(made: Bench, request_: str, answer: str, report: str) -> None:
    opened = "class 2 connection of master 1 opened (server SAP 48, send time-out 1000 ms)"
    assert ask(made, 49, INITIATE, 1) == ("SC", [opened])
    assert [ask(made, sap, "", 1) for sap in (49, 48)] == [("56300064", []), (OPENED, [])]
    _, told = ask(made, 48, request_, 1)
    found, more = ask(made, 48, "", 1)
    assert found == answer
    found_reports = [text.rstrip("0123456789") if report.endswith(" line ") else text for text in told + more]
    assert found_reports == ([report] if report else [])
    ended = report.startswith(SERVICE)
    assert made.app.stats.closed == ended
    assert bool(ms2_of(made.app).connections) is not ended


def test_a_second_service_while_one_is_worked_at(made: Bench) -> None:
    for sap, octets in ((49, INITIATE), (49, ""), (48, ""), (48, "5E0108F0")):
        ask(made, sap, octets, 1)
    assert ask(made, 48, "5E0102F0", 1) == ("SC", [f"{SERVICE} 1 services: Read came in the state 'working'"])
    assert [ask(made, 48, octets, 1)[0] for octets in ("5E0102F0", "4801", "")] == ["SC", "SC", "580011"]
    assert ask(made, 48, "", 1) == ("RS", [])


@pytest.mark.parametrize(
    ("initiate", "answer", "reason"),
    [
        (NO_SERVICE, "580012", "Initiate: 2 and 2 octets of addresses are announced, 3 came"),
        ("57", "580012", "Initiate ends after 1 octet: octet 2 (reserved) is missing"),
        (FAR, "580017", "D_Addr is an address in another network, and this slave is the end of the way"),
    ],
)
def test_initiates_that_are_refused(made: Bench, initiate: str, answer: str, reason: str) -> None:
    assert ask(made, 49, initiate, 1) == ("SC", [f"Initiate of master 1 refused: {reason}"])
    assert [ask(made, sap, "", 1)[0] for sap in (49, 48, 48)] == ["56300064", answer, "RS"]
    assert (made.app.stats.connections, made.app.stats.closed) == (0, 0)


def test_connections_that_end_without_their_master(made: Bench) -> None:
    for sap, octets in ((49, INITIATE), (49, ""), (48, "")):
        ask(made, sap, octets, 1)
    ms2 = ms2_of(made.app)
    since = made.now
    for _ in range(2):  # the deadline is moved only when the one before has come
        assert made.app.take_events() == []
        made.now = ms2.at
        made.app.tick(made.now)
    (closed,) = made.app.take_events()
    assert (made.now - since, closed.t_ns) == (2_000_000_000, made.now)
    assert closed.text == f"slave 8 (recorder): {SERVICE} 0 services: nothing was heard of its master for 2000 ms"
    assert [ask(made, 48, "", 1)[0] for _ in range(2)] == ["580013", "RS"]
    for sap, octets in ((49, INITIATE), (49, ""), (47, "")):
        ask(made, sap, octets, 1)
    ms2.end("the slave was switched off", made.now)
    (closed,) = made.app.take_events()
    assert closed.text.endswith("(server SAP 47) is over after 0 services: the slave was switched off")
    assert (ms2.connections, ms2.free) == ((), 2)
    for sap, reason, text in (
        (47, 0, "there is no open class 2 connection at server SAP 47; see connections"),
        (46, 3, "there is no open class 2 connection at server SAP 46; see connections"),
    ):
        with pytest.raises(UsageError) as refused:
            ms2.abort(sap, reason, made.now)
        assert str(refused.value) == text


def test_an_initiate_that_takes_the_place_of_another(made: Bench) -> None:
    device = made.device
    assert isinstance(device, Recorder)
    before = f"{SERVICE} 0 services: another Initiate of its master came before the answer was fetched"
    for sap in (48, 47):
        assert ask(made, 49, INITIATE, 1)[1] == [
            f"class 2 connection of master 1 opened (server SAP {sap}, send time-out 1000 ms)"
        ]
    assert ask(made, 49, INITIATE, 1)[1] == [
        before, "class 2 connection of master 1 opened (server SAP 48, send time-out 1000 ms)",
    ]  # fmt: skip
    assert [ask(made, 49, "", 1)[0] for _ in range(3)] == ["562f0064", "56300064", "56300064"]
    assert ask(made, 49, INITIATE, 1) == ("RS", [])


# --- alarms ---------------------------------------------------------------------------------------------------------

PROCESS = "slave x: process alarm, slot 1"


def _server(status_2: int = 0xFF, *, opened: bool = True, room: int = 60) -> AlarmServer:
    made = AlarmServer(AlarmSupport(frozenset({"process", "update"})), room, "x")
    made.agree(status_2, 0)
    if opened:
        made.open()
    return made


def _full(made: AlarmServer) -> AlarmServer:
    for _ in range(33):
        made.alarm(Alarm(2, 1))
    for _ in range(32):
        made.status(Status(1, 1))
    return made


@pytest.mark.parametrize(
    ("server", "message", "text", "reason"),
    [
        (_server, Alarm(1, 1), "slave x: diagnosis alarm, slot 1: this slave has no diagnostic alarms; name them in "
                               "its description", "not supported"),
        (lambda: _server(opened=False), Alarm(2, 1), f"{PROCESS}: it is not in data exchange with a master that set "
                                                     "DPV1_Enable", "not in data exchange"),
        (lambda: _server(0), Alarm(2, 1), f"{PROCESS}: its master did not enable process alarms in Set_Prm; "
                                          'add "process" to alarms of [slave.dpv1] there', "not enabled"),
        (lambda: _server(0), Alarm(6, 1), "slave x: update alarm, slot 1: its master did not enable update alarms in "
                                          'Set_Prm; add "update" to alarms of [slave.dpv1] there', "not enabled"),
        (lambda: _full(_server()), Alarm(2, 1), f"{PROCESS}: 32 alarms wait already; its master does not acknowledge "
                                                "them", "queue full"),
        (lambda: _full(_server()), Status(1, 1), "slave x: status message, slot 1: 32 wait already; its master does "
                                                 "not fetch them", "queue full"),
        (lambda: _server(opened=False), Status(1, 1), "slave x: status message, slot 1: it is not in data exchange "
                                                      "with a master that set DPV1_Enable", "not in data exchange"),
    ],
)  # fmt: skip
def test_messages_that_cannot_go_out(
    server: Callable[[], AlarmServer], message: Alarm | Status, text: str, reason: str
) -> None:
    made = server()
    with pytest.raises(AlarmError) as refused:
        made.alarm(message) if isinstance(message, Alarm) else made.status(message)
    assert (str(refused.value), refused.value.reason) == (text, reason)


@pytest.mark.parametrize("kind", [0, 4, 29, 127])
def test_a_status_without_a_meaning(kind: int) -> None:
    with pytest.raises(PduError) as refused:
        _server().status(Status(kind, 1))
    assert str(refused.value) == f"there is no status of type {kind}: 1..3, 30, 31, 32..126"


def test_status_types() -> None:
    made = _server()
    for kind in (1, 2, 3, 30, 31, 32, 126):
        made.status(Status(kind, 1))


@pytest.mark.parametrize("octets", [4, 5])
def test_a_status_and_the_room_of_the_diagnosis(octets: int) -> None:
    made = _server(room=octets)
    made.status(Status(1, 1))
    if octets == 5:
        made.status(Status(1, 1, data=b"\1"))
        return
    with pytest.raises(UsageError) as refused:
        made.status(Status(1, 1, data=b"\1"))
    assert str(refused.value) == (
        "slave x: a block of 5 octets, its diagnosis has room for 4 (Max_Diag_Data_Len); give fewer octets of data"
    )


def test_an_alarm_and_a_status_that_just_fit_and_do_not() -> None:
    for room, blocks in ((8, ["04020100 04810100", ""]), (7, ["04020100", "04810100"])):
        made = AlarmBench(room=room).start(prm())
        made.raise_("02 01 00")
        made.alarms.status(Status(1, 1))
        assert made.fetch().replace(" ", "") == blocks[0].replace(" ", "")
        assert made.must_fetch is bool(blocks[1])
        if blocks[1]:
            assert made.ext().replace(" ", "") == blocks[1]


def test_ends_and_defaults() -> None:
    assert [end.value for end in AlarmEnd] == [
        "acknowledged",
        "data exchange ended before it was acknowledged",
        "withdrawn before it was shown",
    ]
    assert AlarmSupport() == AlarmSupport(frozenset(), 0, extra_sap=False)
    made = AlarmBench().start()
    raised = made.raise_("02 01 00")
    ended: list[AlarmEnd | None] = []
    raised.ended = lambda: ended.append(raised.end)
    assert (raised.end, raised.offered) == (None, False)
    made.fetch()
    assert raised.offered
    made.now = 77
    made.ack("01 02 00")
    (event,) = made.app.take_events()
    assert (event.t_ns, ended) == (77, [AlarmEnd.ACKNOWLEDGED])
    assert event.text == "slave 8 (recorder): process alarm, slot 1: acknowledged by master 2"
