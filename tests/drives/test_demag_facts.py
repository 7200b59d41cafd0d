"""Demag: facts of the GSD file, state and command tables, readings of status words (docs/reference/drives/demag.md)."""

from __future__ import annotations

import pytest

from dpstack.errors import ConfigError
from dpstack.gsd.identifiers import io_lengths
from dpstack.profile import State, drivecom_states
from dpstack.profile.model.drivecom_states import TRANSITIONS, Command, DrivecomMachine, command
from dpstack_drives.demag import DRIVE


def test_d1_gsd_facts() -> None:
    assert DRIVE.ident == 0x0696
    assert not DRIVE.ident_made_up
    assert DRIVE.user_prm.hex() == "00" * 16
    assert DRIVE.min_slave_interval_ns == 100_000
    assert DRIVE.fail_safe
    assert len(DRIVE.baud_rates) == 10
    assert 31_250 not in DRIVE.baud_rates
    assert [DRIVE.max_tsdr[baud] for baud in sorted(DRIVE.max_tsdr)] == [60, 60, 250, 60, 60, 100, 150, 250, 450, 800]
    assert DRIVE.max_tsdr[45_450] == 250
    assert {name: spec.config.hex(" ").upper() for name, spec in DRIVE.telegrams.items()} == {
        "PPO1": "F3 71",
        "PPO2": "F3 75",
        "PPO3": "71",
        "PPO4": "75",
    }
    assert DRIVE.default_telegram == "PPO1"


@pytest.mark.parametrize(("name", "octets"), [("PPO1", 12), ("PPO2", 20), ("PPO3", 4), ("PPO4", 12)])
def test_d2_lengths_follow_from_the_identifiers(name: str, octets: int) -> None:
    spec = DRIVE.telegram(name)
    assert (spec.output_octets, spec.input_octets) == (octets, octets)
    assert io_lengths(spec.config) == (octets, octets)
    assert len(DRIVE.core("hoist", name).safe_outputs) == octets
    device = DRIVE.device("PPO1")
    assert device.check_cfg(spec.config) is None
    device.enter(spec.config, 0)
    assert len(device.exchange(bytes(octets), 1)) == octets


def test_a_configuration_it_does_not_have_is_refused() -> None:
    device = DRIVE.device()
    assert device.configs[0] == b"\xf3\x71"
    reason = device.check_cfg(b"\xf3\x79")
    assert reason is not None
    assert "f3 79" in reason


def test_user_parameters() -> None:
    device = DRIVE.device()
    assert device.check_prm(bytes(16)) is None
    assert device.check_prm(bytes(19)) is None
    assert "16" in str(device.check_prm(b""))
    assert "0" in str(device.check_prm(bytes(16) + b"\x01"))


# word, state: every row of the table, bits 7-15 and (mask 4F) bit 5 set or not, bit 4 always ignored
ROWS = [
    (0x0000, State.NOT_READY),
    (0x0020, State.NOT_READY),
    (0x0040, State.SWITCH_ON_INHIBITED),
    (0x0260, State.SWITCH_ON_INHIBITED),
    (0x0221, State.READY_TO_SWITCH_ON),
    (0x0223, State.READY),
    (0x0627, State.RUNNING),
    (0x86A7, State.RUNNING),
    (0x06B7, State.RUNNING),
    (0x0207, State.QUICK_STOP),
    (0x0008, State.FAULT),
    (0x6228, State.FAULT),
    (0x020F, State.FAULT_REACTION),
    (0x022F, State.FAULT_REACTION),
    (0x0001, State.UNKNOWN),
    (0x0047, State.UNKNOWN),
    (0x0003, State.UNKNOWN),
]


@pytest.mark.parametrize(("word", "state"), ROWS)
def test_d7_states(word: int, state: State) -> None:
    assert drivecom_states.STATES.decode(word) is state
    assert drivecom_states.STATES.decode(word ^ 0x0010) is state  # bit 4 is in no row
    assert drivecom_states.STATES.decode(word ^ 0xFF80) is state  # nor are bits 7 to 15


