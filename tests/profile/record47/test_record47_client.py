"""The master's end of record 47 against a drive of literal octets."""

from __future__ import annotations

import pytest
from acyclic_kit import BUSY, IS_965, MS, READ_965, Script, octets, talk

from dpstack.dpv1.pdu.read_write import ReadReq, WriteReq
from dpstack.profile.model.jobs import CommandError
from dpstack.profile.record47.client import PLUGIN, PROGRAM, ParameterClient
from dpstack.profile.record47.param_lists import defined, describe, read_limits, texts
from dpstack.profile.record47.pdu import Address, Answer, ErrorValue, Limits, Refused, Result, Service, Silent, Values

#: the results of a Read of 965 that is answered by ``IS_965``
VALUE_965 = [Values(6, (0x328,))]


def client(**limits: int) -> ParameterClient:
    return ParameterClient(1, limits=Limits(**limits))


def read_965(drive: Script, master: ParameterClient | None = None) -> list[Result]:
    """The result of a Read of parameter 965."""
    return talk((client() if master is None else master).read([Address(965)]), drive)


# -- one request -----------------------------------------------------------------------------------------------------


def test_l8_965_as_the_manual_prints_it() -> None:
    drive = Script("", BUSY, BUSY, IS_965)
    master = client()
    assert read_965(drive, master) == VALUE_965
    assert drive.said == [READ_965, "5E 01 2F F0", "pause 2 ms", "5E 01 2F F0", "pause 4 ms", "5E 01 2F F0"]
    assert (master.counters.requests, master.counters.services, master.counters.busy) == (1, 4, 2)
    assert master.counters.octets == 10 + 8


def test_a_drive_that_still_carries_out_another_request_is_asked_again() -> None:
    drive = Script(BUSY, Refused(0xC2), "", IS_965)
    assert read_965(drive) == VALUE_965
    assert drive.said[:4] == [READ_965, "pause 2 ms", READ_965, "pause 4 ms"]


def test_a_drive_that_stays_busy() -> None:
    drive = Script("", *[BUSY] * 100)
    with pytest.raises(CommandError, match="record 47 of slot 1: the drive did not answer within 2000 ms") as caught:
        read_965(drive)
    assert caught.value.kind == "timeout"
    assert drive.now == pytest.approx(2000 * MS, abs=60 * MS)
    drive = Script(*[BUSY] * 100)
    with pytest.raises(CommandError, match=r"the drive is still busy \(error B/5, state conflict\)"):
        read_965(drive)


def test_the_time_is_limited_by_the_caller_and_by_the_latency_of_the_drive() -> None:
    drive = Script("", *[BUSY] * 100)
    with pytest.raises(CommandError, match="did not answer"):
        talk(client().read([Address(965)], deadline=100 * MS), drive)
    assert drive.now <= 103 * MS
    slow = Script("", *[BUSY] * 200)
    with pytest.raises(CommandError, match="within 6000 ms"):
        talk(client(latency_ns=3000 * MS).read([Address(965)]), slow)


def test_an_answer_to_another_request_is_never_accepted() -> None:
    late, garbage, other = "07 01 01 01 06 01 00 07", "07 01", "01 02 01 01"
    drive = Script("", late, garbage, other, IS_965)
    master = client()
    assert read_965(drive, master) == VALUE_965
    assert (master.counters.strays, master.counters.garbage) == (2, 1)
    stuck = Script("", *[late] * 100)
    with pytest.raises(CommandError, match=r"the drive answers request 7 \(id 1\) instead of ours"):
        read_965(stuck)


def test_each_request_has_a_reference_of_its_own_and_never_0() -> None:
    for references, expected in ((range(1, 256), "01 02 FF 01"), (PLUGIN, "01 02 7F 01"), (PROGRAM, "80 81 FF 80")):
        master = ParameterClient(1, references=references)
        said: list[str] = []
        for reference in (*references, references.start):
            drive = Script("", f"{reference:02X} 01 01 01 06 01 00 00")
            read_965(drive, master)
            said.append(drive.said[0][12:14])
        assert len(set(said)) == len(references)
        assert " ".join((*said[:2], *said[-2:])) == expected


def test_a_lost_write_of_a_reading_request_is_repeated_that_of_a_change_is_not() -> None:
    lost = Silent("slave 9 does not answer Write")
    drive = Script(lost, lost, "", IS_965)
    master = client()
    assert read_965(drive, master) == VALUE_965
    assert drive.said == [READ_965, READ_965, READ_965, "5E 01 2F F0"]
    assert (master.counters.requests, master.counters.services, master.counters.repeated) == (1, 4, 2)
    for answers, order in (
        ((lost, lost, lost), client().read([Address(965)])),
        (("", lost), client().read([Address(965)])),  # a Read is repeated by MS1 itself
        ((lost,), client().change([(Address(927), Values(6, (0,)))])),
    ):
        with pytest.raises(CommandError, match="slave 9 does not answer Write") as caught:
            talk(order, Script(*answers))
        assert caught.value.kind == "timeout"


