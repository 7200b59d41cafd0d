"""LS S100: what stands in the manual's tables (docs/reference/drives/ls-s100.md)."""

from __future__ import annotations

import pytest

from dpstack.errors import ConfigError
from dpstack.gsd.identifiers import io_lengths
from dpstack.profile import State
from dpstack_drives.ls import DRIVE, paramap, telegrams
from dpstack_drives.ls import table as t


def test_l1_facts_and_what_is_made_up() -> None:
    assert DRIVE.ident == 0x0A6C
    assert not DRIVE.ident_made_up
    assert DRIVE.user_prm.hex() == "800000"
    assert len(DRIVE.baud_rates) == 10
    assert not DRIVE.max_tsdr
    assert DRIVE.default_telegram == "PPO1"


@pytest.mark.parametrize(
    ("name", "config", "octets", "number"),
    [
        ("PPO1", "f371", 12, 101),
        ("PPO2", "f375", 20, 102),
        ("PPO3", "71", 4, 103),
        ("PPO4", "75", 12, 104),
        ("PPO5", "f379", 28, 105),
        ("PPO6", "79", 20, 106),
        ("ST1", "f1", 4, 1),
    ],
)
def test_l1_telegrams_by_pnu_922(name: str, config: str, octets: int, number: int) -> None:
    """PPO5 has 14 words although the manual says 8 at most: what is configured counts."""
    spec = DRIVE.telegram(name)
    assert spec.made_up
    assert spec.config.hex() == config
    assert io_lengths(spec.config) == (octets, octets) == (spec.output_octets, spec.input_octets)
    assert telegrams.number_of(spec) == number


@pytest.mark.parametrize(
    ("outputs", "inputs", "config"), [(1, 1, "6050"), (2, 3, "6152"), (8, 8, "6757"), (2, 2, "6151")]
)
def test_l1_vendor_telegrams(outputs: int, inputs: int, config: str) -> None:
    spec = DRIVE.telegram(f"vendor {outputs}/{inputs}")
    assert spec.name == f"VENDOR {outputs}/{inputs}"
    assert spec.config.hex() == config
    assert io_lengths(spec.config) == (2 * inputs, 2 * outputs)
    assert DRIVE.telegrams_of(spec.config) == (spec,)
    assert telegrams.number_of(spec) == 100


def test_l1_identifiers_tell_what_looks_alike_by_length() -> None:
    same = [DRIVE.telegram(name) for name in ("ST1", "PPO3", "VENDOR 2/2")]
    assert len({(spec.output_octets, spec.input_octets) for spec in same}) == 1
    assert [DRIVE.telegrams_of(spec.config)[0].name for spec in same] == ["ST1", "PPO3", "VENDOR 2/2"]


@pytest.mark.parametrize(
    ("name", "text"),
    [("PPO7", "it has PPO1, .* VENDOR OUTPUTS/INPUTS"), ("VENDOR 0/3", r"1\.\.8"), ("VENDOR 2/9", r"1\.\.8")],
)
def test_l1_telegrams_that_are_none(name: str, text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        DRIVE.telegram(name)
    assert DRIVE.telegrams_of(b"\x68\x50") == ()
    assert DRIVE.telegrams_of(b"\x61") == ()


@pytest.mark.parametrize(
    ("word", "state"),
    [
        (0x0040, State.SWITCH_ON_INHIBITED),
        (0x0274, State.SWITCH_ON_INHIBITED),  # 047E is copied, the drive is in S1
        (0x0276, State.SWITCH_ON_INHIBITED),  # so is 047F
        (0x0235, State.READY_TO_SWITCH_ON),
        (0x1_0235, State.STOPPING),  # the same word while ACT is not 0
        (0x0233, State.READY),
        (0x0237, State.RUNNING),
        (0x0337, State.RUNNING),
        (0x027F, State.FAULT),
        (0x0248, State.FAULT),
    ],
)
def test_l3_states(word: int, state: State) -> None:
    """S4 only from 0, 1, 2 set and 3, 6 clear."""
    assert t.PROFIDRIVE_TABLE.states.decode(word) is state


@pytest.mark.parametrize(
    ("word", "state"),
    [
        (0x6001, State.READY),
        (0x6802, State.RUNNING),
        (0x7004, State.RUNNING),
        (0x6122, State.STOPPING),
        (0x6009, State.FAULT),
    ],
)
def test_l4_states(word: int, state: State) -> None:
    assert t.ls_table(t.AUTHORITY).states.decode(word) is state


def test_l7_addresses() -> None:
    assert t.address("In-90") == 0x155A
    assert t.address("dr-03") == t.address("DR03") == t.address("DRV-3") == 0x1103
    assert t.address("COM-31") == t.address("CM-31") == 0x171F
    assert t.address("PRT-12") == 0x1B0C
    assert t.address("M2-4") == 0x1C04
    assert t.address("0h000A") == t.address("0x0a") == 0x000A
    assert t.address("Q-1") is None
    assert t.address("000A") is None
    assert t.code_of(0x1103) == "dr-03"
    assert t.code_of(0x000A) == "000A"


def test_l7_maps() -> None:
    status, control = paramap.MAPS
    assert status.parse("000A 000E dr-03 0x0F").codes == (0x000A, 0x000E, 0x1103, 0x000F)
    assert str(status.of((0x000A, 0x1103))) == "000A 1103"
    for table, text, room, says in (
        (status, "000A speed", 8, "'speed' is no address; write 000A"),
        (status, "0001 0002 0003", 2, "3 addresses, the telegram has room for 2"),
        (control, "000A", 4, r"000A \(Output frequency\) is read only"),
        (control, "0005 0x5", 4, "0005 twice: the last word would win"),
    ):
        with pytest.raises(ValueError, match=says):
            table.parse(text, room)
    assert control.parse("0005 0000 0000 dr-03", 4).codes == (0x0005, 0, 0, 0x1103)


def test_l9_trips_and_rates() -> None:
    assert t.trip_text(35) == "35 lost command"
    assert t.trip_text(64) == "64 cannot connect"
    assert t.trip_text(8) == "8 reserved"
    assert set(t.TRIPS) <= set(range(1, 65))
    assert t.BAUD_INDEX[6] == 1_500_000
    assert t.BAUD_INDEX[11] == 45_450
    assert set(t.BAUD_INDEX.values()) == set(DRIVE.baud_rates)


@pytest.mark.parametrize(
    ("number", "text"),
    [(0x00, "illegal parameter number"), (0x09, "no description"), (0x11, "operating mode"), (0x18, "inconsistent")],
)
def test_l6_error_texts(number: int, text: str) -> None:
    assert text in t.PKW.error_text(number)
    assert "without a text" in t.PKW.error_text(0x08)