@pytest.mark.parametrize(
    ("word", "expected"),
    [
        (0x06, Command.SHUTDOWN),
        (0x0E, Command.SHUTDOWN),
        (0x07, Command.OPERATION_INHIBIT),
        (0x0F, Command.OPERATION_ENABLE),
        (0xF00F, Command.OPERATION_ENABLE),
        (0x00, Command.VOLTAGE_INHIBIT),
        (0x0D, Command.VOLTAGE_INHIBIT),
        (0x02, Command.QUICK_STOP),
        (0x0B, Command.QUICK_STOP),
    ],
)
def test_d7_commands(word: int, expected: Command) -> None:
    assert command(word) is expected


# number, state before, control word, state after: one row for every transition by command
STEPS = [
    (2, State.SWITCH_ON_INHIBITED, 0x06, State.READY_TO_SWITCH_ON),
    (3, State.READY_TO_SWITCH_ON, 0x07, State.READY),
    (3, State.READY_TO_SWITCH_ON, 0x0F, State.READY),
    (4, State.READY, 0x0F, State.RUNNING),
    (5, State.RUNNING, 0x07, State.READY),
    (6, State.READY, 0x06, State.READY_TO_SWITCH_ON),
    (7, State.READY_TO_SWITCH_ON, 0x00, State.SWITCH_ON_INHIBITED),
    (8, State.RUNNING, 0x06, State.READY_TO_SWITCH_ON),
    (9, State.RUNNING, 0x00, State.SWITCH_ON_INHIBITED),
    (10, State.READY, 0x00, State.SWITCH_ON_INHIBITED),
    (11, State.RUNNING, 0x02, State.QUICK_STOP),
    (12, State.QUICK_STOP, 0x00, State.SWITCH_ON_INHIBITED),
    (0, State.SWITCH_ON_INHIBITED, 0x0F, State.RUNNING),
]


@pytest.mark.parametrize(("number", "before", "control", "after"), STEPS)
def test_d7_transitions(number: int, before: State, control: int, after: State) -> None:
    machine = DrivecomMachine()
    machine.enter(before)
    machine.step(control, stops_at_once=True, ack_allowed=True, still=False)
    assert machine.state is after


def test_d7_no_other_transition_by_command() -> None:
    assert {(row[0], row[1]) for row in STEPS} == {(t.number, t.source) for t in TRANSITIONS}
    moving = {(before, command(control)) for _, before, control, _ in STEPS}
    for state in (
        State.SWITCH_ON_INHIBITED,
        State.READY_TO_SWITCH_ON,
        State.READY,
        State.RUNNING,
        State.QUICK_STOP,
    ):
        for control in range(16):
            if (state, command(control)) not in moving:
                machine = DrivecomMachine()
                machine.enter(state)
                machine.step(control, stops_at_once=True, ack_allowed=True, still=False)
                assert machine.state is state


def test_d7_transition_12_at_standstill_and_15_by_the_edge() -> None:
    machine = DrivecomMachine()

    def after(control: int) -> State:
        machine.step(control, stops_at_once=False, ack_allowed=True, still=True)
        return machine.state

    machine.enter(State.QUICK_STOP)
    assert after(0x02) is State.SWITCH_ON_INHIBITED
    assert after(0x80) is State.SWITCH_ON_INHIBITED
    machine.enter(State.FAULT)
    assert after(0x80) is State.FAULT  # no edge
    assert after(0x00) is State.FAULT
    assert after(0x80) is State.SWITCH_ON_INHIBITED


def test_telegrams_and_options_are_checked() -> None:
    with pytest.raises(ConfigError, match="PPO1, PPO2, PPO3, PPO4"):
        DRIVE.telegram("PPO5")
    assert DRIVE.telegram("ppo3").name == "PPO3"
    with pytest.raises(ConfigError, match="did you mean set_412"):
        DRIVE.core("x", "PPO1", {"set_411": True})
    with pytest.raises(ConfigError, match="true or false"):
        DRIVE.core("x", "PPO1", {"set_412": 1})
    with pytest.raises(ConfigError, match=r"outside 1\.\.1000"):
        DRIVE.core("x", "PPO1", {"reference_hz": 0})
    with pytest.raises(ConfigError, match="must be a number"):
        DRIVE.core("x", "PPO1", {"reference_hz": "50"})
    with pytest.raises(ConfigError, match=r"0\.\.44"):
        DRIVE.device("PPO3", {"412": 45})
    with pytest.raises(ConfigError, match="no option or parameter"):
        DRIVE.device("PPO3", {"4711": 1})
    with pytest.raises(ConfigError, match="must be a number"):
        DRIVE.device("PPO3", {"412": "one"})