def test_a_response_that_was_lost_on_the_way_is_asked_for_anew() -> None:
    class Lost(Script):
        """The first response went out and did not arrive."""

        def __call__(self, service: Service) -> Answer:
            writes = sum(one.startswith("5F") for one in self.said)
            if isinstance(service, ReadReq) and writes < 2:
                self._answers.insert(0, BUSY)
            return super().__call__(service)

    drive = Lost("", "", IS_965)
    master = client()
    assert read_965(drive, master) == VALUE_965
    assert [one for one in drive.said if one.startswith("5F")] == [READ_965, READ_965]
    assert drive.now == pytest.approx(1000 * MS, abs=60 * MS)
    assert master.counters.repeated == 1
    change = Script("", *[BUSY] * 100)
    with pytest.raises(CommandError, match="within 2000 ms; it may have been carried out: read it back"):
        talk(client().change([(Address(927), Values(6, (0,)))]), change)
    assert [one[:2] for one in change.said].count("5F") == 1


def test_a_read_that_another_clients_request_replaced_is_sent_again_a_change_is_not() -> None:
    ours, other = "80 01 01 01 06 01 03 28", "05 01 01 01 06 01 00 07"
    drive = Script("", other, "", ours)
    master = ParameterClient(1, references=PROGRAM)
    assert read_965(drive, master) == VALUE_965
    assert [one[:2] for one in drive.said] == ["5F", "5E", "5F", "pa", "5E"]
    change = Script("", *[other] * 100)
    with pytest.raises(CommandError, match=r"the drive answers request 5 \(id 1\) instead of ours"):
        talk(master.change([(Address(927), Values(6, (0,)))]), change)
    assert [one[:2] for one in change.said].count("5F") == 1


@pytest.mark.parametrize(
    ("answers", "text", "number"),
    [
        ((Refused(0xB2),), "the drive refuses the request: error B/2, invalid slot", 0xB2),
        (("", Refused(0xB0)), "the drive refuses the response: error B/0, invalid index", 0xB0),
        (("", "01 01 01 01 06 02 03 28"), "2 values of format Unsigned16 are 4 octets", None),
        (("", "01 01 01 00"), "the drive answered 0 of 1 parameters", None),
        ((Refused(0xB1),), "does not take a request of 10 octets", None),
    ],
)
def test_refusals_and_impossible_answers_end_at_once(
    answers: tuple[str | Refused, ...], text: str, number: int | None
) -> None:
    with pytest.raises(CommandError, match=text) as caught:
        read_965(Script(*answers))
    assert (caught.value.kind, caught.value.number) == ("parameter", number)


# -- several parameters ------------------------------------------------------------------------------------------------


def test_several_at_once_and_one_that_fails() -> None:
    drive = Script("", "01 81 01 03 06 01 00 05 44 01 00 00 03 02 FF FF 00 02")
    results = talk(client().read([Address(922), Address(1), Address(11, 3, 2)]), drive)
    assert results == [Values(6, (5,)), ErrorValue(0), Values(3, (-1, 2))]
    assert drive.said[0] == ("5F 01 2F 16 01 01 01 03 10 00 03 9A 00 00 10 00 00 01 00 00 10 02 00 0B 00 03")


def test_changes_that_succeed_and_that_fail_in_part() -> None:
    drive = Script("", "01 02 01 01", "", "02 82 01 02 40 00 44 02 00 02 00 00")
    master = client()
    assert talk(master.change([(Address(927, 0, 1), Values(6, (0,)))]), drive) == [Values(0x40)]
    assert drive.said[0] == "5F 01 2F 0E 01 02 01 01 10 01 03 9F 00 00 06 01 00 00"  # Toshiba PDP003Z p32
    both = [(Address(1105), Values(8, (30.0,))), (Address(1106), Values(6, (9,)))]
    assert talk(master.change(both), drive) == [Values(0x40), ErrorValue(2, 0)]
    with pytest.raises(ValueError, match=r"parameter 5\[0..1\]: 1 values for 2 elements"):
        talk(master.change([(Address(5, 0, 2), Values(6, (1,)))]), drive)


