"""Names and alarms of EPICS: process variables of a plant, names that are too long, the alarm of each reason."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pytest
from caproto import AlarmSeverity, AlarmStatus

from dpstack.bridge.epics import alarms
from dpstack.bridge.epics.names import PvNames, check_lengths, check_prefix, pvs_of
from dpstack.bridge.epics.server import beacon_address
from dpstack.bridge.epics.variables import cut, states_of
from dpstack.bridge.orders import is_allowed
from dpstack.errors import ConfigError
from dpstack.plant.items import DrivePlant, FieldPlant, Plant, SlavePlant
from dpstack.plant.judge import STATES
from dpstack.plant.nodes import DRIVE_STATES, Described, Kind, Node, bus_of, digits_of, slave_of
from dpstack.plant.quality import Reading, Reason

BUS = bus_of(Plant(slaves={})).nodes
VALVES = SlavePlant(
    name="Füll 1",
    inputs=[FieldPlant(name="level.raw", at="i16@0"), FieldPlant(name="level:raw", at="i16@2")],
    outputs=[FieldPlant(name="lamp", at="bool@0.0")],
)
HOIST = SlavePlant(name="hoist", drive=DrivePlant())


def _pvs_of(prefix: str, bus: Sequence[Node], slaves: Mapping[int, Described], *allow: str) -> PvNames:
    return pvs_of(prefix, bus, slaves, lambda order: is_allowed(allow, order.name))


def test_names_have_prefix_slave_group_and_value_and_each_changed_one_is_reported() -> None:
    slaves = {8: slave_of(8, VALVES, writable=True), 9: slave_of(9, HOIST, writable=True)}
    slaves[10] = slave_of(10, SlavePlant(name="bus"), writable=True)
    found = _pvs_of("LAB:", BUS, slaves, "hoist.*")
    assert {
        "LAB:bus:mode", "LAB:bus:in_ring", "LAB:bus:stat:token_us:p99", "LAB:F_ll_1:state", "LAB:F_ll_1:in:level_raw",
        "LAB:F_ll_1:out:lamp", "LAB:F_ll_1:stat:exchanges", "LAB:hoist:drive:speed", "LAB:hoist:cmd:quick_stop",
        "LAB:hoist:cmd:speed", "LAB:bus_slave_10:state",
    } <= found.pvs.keys()  # fmt: skip
    assert found.too_long == ()
    assert found.changed == (
        "'Füll 1' (slave 8) is called 'F_ll_1': EPICS does not permit this name",
        "'bus' (slave 10) is called 'bus_slave_10': another one has this name",
        "'level.raw' (slave/8/input/level.raw) is called 'level_raw': EPICS does not permit this name",
        "'level:raw' (slave/8/input/level:raw) is called 'level_raw_slave_8_input_level_raw': "
        "another one has this name",
    )
    order = found.pvs["LAB:hoist:cmd:speed"].order
    assert order is not None
    assert order.name == "hoist.speed"
    assert states_of(found.pvs["LAB:hoist:cmd:stop"]) == ("idle", "stop")
    found = _pvs_of("LAB:", BUS, slaves, "hoist.stop")
    assert [name for name in found.pvs if ":cmd:" in name] == ["LAB:hoist:cmd:stop"]


def test_a_name_that_is_too_long_is_one_line_and_is_not_cut() -> None:
    name = "e" * 40
    slaves = {8: slave_of(8, SlavePlant(name="s" * 10, inputs=[FieldPlant(name=name, at="u8@0")]), writable=True)}
    fits = _pvs_of("P" * 5 + ":", BUS, slaves)
    assert "PPPPP:ssssssssss:in:" + name in fits.pvs
    assert len("PPPPP:ssssssssss:in:" + name) == 60
    check_lengths(fits)
    too_long = _pvs_of("P" * 6 + ":", BUS, slaves)
    with pytest.raises(ConfigError) as caught:
        check_lengths(too_long)
    assert str(caught.value) == (
        f"PPPPPP:ssssssssss:in:{name} has 61 characters, and an EPICS name at most 60; "
        f"give a shorter prefix, slave or value name"
    )


@pytest.mark.parametrize("prefix", ["LAB DP:", "LÄB:", "a.b", "p" * 41, "$(P)"])
def test_a_prefix_that_is_no_begin_of_a_name_is_refused(prefix: str) -> None:
    with pytest.raises(ConfigError, match=r"^prefix .* cannot begin an EPICS name; write at most 40 of letters"):
        check_prefix(prefix)


def test_addresses_of_beacons() -> None:
    assert beacon_address("192.168.7.255") == ("192.168.7.255", 5065)
    assert beacon_address("10.0.0.1:6000") == ("10.0.0.1", 6000)
    for text in ("", "lab", "10.0.0.1:0", "10.0.0.1:x", "::1"):
        with pytest.raises(ConfigError, match=r"^beacons: .* is not an address; write"):
            beacon_address(text)


@pytest.mark.parametrize("reason", list(Reason))
def test_the_severity_follows_the_quality(reason: Reason) -> None:
    level = slave_of(8, VALVES, writable=True).nodes[-2]
    assert level.kind is Kind.VALUE
    status, severity = alarms.of_reading(level, Reading(5, reason, 1.0))
    wanted = {"good": 0, "uncertain": 1, "stale": 3, "bad": 3}  # NO_ALARM, MINOR, INVALID of alarm.h
    assert severity == wanted[reason.quality.value]
    assert (status == AlarmStatus.NO_ALARM) == (severity == 0)
    # without a value nothing is better than INVALID
    assert alarms.of_reading(level, Reading(None, reason, 1.0)).severity is AlarmSeverity.INVALID_ALARM


def test_states_and_texts_that_somebody_should_look_at_are_alarms() -> None:
    nodes = {(node.kind, node.keys[-1]): node for one in (BUS, slave_of(9, HOIST, writable=True).nodes) for node in one}
    assert nodes.keys() >= alarms.TEXTS.keys()

    def severity(kind: Kind, key: str, value: object) -> int:
        return int(alarms.of_value(nodes[kind, key], value))

    assert {state: severity(Kind.SLAVE, "state", state) for state in STATES} == {
        "offline": 1, "diagnosis": 1, "set_prm": 1, "chk_cfg": 1, "wait_ready": 1, "data_exchange": 0, "fault": 2,
        "deactivated": 1, "unknown": 1,
    }  # fmt: skip
    assert [state for state in DRIVE_STATES if severity(Kind.DRIVE, "state", state)] == ["fault_reaction", "fault"]
    assert severity(Kind.DRIVE, "state", "fault") == 2
    assert [severity(Kind.BUS, "mode", mode) for mode in ("operate", "clear", "offline")] == [0, 1, 1]
    assert [severity(kind, key, "x") for kind, key in alarms.TEXTS] == [2, 1, 2, 1, 2]
    assert [severity(kind, key, "") for kind, key in alarms.TEXTS] == [0] * 5


def test_texts_units_and_digits_fit_channel_access() -> None:
    assert cut("m³/h über", 7) == "m³/h "
    for scale, offset, band, digits in (
        (0.1, 0, 0, 1),
        (0.25, 0.5, 0, 2),
        (1e-9, 0, 0, 6),
        (10, 0, 0, 0),
        (1, 0, 0.05, 2),
    ):
        field = FieldPlant(name="x", at="f32@0", scale=scale, offset=offset, dead_band=band)
        assert digits_of(slave_of(8, SlavePlant(inputs=[field]), writable=True).nodes[-1], 3) == digits
