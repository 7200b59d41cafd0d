"""The requests of each class 2 service one by one, against a slave that is a list of octets: SAP, pause, patience."""

from __future__ import annotations

from collections.abc import Iterable

import pytest
from support import present

from dpstack.dp.acyclic.class2 import (
    AddressChange,
    ChangeAddress,
    Class2,
    Class2Reading,
    ReadService,
    Service,
    answers_slave_diag,
    service_unanswered,
)
from dpstack.dp.acyclic.job import Outcome, RequestEnd, ServiceFailure, Step, Steps, T, pause_after_silence
from dpstack.errors import UsageError
from dpstack.fdl.interface import Failure
from dpstack.fdl.telegram import SHORT_ACK, Kind, Telegram
from dpstack.trace import Notice

NONE, GARBLED, WRONG, GUARD = Failure.NO_ANSWER, Failure.GARBLED, Failure.WRONG, Failure.REFUSED
#: as delivered, ident 1234; the same one locked by master 7, with its watchdog on and off
FREE = bytes.fromhex("02 05 00 FF 12 34")
LOCKED = bytes.fromhex("00 0C 00 07 12 34")
LOCKED_OFF = bytes.fromhex("00 04 00 07 12 34")
OTHER = bytes.fromhex("02 05 00 FF 43 21")


def says(octets: bytes, fc: int = 8) -> Telegram:
    return Telegram(Kind.SD2, 2, 4, fc, 62, 60, octets)


def status(fc: int) -> Telegram:
    """An answer without data: 0 OK, 1 UE, 2 RR, 3 RS, 9 NR; in answer to FDL status 0x20 is a master, 0x30 in the
    ring."""
    return Telegram(Kind.SD1, 2, 4, fc)


def shown(step: Step) -> str:
    """A step as ``pause in ms: function address/SAP<SSAP data flags``."""
    request, pause = step.request, step.pause_ns
    where = f"{request.da}" if request.dsap is None else f"{request.da}/{request.dsap}<{request.ssap}"
    flags = f"{'p' * request.patient}{'1' * (not request.retry)}"
    more = f" +{request.extra_ns // 1_000_000}" if request.extra_ns else ""
    data = f" {request.data.hex()}" if request.data else ""
    return f"{pause / 1_000_000:g}: {request.function:02X} {where}{data} {flags}".rstrip() + more


def run(steps: Steps[T], answers: Iterable[object]) -> tuple[list[str], T | None]:
    """The steps that the job takes with these answers, and its result; None where the answers were used up."""
    made: list[str] = []
    following = iter(answers)
    try:
        step = next(steps)
        while True:
            made.append(shown(step))
            answer = next(following, None)
            if not isinstance(answer, Telegram | Failure):
                return made, None
            step = steps.send(RequestEnd(answer, 0, 0))
    except StopIteration as end:
        result: T = end.value
        return made, result


def failed(outcome: Outcome | None) -> tuple[ServiceFailure | None, str]:
    assert outcome is not None
    return outcome.failure, outcome.status


def change(**more: object) -> AddressChange:
    return AddressChange(2, ChangeAddress(**({"token": 1, "old": 4, "new": 9} | more)))  # type: ignore[arg-type]


DIAG_4, DIAG_9 = "0: 0D 4/60<62", "100: 0D 9/60<62"
OLD = ["0: 09 4 1", "0: 09 4 p1"]
NEW = ["0: 09 9 1", "0: 09 9 p1"]
SET = "0: 0D 4/55<62 09123400"
#: four attempts; the last one waits up to a second longer
DIAG_FOUR = [DIAG_4, "10: 0D 4/60<62", "20: 0D 4/60<62", "40: 0D 4/60<62 +1000"]


