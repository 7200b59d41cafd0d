"""Diagnoses of a simulated slave at the same time, as a master in literal octets reads them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from simulated_kit import Asked

from dpstack.api.slave_side.fault_steps import KINDS, Deed, End
from dpstack.errors import ConfigError, DpError
from dpstack.sim.io_station.station import IoStation
from dpstack.testing import BusFactory
from dpstack.toml.table import Source, Table

#: two words of inputs, an octet of inputs, two octets of outputs, an empty slot, two words of outputs
RACK: dict[str, object] = {"name": "rack", "address": 8, "ident": 0x1234, "config": "51 10 21 00 61"}


def deed(asked: Asked, what: str = "", **keys: object) -> Deed:
    """The diagnosis as a step of a scenario."""
    table = Table(Source("step"), (), {"what": what, **keys} if what else keys, "step")
    kind = KINDS["diagnosis"]
    return kind.read(table, table.read(kind.keys), asked.bench, 8)


def begin(asked: Asked, what: str = "", **keys: object) -> End:
    end = deed(asked, what, **keys).begin()
    assert end is not None
    return end


def diagnosis(asked: Asked) -> str:
    """Octet 1 (bit 3: Ext_Diag), then those behind the six fixed ones."""
    octets = asked.ask("3C 3E").split()[9:-2]
    return " ".join((octets[0], *octets[6:]))


def outputs_of(asked: Asked) -> str:
    return asked.exchange("00 00 00 00 00 00").split()[6]


@pytest.fixture
def asked() -> Asked:
    found = Asked(RACK)
    outputs_of(found)
    return found


def with_dpv1(asked: Asked) -> Asked:
    assert asked.ask("3D 3E 80 00 00 0B 12 34 00 80 00 00") == "E5"  # DPV1_Enable
    assert asked.ask("3E 3E 51 10 21 00 61") == "E5"
    outputs_of(asked)
    return asked


def test_several_diagnoses_are_one_as_of_a_rack_and_each_has_its_end(asked: Asked) -> None:
    """One identifier related block, then channel related ones: words of an AI, bits of a DI, outputs of an AO."""
    line_break = begin(asked, "slot 1 channel 0 line break")
    assert outputs_of(asked) == "0A"  # DH: fetch the diagnosis
    assert diagnosis(asked) == "08 42 01 80 40 A6"
    assert outputs_of(asked) == "08"
    short = begin(asked, "slot 2 channel 3 short circuit")
    begin(asked, "slot 5 channel 1 overload")
    over = begin(asked, "slot 1 channel 1 upper limit exceeded")
    assert outputs_of(asked) == "0A"
    assert diagnosis(asked) == "08 42 13 80 40 A6 81 43 21 84 81 A4 80 41 A7"
    assert line_break()
    assert not line_break()
    assert diagnosis(asked) == "08 42 13 81 43 21 84 81 A4 80 41 A7"
    assert short()
    assert over()
    assert diagnosis(asked) == "08 42 10 84 81 A4"
    asked.bench.power(8, False)
    asked.bench.power(8, True)
    asked.bring_up("51 10 21 00 61")
    assert diagnosis(asked) == "08 42 10 84 81 A4"


def test_the_same_diagnosis_twice_ends_with_the_second(asked: Asked) -> None:
    first, second = (begin(asked, "slot 1 channel 0 line break") for _ in range(2))
    assert diagnosis(asked) == "08 42 01 80 40 A6"
    assert first()
    assert diagnosis(asked) == "08 42 01 80 40 A6"
    assert second()
    assert diagnosis(asked) == "00"


def test_a_step_ends_one_diagnosis_of_several(asked: Asked) -> None:
    first = begin(asked, "slot 1 channel 0 line break")
    begin(asked, slot=1, channel=0, error=6, fault=False)  # the same
    begin(asked, "slot 2 channel 3 short circuit")
    over = deed(asked, "slot 1, input channel 0 (word): line break", over=True)
    assert over.text == "over: diagnosis, slot 1, input channel 0 (word): line break"
    assert over.begin() is None
    assert diagnosis(asked) == "08 42 02 81 43 21"
    assert not first()
    with pytest.raises(DpError, match="has no such diagnosis at this moment; its faults: diagnosis, slot 2, input"):
        over.begin()


def test_with_dpv1_a_module_status_has_the_states_of_all_slots(asked: Asked) -> None:
    begin(asked, "slot 1 channel 0 line break")
    gone = begin(asked, "slot 3 no module")
    assert diagnosis(asked) == "08 42 05 80 40 A6"  # without DPV1_Enable it would be a block of the maker
    with_dpv1(asked)
    # slot 1: 01 data invalid, slot 3: 11 no module; two octets for five slots
    assert diagnosis(asked) == "08 42 05 06 82 00 00 31 00 80 40 A6"
    begin(asked, "slot 5 wrong module")
    assert diagnosis(asked) == "08 42 15 06 82 00 00 31 02 80 40 A6"
    assert gone()
    assert diagnosis(asked) == "08 42 11 06 82 00 00 01 02 80 40 A6"


@pytest.mark.parametrize(
    ("keys", "octets"),
    [
        ({"slot": 2, "error": "line break"}, "42 02 81 40 26"),
        ({"slot": 2, "channel": 7, "error": 17}, "42 02 81 47 31"),
        ({"slot": 2, "error": 6, "size": "byte", "direction": "both"}, "42 02 81 C0 86"),
        ({"slot": 4, "state": "no module"}, "42 08"),
        ({"what": "slot 2 channel 3 error 17", "size": "2 bits"}, "42 02 81 43 51"),
        ({"what": "slot 1 (2 AI), in/output channel 3 (2 words): lower limit exceeded"}, "42 01 80 C3 C8"),
        ({"octets": "42 01 80 40 26"}, "42 01 80 40 26"),
    ],
)
def test_by_keys_and_as_a_diagnosis_is_shown(asked: Asked, keys: dict[str, Any], octets: str) -> None:
    begin(asked, **keys)
    assert diagnosis(asked) == f"08 {octets}"


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"what": "slot 6 channel 0 line break"}, "has no slot 6; it has slots 1 to 5"),
        ({"what": "slot 1 channel 0 wire brake"}, "unknown error 'wire brake'"),
        ({"what": "slot 1 channel 64 line break"}, "channel 64; channels are 0..63"),
        ({"what": "slot 1 lost"}, "unknown state 'lost' of a module; known: ok, data invalid"),
        ({"what": "slot 1 channel 0 (nibble) line break"}, "unknown size 'nibble'"),
        ({"what": "slot 1 no module", "slot": 1}, "slot, and what says it; leave slot out"),
        ({"state": "no module", "channel": 1}, "channel, and a state is that of a module"),
        ({"octets": "42 01", "slot": 1}, "slot, and octets are sent as they are"),
        ({"what": "slot 1 no module", "text": "fuse"}, "what and text; give one"),
        ({"what": "slot 1 no module", "alarm": True}, "raises no alarms: its device has no DP-V1; leave alarm out"),
        ({"what": "fuse"}, "unknown text 'fuse'; its GSD file has no texts"),
        ({}, "a diagnosis without what, error, text, octets or state"),
    ],
)
def test_errors_say_what_to_do(asked: Asked, keys: dict[str, Any], says: str) -> None:
    with pytest.raises(ConfigError) as told:
        begin(asked, **keys)
    assert says in str(told.value)
    assert diagnosis(asked) == "00"


class Terminal(Asked):
    """A device with DP-V1 of the GSD file ``gsd``; its master enables alarms of diagnosis, of pull and plug."""

    def __init__(self, gsd: str = "io-station", ident: int = 0x1234, dpv1: str = "80") -> None:
        self.status_1, self.status_2 = dpv1, "A0"
        self.ident = f"{ident >> 8:02X} {ident & 0xFF:02X}"
        table: dict[str, object] = {"name": "rack", "address": 8, "ident": ident, "dpv1": dpv1 != "00"}
        super().__init__(table | {"gsd": gsd, "modules": ["8 DI", "8 DO", "2 AI"]})

    def bring_up(self, config: str = "") -> None:
        assert self.ask(f"3D 3E 80 00 00 0B {self.ident} 00 {self.status_1} {self.status_2} 00 01 01") == "E5"
        assert self.ask("3E 3E 10 20 51") == "E5"
        self.exchange("00")

    def acknowledge(self, octets: str) -> None:
        assert self.ask(f"33 33 {octets}") == "E5"
        assert self.ask("33 33").split()[9:-2] == octets.split()
        self.exchange("00")


def test_begin_and_end_as_alarms() -> None:
    """Appears; disappears while the slot is still disturbed; disappears."""
    asked = Terminal()
    first = begin(asked, "slot 3 channel 0 line break", alarm=True)
    assert diagnosis(asked) == "08 06 01 03 01 00 06 42 04 05 82 00 00 10 82 40 A6"
    asked.acknowledge("5C 03 01 01")
    assert diagnosis(asked) == "08 42 04 05 82 00 00 10 82 40 A6"
    second = begin(asked, "slot 3 channel 1 short circuit", alarm=True)
    assert diagnosis(asked) == "08 06 01 03 09 01 01 42 04 05 82 00 00 10 82 40 A6 82 41 A1"
    asked.acknowledge("5C 03 01 09")
    assert first()
    assert diagnosis(asked) == "08 06 01 03 13 00 06 42 04 05 82 00 00 10 82 41 A1"
    asked.acknowledge("5C 03 01 13")
    assert second()
    assert diagnosis(asked) == "00 06 01 03 1A 01 01"
    asked.acknowledge("5C 03 01 1A")
    assert diagnosis(asked) == "00"


def test_pull_and_plug() -> None:
    asked = Terminal()
    gone = begin(asked, "slot 2 no module", alarm=True)
    assert diagnosis(asked) == "08 04 03 02 01 42 02 05 82 00 00 0C"
    asked.acknowledge("5C 02 03 01")
    assert gone()
    assert diagnosis(asked) == "00 04 04 02 0A"
    asked.acknowledge("5C 02 04 0A")
    begin(asked, "slot 2 wrong module", alarm=True)
    assert diagnosis(asked) == "08 04 04 02 13 42 02 05 82 00 00 08"


def test_an_alarm_that_the_master_did_not_enable_begins_nothing() -> None:
    asked = Terminal()
    asked.status_2 = "00"
    asked.bring_up()
    with pytest.raises(DpError, match="its master did not enable diagnostic alarms in Set_Prm"):
        begin(asked, "slot 3 channel 0 line break", alarm=True)
    assert diagnosis(asked) == "00"
    assert asked.unit.faults.active == ()


def test_beside_the_diagnosis_of_the_io_station_itself() -> None:
    asked = Terminal(ident=0x10D5)
    station = asked.bench.units[8].device
    assert isinstance(station, IoStation)
    asked.status_2 = "00"
    asked.bring_up()
    station.pull(2)
    station.wire_break(3, 0, True)
    end = begin(asked, "slot 3 channel 1 line break")
    for _ in range(5):  # its own module status is a message, which is fetched once
        asked.exchange("00")
        found = diagnosis(asked)
    assert found == "08 42 06 05 82 00 00 1C 82 40 A6 82 41 A6"
    assert end()
    asked.exchange("00")
    assert diagnosis(asked) == "08 42 06 82 40 A6"


#: texts at the bits of type, slot and specifier of a status, behind them, and of a type of the maker's own
TEXTS = """
Unit_Diag_Bit(0) = "fuse blown"
Unit_Diag_Bit(1) = "too hot"
Unit_Diag_Bit(26) = "door open"
Unit_Diag_Bit(33) = "battery low"
Unit_Diag_Area = 2-3
Value(2) = "mode 2"
Unit_Diag_Area_End
Unit_Diag_Area = 4-7
Value(3) = "fan slow"
Unit_Diag_Area_End
UnitDiagType = 161
X_Unit_Diag_Bit(24) = "valve stuck"
EndUnitDiagType
"""


@pytest.fixture
def gsd(tmp_path: Path) -> str:
    found = tmp_path / "texts.gsd"
    found.write_text(Path("dpstack/sim/io_station/io-station.gsd").read_text(encoding="utf-8") + TEXTS, "utf-8")
    return str(found)


@pytest.mark.parametrize(
    ("texts", "octets"),
    [
        (["fuse blown"], "04 81 00 00"),  # a status message has this bit
        (["too hot"], "04 A2 00 00"),  # the maker's own status 34
        (["mode 2"], "04 A8 00 00"),
        # behind the specifier: the first type whose bits say nothing else, as 81 would say "fuse blown"
        (["door open"], "05 A0 00 00 04"),
        (["door open", "battery low"], "06 A0 00 00 04 02"),
        (["valve stuck"], "05 A1 00 00 01"),
        (["valve stuck", "battery low"], "05 A1 00 00 01 06 A0 00 00 00 02"),
    ],
)
def test_texts_of_the_gsd_file_are_a_status_of_dpv1(gsd: str, texts: list[str], octets: str) -> None:
    asked = Terminal(gsd)
    for text in texts:
        begin(asked, text)
    assert diagnosis(asked) == f"08 {octets}"


def test_without_dpv1_texts_are_bits_of_one_block(gsd: str) -> None:
    asked = Terminal(gsd, dpv1="00")
    begin(asked, "fuse blown")
    begin(asked, "fan slow")
    begin(asked, "door open")
    assert diagnosis(asked) == "08 05 31 00 00 04"


def test_a_text_that_no_status_can_carry_is_refused(gsd: str) -> None:
    with pytest.raises(ConfigError, match="bits that no alarm and no status of DP-V1 can have; give dpv1 = false"):
        begin(Terminal(gsd), "fan slow")


def test_a_master_with_dpv1_has_the_text_and_no_malformed_block(dpstack_bus: BusFactory, gsd: str) -> None:
    rack = {"name": "rack", "address": 8, "gsd": gsd, "modules": ["8 DI", "8 DO", "2 AI"]}
    bus = dpstack_bus(slaves=[rack], baud=93_750)
    bus.faults.diagnosis("rack", "slot 3 channel 0 line break")
    with bus.faults.diagnosis("rack", "fuse blown"):
        bus.wait(0.1)
        assert bus.slave("rack").diagnosis_texts[2:] == (
            "slots with a diagnosis: 3 (2 AI)",
            "module status: slot 3 data invalid",
            "slot 3 (2 AI), input channel 0 (word): line break",
            "status message, slot 0",
            "fuse blown",
        )
    counts = bus.slave("rack").alarm_counts
    assert counts is not None
    assert counts.malformed == 0