@pytest.mark.parametrize("answer", ["02 80 01 02 44 01 00 21", "02 80 01 02"])
def test_a_drive_that_does_not_have_the_request_id(answer: str) -> None:
    drive = Script("", "01 01 01 01 06 01 00 05", "", answer)
    master = client()
    assert talk(master.read([Address(922)]), drive) == [Values(6, (5,))]
    both = [(Address(1), Values(6, (1,))), (Address(2), Values(6, (2,)))]
    assert talk(master.change(both), drive) == [ErrorValue(0x21), ErrorValue(0x21)]
    assert drive.said[-1] == "5E 01 2F F0"  # asked for once
    assert master.counters.strays == 0


def test_one_error_for_a_whole_request_counts_for_each() -> None:
    drive = Script("", "01 81 05 01 44 01 00 19")
    master = ParameterClient(1, object=5)
    assert talk(master.read([Address(1), Address(2)]), drive) == [ErrorValue(0x19), ErrorValue(0x19)]


def test_a_response_too_long_is_asked_for_in_parts() -> None:
    long = "44 01 00 15"
    drive = Script(
        *("", f"01 81 01 02 06 01 00 01 {long}"),
        *("", f"02 81 01 01 {long}"),
        *("", "03 01 01 01 06 02 00 02 00 03"),
        *("", "04 01 01 01 06 02 00 04 00 05"),
    )
    master = client()
    assert talk(master.read([Address(1), Address(2, 7, 4)]), drive) == [Values(6, (1,)), Values(6, (2, 3, 4, 5))]
    writes = [one[12:] for one in drive.said if one.startswith("5F")]
    assert writes == [
        "01 01 01 02 10 00 00 01 00 00 10 04 00 02 00 07",
        "02 01 01 01 10 04 00 02 00 07",
        "03 01 01 01 10 02 00 02 00 07",
        "04 01 01 01 10 02 00 02 00 09",
    ]
    alone = Script("", f"01 81 01 01 {long}")
    assert talk(client().read([Address(1)]), alone) == [ErrorValue(0x15)]


def test_a_request_too_long_is_halved() -> None:
    drive = Script(
        *(Refused(0xB1), "", "02 01 01 02 05 01 01 00 05 01 02 00"),
        *("", "03 01 01 02 05 01 03 00 05 01 04 00"),
    )
    master = client()
    results = talk(master.read([Address(pnu) for pnu in (1, 2, 3, 4)]), drive)
    assert results == [Values(5, (n,)) for n in (1, 2, 3, 4)]
    assert master.counters.split == 1


def test_a_drive_that_takes_one_parameter_a_request() -> None:
    drive = Script(
        *("", "01 81 01 03 44 01 00 23 44 01 00 23 44 01 00 23"),
        *("", "02 01 01 01 06 01 00 01", "", "03 01 01 01 06 01 00 02", "", "04 81 01 01 44 01 00 23"),
    )
    master = client()
    results = talk(master.read([Address(pnu) for pnu in (1, 2, 3)]), drive)
    assert results == [Values(6, (1,)), Values(6, (2,)), ErrorValue(0x23)]  # alone it is no remedy
    assert master.counters.split == 3


def test_a_drive_that_takes_fewer_parameters_a_request() -> None:
    drive = Script(
        *("", "01 81 01 01 44 01 00 22"),  # one error for the request as a whole
        *("", "02 01 01 02 06 01 00 01 06 01 00 02", "", "03 01 01 02 06 01 00 03 06 01 00 04"),
    )
    results = talk(client().read([Address(pnu) for pnu in (1, 2, 3, 4)]), drive)
    assert results == [Values(6, (n,)) for n in (1, 2, 3, 4)]


# -- limits (974) ------------------------------------------------------------------------------------------------------


def test_974_is_respected() -> None:
    drive = Script("", "01 01 01 01 06 03 00 28 00 02 00 64")
    master = client()
    limits = talk(read_limits(master), drive)
    assert drive.said[0] == "5F 01 2F 0A 01 01 01 01 10 03 03 CE 00 00"
    assert limits == Limits(octets=40, parameters=2, latency_ns=1000 * MS)
    reads = Script("", "02 01 01 02 06 01 00 01 06 01 00 02", "", "03 01 01 01 06 01 00 03")
    assert len(talk(master.read([Address(1), Address(2), Address(3)]), reads)) == 3
    assert reads.said[1] == "5E 01 2F 28"


@pytest.mark.parametrize(
    ("answer", "limits"),
    [
        ("01 81 01 01 44 01 00 00", Limits()),
        ("01 01 01 01 06 03 00 00 00 00 00 00", Limits()),
        ("01 01 01 01 06 03 03 E8 00 FF 00 00", Limits()),
        ("01 01 01 01 06 01 00 80", Limits(octets=128)),
    ],
)
def test_limits_from_974_that_are_missing_or_impossible(answer: str, limits: Limits) -> None:
    assert talk(read_limits(client()), Script("", answer)) == limits