def test_the_pause_after_silence_doubles_up_to_160_ms() -> None:
    assert [pause_after_silence(n) // 1_000_000 for n in range(1, 8)] == [10, 20, 40, 80, 160, 160, 160]


@pytest.mark.parametrize(
    ("service", "sap"), [(Service.INPUTS, 56), (Service.OUTPUTS, 57), (Service.CONFIG, 59), (Service.DIAGNOSIS, 60)]
)
def test_a_reading_service_that_nobody_answers(service: Service, sap: int) -> None:
    """Four attempts; then two of Slave_Diag show whether the slave is there at all."""
    four = [line.replace("/60", f"/{sap}") for line in DIAG_FOUR]
    made, outcome = run(Class2Reading(ReadService(1, 4, service)).steps(), [NONE] * 6)
    assert made == four + ([] if sap == 60 else [DIAG_4, "10: 0D 4/60<62 +1000"])
    assert failed(outcome) == (ServiceFailure.SILENT, "")
    if sap == 60:
        return
    for diagnosis in (says(FREE), status(3)):
        made, outcome = run(Class2Reading(ReadService(1, 4, service)).steps(), [*[NONE] * 4, diagnosis])
        assert made == [*four, DIAG_4]
        assert failed(outcome) == (ServiceFailure.REFUSED, "no answer")


@pytest.mark.parametrize("later", [NONE, GARBLED, WRONG, status(1), status(2)])
def test_silence_and_busy_are_asked_again(later: Telegram | Failure) -> None:
    made, outcome = run(Class2Reading(ReadService(1, 4, Service.DIAGNOSIS)).steps(), [later, later, says(FREE)])
    assert made == DIAG_FOUR[:3]
    assert outcome == Outcome(data=FREE)


@pytest.mark.parametrize("answer", [GUARD, SHORT_ACK, status(0), status(3), status(9), says(FREE), says(FREE, 10)])
def test_every_other_end_is_the_answer(answer: Telegram | Failure) -> None:
    made, outcome = run(Class2Reading(ReadService(1, 4, Service.DIAGNOSIS)).steps(), [answer])
    assert made == [DIAG_4]
    assert outcome is not None


def test_slave_diag_is_not_asked_to_see_whether_slave_diag_is_answered() -> None:
    assert run(answers_slave_diag(4, 60), []) == ([], False)
    assert run(answers_slave_diag(4, 51), [NONE, status(3)])[1] is True
    assert run(answers_slave_diag(4, 51), [NONE, GARBLED])[1] is False


def test_the_text_of_a_service_without_an_answer() -> None:
    outcome = service_unanswered(4, "Get_Cfg", "look")
    assert (outcome.failure, outcome.status) == (ServiceFailure.REFUSED, "no answer")
    assert outcome.text == "slave 4 is there (it answers Slave_Diag) and leaves Get_Cfg without an answer; look"


def test_lengths_of_answers() -> None:
    def read(service: Service, octets: int, expected: int | None = None) -> ServiceFailure | None:
        return Class2Reading(ReadService(1, 4, service)).read(service, says(bytes(octets)), expected).failure

    long = ServiceFailure.LENGTH
    assert [read(Service.DIAGNOSIS, n) for n in (5, 6, 244, 245)] == [long, None, None, long]
    assert [read(Service.CONFIG, n) for n in (0, 1, 244, 245)] == [long, None, None, long]
    assert [read(Service.INPUTS, n) for n in (0, 1, 244, 245)] == [None, None, None, long]
    assert [read(Service.OUTPUTS, n, 2) for n in (0, 1, 2, 3)] == [long, long, None, long]


@pytest.mark.parametrize(
    ("why", "failure", "text"),
    [
        (
            NONE,
            ServiceFailure.SILENT,
            "slave 4 does not answer Slave_Diag; check address and power; `dpstack scan` shows who is there",
        ),
        (
            GARBLED,
            ServiceFailure.UNREADABLE,
            "slave 4 gives no readable answer to Slave_Diag; look for a second station with its address, and at cable "
            "and termination",
        ),
        (
            WRONG,
            ServiceFailure.WRONG,
            "slave 4 gives answers that do not belong to Slave_Diag; it answers from other service access points: it "
            "is no DP slave, or two stations have its address",
        ),
        (
            GUARD,
            ServiceFailure.GUARDED,
            "slave 4 was not sent Slave_Diag; this bus is read-only: leave read_only out where slaves shall be changed",
        ),
    ],
)
def test_texts_without_an_answer(why: Failure, failure: ServiceFailure, text: str) -> None:
    _, outcome = run(Class2Reading(ReadService(1, 4, Service.DIAGNOSIS)).steps(), [why] * 4)
    assert outcome == Outcome(failure, text)


# --- Set_Slave_Add --------------------------------------------------------------------------------------------------


def test_a_change_from_beginning_to_end() -> None:
    """Slave_Diag, FDL status of the new address twice, the service, Slave_Diag there, silence at the old one."""
    answers = [says(FREE), NONE, NONE, SHORT_ACK, NONE, says(FREE), NONE, NONE]
    job = change()
    made, outcome = run(job.steps(), answers)
    assert made == [DIAG_4, *NEW, SET, DIAG_9, DIAG_9, *OLD]
    assert outcome == Outcome(data=FREE)
    assert job.aftermath == "Set_Slave_Add may have been sent to slave 4: look for it at 4 and 9"
    done, notice = job.ends(7, outcome, 33)
    assert done.text == "slave 4: Set_Slave_Add, 6 octets"
    assert isinstance(notice, Notice)
    assert (notice.t_ns, notice.source, notice.message) == (33, "class 2", "slave 4 has address 9 now")
    assert len(job.ends(7, Outcome(ServiceFailure.SILENT), 33)) == 1


def test_for_good_and_with_data_for_the_slave() -> None:
    job = change(no_add_chg=True, rem_slave_data=b"\xca\xfe", ident=0x1234)
    made, _ = run(job.steps(), [says(FREE), NONE, NONE])
    assert made[-1] == "0: 0D 4/55<62 091234ffcafe"
    assert job.ends(1, Outcome(data=FREE), 0)[1].text.endswith("slave 4 has address 9 now for good")


def test_the_service_is_tried_three_times_and_its_effect_looked_for_without_an_acknowledgement() -> None:
    answers = [says(FREE), NONE, NONE, NONE, NONE, NONE, says(FREE), NONE, NONE]
    made, outcome = run(change().steps(), answers)
    assert made[3:6] == [SET, SET.replace("0:", "10:", 1), SET.replace("0:", "20:", 1) + " +1000"]
    assert made[6:] == [DIAG_9, *OLD]
    assert outcome == Outcome(data=FREE)


@pytest.mark.parametrize(
    ("answers", "asked", "failure"),
    [
        ([NONE] * 4, 4, ServiceFailure.SILENT),
        ([status(3)], 1, ServiceFailure.REFUSED),
        ([says(FREE[:5])], 1, ServiceFailure.LENGTH),
        ([says(OTHER)], 1, ServiceFailure.IDENT),
        ([says(FREE), status(0)], 2, ServiceFailure.TAKEN),
        ([says(FREE), NONE, status(0)], 3, ServiceFailure.TAKEN),
        ([says(FREE), NONE, GARBLED], 3, ServiceFailure.TAKEN),
        ([says(FREE), NONE, NONE, GUARD], 4, ServiceFailure.GUARDED),
        ([says(FREE), NONE, NONE, status(3)], 4, ServiceFailure.REFUSED),
        ([says(FREE), NONE, NONE, SHORT_ACK, says(OTHER)], 5, ServiceFailure.IDENT),
        ([says(FREE), NONE, NONE, SHORT_ACK, says(FREE), status(0)], 6, ServiceFailure.DOUBLE),
        ([says(FREE), NONE, NONE, SHORT_ACK, says(FREE), NONE, GARBLED], 7, ServiceFailure.DOUBLE),
    ],
)
def test_ends_without_a_new_address(answers: list[Telegram | Failure], asked: int, failure: ServiceFailure) -> None:
    made, outcome = run(change(ident=0x1234).steps(), answers)
    assert len(made) == asked
    assert failed(outcome)[0] is failure


@pytest.mark.parametrize(
    ("answers", "words"),
    [
        ([status(0x20)], "is owned by master 7 and"),
        ([status(0x30)], "is owned by master 7 and"),
        ([GARBLED], "is owned by master 7 and"),
        ([status(0)], "is still locked by master 7, which is not in the token ring"),
        ([NONE, NONE], "is still locked by master 7, which is not in the token ring"),
        ([NONE, status(0x20)], "is owned by master 7 and"),
    ],
)
@pytest.mark.parametrize("diagnosis", [LOCKED, LOCKED_OFF])
def test_a_slave_with_an_owner(answers: list[Telegram | Failure], words: str, diagnosis: bytes) -> None:
    """FDL status shows whether its master is on the bus."""
    made, outcome = run(change().steps(), [says(diagnosis), *answers])
    assert made == [DIAG_4, "0: 09 7 1", "0: 09 7 p1"][: 1 + len(answers)]
    assert outcome is not None
    assert outcome.failure is ServiceFailure.OWNED
    assert words in outcome.text
    assert "takes no address meanwhile; nothing was changed: " in outcome.text
    locked = "locked" in words
    assert (("watchdog is on" if diagnosis == LOCKED else "watchdog is off") in outcome.text) is locked
    assert ("stop master 7, or take the slave out of its configuration" in outcome.text) is not locked


@pytest.mark.parametrize(
    ("answer", "text"),
    [
        (SHORT_ACK, "slave 4 acknowledged Set_Slave_Add and kept"),
        (NONE, "slave 4 did not acknowledge Set_Slave_Add and"),
    ],
)
def test_the_old_address_is_looked_at_after_a_second_and_every_half_second(
    answer: Telegram | Failure, text: str
) -> None:
    """Nobody at the new address: FDL status to the old one with the attempts 11, 16, 21 ... of 50."""
    set_add = [answer] if answer is SHORT_ACK else [NONE] * 3
    before = [says(FREE), NONE, NONE, *set_add]
    for looks in range(8):
        answers = [*before, *[NONE] * (11 + 5 * looks + 2 * looks), status(0)]
        made, outcome = run(change().steps(), answers)
        expected = [DIAG_9] * 10
        for _ in range(looks):
            expected += [DIAG_9, *OLD, *[DIAG_9] * 4]
        assert made[len(before) :] == [*expected, DIAG_9, OLD[0]]
        assert failed(outcome) == (ServiceFailure.KEPT, "ignored")
        assert outcome is not None
        assert outcome.text.startswith(text)
    made, outcome = run(change().steps(), [*before, *[NONE] * 200])
    assert made.count(DIAG_9) == 50
    assert made.count(OLD[1]) == 8
    assert failed(outcome)[0] is ServiceFailure.GONE


def test_an_answer_at_the_new_address_that_is_no_diagnosis_is_waited_out() -> None:
    answers = [says(FREE), NONE, NONE, SHORT_ACK, status(3), GARBLED, SHORT_ACK, says(FREE), NONE, NONE]
    made, outcome = run(change().steps(), answers)
    assert made[4:] == [DIAG_9] * 4 + OLD
    assert outcome == Outcome(data=FREE)


@pytest.mark.parametrize("address", [-1, 2, 127])
def test_addresses_that_no_slave_has(address: int) -> None:
    provider = Class2(2, None)
    for order in (ReadService(1, address, Service.DIAGNOSIS), ChangeAddress(1, address, 9)):
        with pytest.raises(UsageError, match=str(address)):
            provider.job_of(order)


def test_orders_that_are_taken() -> None:
    provider = Class2(2, None)
    for address in (0, 1, 3, 126):
        made = present(provider.job_of(ReadService(5, address, Service.CONFIG, timeout_ns=77)))
        token, job, timeout = made
        assert (token, job.address, job.title, timeout) == (5, address, "Get_Cfg", 77)
    for new in (0, 1, 125):
        made = present(provider.job_of(ChangeAddress(6, 126, new, timeout_ns=78)))
        assert (made[0], made[1].address, made[1].title, made[1].aftermath, made[2]) == (
            6, 126, "Set_Slave_Add", "", 78,
        )  # fmt: skip
    assert ReadService(1, 4, Service.CONFIG).timeout_ns == 5_000_000_000
    assert ChangeAddress(1, 4, 5).timeout_ns == 15_000_000_000
    assert provider.job_of("another order") is None
