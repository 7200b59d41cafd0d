"""Fuji: what stands in the table and in the registry, and what is made up (docs/reference/drives/fuji.md)."""

from __future__ import annotations

import pytest

from dpstack.gsd.identifiers import io_lengths
from dpstack.profile import State
from dpstack_drives.fuji import DRIVE
from dpstack_drives.fuji import table as t


def test_facts_and_what_is_made_up() -> None:
    assert DRIVE.ident == 0xDD04
    assert DRIVE.ident_made_up
    assert DRIVE.user_prm == b""
    assert not DRIVE.max_tsdr
    for name, octets in (("PPO1", 12), ("PPO2", 20), ("PPO3", 4), ("PPO4", 12)):
        spec = DRIVE.telegram(name)
        assert spec.made_up
        assert io_lengths(spec.config) == (octets, octets)
        assert (spec.output_octets, spec.input_octets) == (octets, octets)
    assert DRIVE.core("fan", "PPO3").safe_outputs.hex() == "047e0000"
    assert DRIVE.core("fan", "PPO1").safe_outputs.hex() == "0000000000000000047e0000"


@pytest.mark.parametrize(
    ("o30", "name"),
    [(0, "PPO1"), (1, "PPO1"), (6, "PPO1"), (255, "PPO1"), (2, "PPO2"), (5, "PPO2"), (3, "PPO3"), (4, "PPO4")],
)
def test_f1_o30_chooses_and_another_telegram_is_a_configuration_fault(o30: int, name: str) -> None:
    device = DRIVE.device("PPO3", {"o30": o30})
    for other in DRIVE.telegrams.values():
        assert (device.check_cfg(other.config) is None) == (other.name == name)
    assert device.configs[0] == DRIVE.telegrams[name].config


def test_f1_the_reason_names_o30() -> None:
    assert "o30 is 3" in str(DRIVE.device("PPO3").check_cfg(b"\xf3\x71"))


@pytest.mark.parametrize(
    ("word", "state"),
    [
        (0x0240, State.SWITCH_ON_INHIBITED),
        (0x0270, State.SWITCH_ON_INHIBITED),
        (0x0231, State.READY_TO_SWITCH_ON),
        (0x0233, State.READY),
        (0x0237, State.RUNNING),
        (0x0737, State.RUNNING),
        (0x0278, State.FAULT),
        (0x0248, State.FAULT),
        (0x0000, State.UNKNOWN),
    ],
)
def test_f2_states(word: int, state: State) -> None:
    assert t.TABLE.states.decode(word) is state


def test_f2_s5_is_told_apart_by_ones_own_command() -> None:
    assert t.TABLE.state(0x0233, 0x047E) is State.STOPPING
    assert t.TABLE.state(0x0233, 0x047F) is State.READY
    assert t.TABLE.state(0x0237, 0x047E) is State.STOPPING


def test_f9_alarm_names() -> None:
    (only,) = t.alarms(0x7511)
    assert only.text == "Er5 field bus communications error"
    assert [alarm.keypad for alarm in t.alarms(0x4310)] == ["OH1", "OH4"]
    assert [alarm.keypad for alarm in t.alarms(0x7520)] == ["Er2", "ErP"]
    assert t.alarms(0x1234) == []


def test_f13_addresses() -> None:
    assert t.address("F26") == (0x104, 0x1A)
    assert t.address("y98") == (0x10F, 0x62)
    assert t.address("o30") == (0x10A, 30)
    assert t.address("H03") == (0x108, 3)
    assert t.address("Q1") is None
    assert t.address("F999") is None
    assert t.address("412") is None