# -- lists -------------------------------------------------------------------------------------------------------------


class Lists:
    """A drive of octets: arrays of words by PNU, nothing else, one parameter a request."""

    def __init__(self, arrays: dict[int, list[int]]) -> None:
        self.arrays = arrays
        self.answer = b""
        self.requests = 0

    def __call__(self, service: Service) -> Answer:
        if isinstance(service, ReadReq):
            return Answer(0, self.answer)
        assert isinstance(service, WriteReq)
        data = service.data
        assert data[3] == 1
        self.requests += 1
        count, pnu, at = data[5], int.from_bytes(data[6:8], "big"), int.from_bytes(data[8:10], "big")
        array = self.arrays.get(pnu, [])
        words = array[at : at + count]
        if len(words) == count:
            body = bytes((6, count)) + b"".join(one.to_bytes(2, "big") for one in words)
            self.answer = data[:4] + body
        else:
            self.answer = bytes((data[0], 0x81, data[2], 1, 0x44, 1, 0, 3 if array else 0))
        return Answer(0)


def test_lists_with_a_zero_with_an_end_and_with_a_continuation() -> None:
    zero = Lists({980: [2, 5, 922, 0, 7, *[0] * 200]})
    assert talk(defined(client()), zero) == [2, 5, 922]
    end = Lists({980: list(range(1, 151))})
    assert talk(defined(client()), end) == list(range(1, 151))
    assert end.requests < 20
    chain = Lists({980: [*range(1, 300), 981], 981: [*range(300, 311), 5, *[0] * 289]})
    assert talk(defined(client()), chain) == list(range(1, 311))
    round_ = Lists({980: [1, 981], 981: [2, 980, 981, 982], 982: [0]})
    assert talk(defined(client()), round_) == [1, 2]


def test_a_drive_without_a_list_is_refused_by_name() -> None:
    with pytest.raises(CommandError, match="parameter 980: error 0, illegal parameter number") as caught:
        talk(defined(client()), Lists({}))
    assert caught.value.number == 0


NAMED = (
    "0A 2E 42 06 00 08 3C 23 D7 0A 00 01 00 00 00 00 53 70 65 65 64 20 20 20 20 20 20 20 20 20 20 20 "
    "00 00 00 00 00 00 FF FF 00 00 00 00 00 00 00 00"
)


def test_descriptions_in_octets() -> None:
    drive = Script("", f"01 81 01 02 {NAMED} 44 01 00 09")
    known, unknown = talk(describe(client(), [11, 12]), drive)
    assert drive.said[0] == "5F 01 2F 10 01 01 01 02 20 01 00 0B 00 00 20 01 00 0C 00 00"
    assert unknown is None
    assert known is not None
    assert (known.format, known.elements, known.name, known.read_only, known.array) == (6, 8, "Speed", True, True)
    assert known.factor == pytest.approx(0.01)
    assert known.build() == octets(NAMED)[2:]
    assert (known.low, known.high) == (bytes(4), octets("00 00 FF FF"))


def test_a_description_that_is_too_short_is_none() -> None:
    assert talk(describe(client(), [11]), Script("", "01 01 01 01 06 01 42 06")) == [None]


def test_texts_of_16_characters() -> None:
    off, on = (name.ljust(16).encode().hex(" ") for name in ("off", "on"))
    drive = Script("", f"01 01 01 01 09 20 {off} {on}", "", "02 81 01 01 44 01 00 0F")
    master = client()
    assert talk(texts(master, 300, 2), drive) == ["off", "on"]
    assert drive.said[0] == "5F 01 2F 0A 01 01 01 01 30 02 01 2C 00 00"
    with pytest.raises(CommandError, match="texts of parameter 300: error 15, no text array"):
        talk(texts(master, 300, 1, first=2), drive)
    assert drive.said[2] == "5F 01 2F 0A 02 01 01 01 30 01 01 2C 00 02"


@pytest.mark.parametrize("answer", ["01 81 01 01 44 01 00 16", "01 01 01 01 09 10 {off}"])
def test_a_drive_that_gives_one_text_for_an_address(answer: str) -> None:
    off, on = (name.ljust(16).encode().hex(" ") for name in ("off", "on"))
    drive = Script("", answer.format(off=off), "", f"02 01 01 02 09 10 {off} 09 10 {on}")
    assert talk(texts(client(), 300, 2, first=4), drive) == ["off", "on"]
    assert drive.said[0] == "5F 01 2F 0A 01 01 01 01 30 02 01 2C 00 04"
    assert drive.said[2] == "5F 01 2F 10 02 01 01 02 30 01 01 2C 00 04 30 01 01 2C 00 05"
