"""The wire of the testing kit, fed with octets written by hand and never by our master or codec."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.devices.finding import find
from dpstack.errors import UsageError
from dpstack.testing import Wire
from dpstack.testing.wire import Watched
from dpstack.trace import WireEntry

PLAIN = Watched("valves", 9, b"\x00", (0,), frozenset({b"\x00"}))
#: control word 047E behind four words of parameter channel; zeros do not stop it
FAN = Watched("fan", 4, bytes.fromhex("00 00 04 7E"), (2, 3), frozenset({bytes.fromhex("04 7E")}))
LOCK, UNLOCK = "88 01 01 0B 12 34", "40 00 00 0B 12 34"


def sd2(da: int, sa: int, fc: int, data: str, saps: str = "") -> bytes:
    more = 0x80 if saps else 0
    body = bytes((da | more, sa | more, fc)) + bytes.fromhex(saps) + bytes.fromhex(data)
    return bytes((0x68, len(body), len(body), 0x68)) + body + bytes((sum(body) & 0xFF, 0x16))


class Line:
    """Octets on a line, a millisecond each."""

    def __init__(self) -> None:
        self.wire = Wire((PLAIN, FAN), lambda: 500_000)
        self.ms = 0

    def send(self, octets: bytes, note: str = "") -> None:
        self.ms += 1
        self.wire.add(WireEntry(self.ms * 1_000_000, self.ms * 1_000_000 + 400_000, octets, "hand", note))

    def exchange(self, da: int, outputs: str, answer: str | None = "55", fc: int = 0x08, note: str = "") -> None:
        self.send(sd2(da, 2, 0x5D, outputs), note)
        if answer is not None:
            self.send(sd2(2, da, fc, answer))

    def control(self, octets: str, da: int = 127, note: str = "") -> None:
        self.send(sd2(da, 2, 0x46, octets, "3A 3E"), note)

    def service(self, da: int, sap: str, data: str, answer: bytes | None = b"\xe5") -> None:
        self.send(sd2(da, 2, 0x5D, data, f"{sap} 3E"))
        if answer is not None:
            self.send(answer)

    def diagnosis(self, da: int, octets: str) -> None:
        self.service(da, "3C", "", sd2(2, da, 0x08, octets, "3E 3C"))

    def is_safe(self, name: str = "valves") -> bool:
        try:
            self.wire.assert_last_outputs_safe(name)
        except AssertionError:
            return False
        return True


@pytest.fixture
def line() -> Line:
    return Line()


def test_outputs_are_safe_before_the_first_and_after_zeros_that_were_answered(line: Line) -> None:
    assert line.is_safe()
    line.exchange(9, "01")
    assert not line.is_safe()
    line.exchange(9, "00", None)
    assert not line.is_safe()  # the slave may have missed it
    line.exchange(9, "00", "55", fc=0x03)
    assert not line.is_safe()  # RS: it refused
    line.exchange(9, "00")
    assert line.is_safe()
    assert line.wire.last_outputs("valves") == b"\x00"


def test_outputs_that_are_not_safe_count_without_an_answer(line: Line) -> None:
    line.exchange(9, "00")
    line.exchange(9, "81", None)
    with pytest.raises(AssertionError, match=r"valves \(9\) may still act on .*: 81 at 0\.003000 s; safe are 00"):
        line.wire.assert_last_outputs_safe(9)


def test_clear_counts_from_a_slave_that_answers(line: Line) -> None:
    line.exchange(9, "01")
    line.control("02 00")
    assert line.is_safe()
    assert line.wire.clears == [0.003]
    line.exchange(9, "01", None)
    line.control("02 00")
    assert not line.is_safe()
    line.exchange(9, "01")
    line.control("02 04")  # group 3, in which it is not
    assert not line.is_safe()


def test_the_group_is_that_of_the_last_lock(line: Line) -> None:
    line.service(9, "3D", f"{LOCK} 04")
    line.exchange(9, "01")
    line.control("02 02")
    assert not line.is_safe()
    line.control("02 04")
    assert line.is_safe()


@pytest.mark.parametrize("note", ["dropped", "silenced", "collision", "damaged", "cut off after 3 of 9 octets"])
def test_a_telegram_that_no_station_received_counts_as_not_sent(line: Line, note: str) -> None:
    line.exchange(9, "01", note=note)
    assert line.is_safe()
    line.exchange(9, "01")
    line.control("02 00", note=note)
    assert not line.is_safe()
    assert line.wire.clears == []


def test_outputs_under_sync_act_with_the_next_sync(line: Line) -> None:
    line.exchange(9, "00")
    line.control("20 00")
    line.exchange(9, "01")
    assert line.is_safe()
    line.control("20 00")
    assert not line.is_safe()
    line.exchange(9, "00")
    assert not line.is_safe()
    line.control("10 00")
    assert line.is_safe()


def test_a_slave_outside_data_exchange_has_no_outputs(line: Line) -> None:
    line.exchange(9, "01")
    line.service(9, "3D", f"{UNLOCK} 00")
    assert line.is_safe()
    line.exchange(9, "01")
    assert not line.is_safe()
    line.diagnosis(9, "02 05 00 FF 12 34")
    assert line.is_safe()
    line.exchange(9, "01")
    line.diagnosis(9, "00 0C 00 02 12 34")  # in data exchange, watchdog on
    assert not line.is_safe()


def test_zeros_and_clear_stop_no_drive_that_runs_on_with_them(line: Line) -> None:
    line.exchange(4, "00 00 04 7F")
    assert not line.is_safe("fan")
    line.exchange(4, "00 00 00 00")
    line.control("02 00")
    assert not line.is_safe("fan")
    line.exchange(4, "11 0F 04 7E")  # a parameter request beside the safe control word
    line.exchange(4, "00 00 00 00")
    assert line.is_safe("fan")


def test_services_and_bring_up_in_their_order(line: Line) -> None:
    line.diagnosis(9, "02 05 00 FF 12 34")
    line.service(9, "3D", f"{LOCK} 00")
    line.service(9, "3E", "20 10", None)
    line.diagnosis(9, "00 0C 00 02 12 34")
    line.exchange(9, "00")
    line.exchange(9, "00")
    with pytest.raises(AssertionError, match=r"valves \(9\): the bring-up lacks Chk_Cfg, Slave_Diag, Data_Exchange"):
        line.wire.assert_brought_up("valves")
    answered = {"Slave_Diag": True, "Set_Prm": True, "Chk_Cfg": False, "Data_Exchange": True}
    named = [(one.name, one.answered) for one in line.wire.services("valves")]
    order = ["Slave_Diag", "Set_Prm", "Chk_Cfg", "Slave_Diag", "Data_Exchange"]
    assert named == [(name, answered[name]) for name in order]
    line.service(9, "3E", "20 10")
    line.diagnosis(9, "00 0C 00 02 12 34")
    line.exchange(9, "00")
    line.wire.assert_brought_up("valves")
    with pytest.raises(AssertionError, match="lacks Set_Prm, Chk_Cfg"):
        line.wire.assert_brought_up("valves", since=0.005)


def test_exchanges_with_their_answers(line: Line) -> None:
    line.exchange(9, "01", None)
    line.exchange(9, "02", "66")
    line.exchange(9, "03")
    line.send(b"\xe5")  # an answer that nobody asked for
    assert line.wire.exchanges("valves") == [
        (0.001, b"\x01", None),
        (0.002, b"\x02", b"\x66"),
        (0.004, b"\x03", b"\x55"),
    ]
    line.wire.assert_exchanged("valves", "02")
    line.wire.assert_exchanged("valves", b"\x03", since=0.004)
    with pytest.raises(AssertionError, match=r"no Data_Exchange with the outputs 01 since 0 s; answered: 02, 03"):
        line.wire.assert_exchanged("valves", "01")
    with pytest.raises(AssertionError, match="no Clear was sent since 0 s"):
        line.wire.assert_clear()
    with pytest.raises(UsageError, match=r"no slave 'pump' on this bus; there are: valves \(9\), fan \(4\)"):
        line.wire.exchanges("pump")


def test_the_log_is_decoded_bounded_and_printable(line: Line) -> None:
    for _ in range(10):
        line.exchange(9, "01")
    line.wire.add(WireEntry(10**9, 10**9 + 1, b"\xe5", "\x1b[31mred"))
    lines = line.wire.text(3, every=True).splitlines()
    assert len(lines) == 4
    assert "Data_Exchange request 2 -> 9" in lines[1]
    assert "\x1b" not in line.wire.text() + line.wire.text(every=True)


#: a read of QB0 and its answer, as a SCADA system and an S7-200 have sent them (picproje.org, topic 28390)
QB0 = "68 1B 1B 68 02 00 6C 32 01 00 00 00 00 00 0E 00 00 04 01 12 0A 10 02 00 01 00 00 82 00 00 00 65 16"
QB0_IS_0 = "68 16 16 68 00 02 08 32 03 00 00 00 00 00 02 00 05 00 00 04 01 FF 04 00 08 00 56 16"
#: the same with sequence number 1
QB0_AGAIN = "68 1B 1B 68 02 00 6C 32 01 00 00 00 01 00 0E 00 00 04 01 12 0A 10 02 00 01 00 00 82 00 00 00 66 16"
QB0_AGAIN_0 = "68 16 16 68 00 02 08 32 03 00 00 00 01 00 02 00 05 00 00 04 01 FF 04 00 08 00 57 16"


def test_telegrams_of_ppi_are_explained_by_those_before_the_last_lines(line: Line) -> None:
    def read(asks: str, answer: str) -> None:
        for octets in (asks, "E5", "10 02 00 5C 5E 16", answer):
            line.send(bytes.fromhex(octets))

    read(QB0, QB0_IS_0)
    lines = line.wire.text(2, every=True).splitlines()
    assert [text.split()[0] for text in lines[1:]] == ["3", "4"]
    assert lines[1].endswith("PPI request 0 -> 2 (SRD low, FCV=1 FCB=0)")
    assert lines[2].endswith("PPI answer 2 -> 0, 19 octets: QB0 = 0 (DL, slave)")
    for _ in range(3):
        read(QB0_AGAIN, QB0_AGAIN_0)
    # other sequence numbers are nothing new
    assert "12 telegrams in 11.4 ms as before: 6 PPI to 2" in line.wire.text().splitlines()[-1]
    assert len(line.wire.text().splitlines()) == 6


def test_what_repeats_is_one_line_and_what_is_new_is_not(line: Line) -> None:
    """Twenty equal rotations, an answer that is missing, its retry, and twenty more: the missing one is seen."""
    for beat in (0x5D, 0x7D) * 10:
        line.send(sd2(9, 2, beat, "01"))
        line.send(sd2(2, 9, 0x08, "55"))
        line.send(bytes.fromhex("10 32 02 49 7D 16"))  # nobody has address 50
        line.send(b"\xdc\x02\x02")
    line.send(sd2(9, 2, 0x5D, "01"))
    line.send(sd2(9, 2, 0x5D, "01"))
    for beat in (0x08, 0x7D, 0x08, 0x5D) * 10:
        line.send(sd2(2, 9, 0x08, "55") if beat == 0x08 else sd2(9, 2, beat, "01"))
    line.send(sd2(2, 9, 0x0A, "55"))
    text = [re.sub(r".*  ", "", one).strip() for one in line.wire.text().splitlines()[1:]]
    assert text == [
        "Data_Exchange request 2 -> 9, 1 octet (SRD high, FCV=1 FCB=0)",
        "Data_Exchange answer 9 -> 2, 1 octet (DL, slave)",
        "FDL_Status request 2 -> 50 (FC 0x49); not answered",
        "token 2 -> 2 (to itself)",
        "... 76 telegrams in 75.4 ms as before: 19 Data_Exchange to 9, 19 FDL_Status, 19 token",
        "Data_Exchange request 2 -> 9, 1 octet (SRD high, FCV=1 FCB=0); not answered",
        "Data_Exchange request 2 -> 9, 1 octet (SRD high, FCV=1 FCB=0); retry of 81",
        "Data_Exchange answer 9 -> 2, 1 octet (DL, slave)",
        "Data_Exchange request 2 -> 9, 1 octet (SRD high, FCV=1 FCB=1)",
        "... 38 telegrams in 37.4 ms as before: 19 Data_Exchange to 9",
        "Data_Exchange answer 9 -> 2, 1 octet (DH, slave)",
    ]
    assert [one.split()[0] for one in line.wire.text(3).splitlines()[1:]] == ["84", "...", "123"]


def test_the_log_reaches_back_to_the_change_however_long_ago(line: Line) -> None:
    line.exchange(9, "01")
    for _ in range(2_000):
        line.exchange(9, "02")
    assert [one.split()[0] for one in line.wire.text(5).splitlines()[1:]] == ["1", "2", "3", "..."]


@pytest.mark.parametrize(
    ("drive", "safe", "unsafe"),
    [
        ("fuji-frenic", "04 7E 20 00", "04 7F 00 00"),  # docs/reference/drives/fuji.md#worked-run
        ("demag-dedrive", "00 00 20 00", "04 7F 00 00"),
        ("imo-hd2", "00 05", "00 01"),
    ],
)
def test_control_words_of_drives(drive: str, safe: str, unsafe: str) -> None:
    from dpstack.api.config.config import slave_config

    profile = find(drive)
    watched = Watched.of(slave_config({"name": "it", "address": 4, "drive": drive}))
    spec = profile.telegram(None)
    lead = spec.output_octets - spec.outputs
    for control, wanted in ((safe, True), (unsafe, False)):
        octets = bytes(range(lead)) + bytes.fromhex(control).ljust(spec.outputs, b"\0")
        assert watched.is_safe(octets) is wanted


#: what may go over the line
STEPS: Mapping[str, Callable[[Line], None]] = {
    "safe": lambda line: line.exchange(9, "00"),
    "running": lambda line: line.exchange(9, "01"),
    "silent": lambda line: line.exchange(9, "02", None),
    "clear": lambda line: line.control("02 00"),
    "sync": lambda line: line.control("20 00"),
    "lock": lambda line: line.service(9, "3D", LOCK),
    "unlock": lambda line: line.service(9, "3D", UNLOCK),
    "no answer": lambda line: line.service(9, "3D", LOCK, None),
    "lost": lambda line: line.exchange(9, "01", note="dropped"),
    "garbled": lambda line: line.send(b"\x68\x00"),
}


@given(st.lists(st.sampled_from(tuple(STEPS)), max_size=30))
def test_when_it_is_asked_changes_nothing(steps: list[str]) -> None:
    """Judged telegram by telegram, or all at the end."""
    asked, late = Line(), Line()
    for step in steps:
        for line in (asked, late):
            STEPS[step](line)
        asked.is_safe()
    assert asked.is_safe() == late.is_safe()
    for name in ("valves", "fan"):
        assert asked.wire.exchanges(name) == late.wire.exchanges(name)
        assert asked.wire.services(name) == late.wire.services(name)
    assert asked.wire.clears == late.wire.clears
    assert asked.wire.text(every=True) == late.wire.text(every=True)
