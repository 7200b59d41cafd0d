"""Drive plugins at the master: called in Operate, their defects their own, told of losses and new parameters."""

from __future__ import annotations

import pytest
from scripted_link import MS, ScriptedPlugin, exchanging, operating, setup

from dpstack.dp.master.commands import DriveCommand, Mode, ReparameteriseSlave, SetMode
from dpstack.dp.master.events import DriveEvent, SlaveState
from dpstack.errors import UsageError


def test_unit_runs_in_operate_only_and_its_defect_stays_its_own() -> None:
    bus = exchanging(setup(3, safe=b"\x00\x00\x00\x01"), setup(4))
    unit = ScriptedPlugin()
    bus.image.plugin = unit
    assert bus.hold()[0].data == bytes(4)
    bus.send(SetMode(Mode.OPERATE))
    assert bus.hold()[0].data == unit.outputs
    bus.send(DriveCommand(3, "start", {}, 7))
    bus.hold()
    results = [e.payload for e in bus.events_of(DriveEvent)]
    assert results == [{"type": "result", "token": 7, "ok": True, "value": "start"}]
    unit.error = ZeroDivisionError("by the test")
    made = bus.hold()
    assert made[0].data == b"\x00\x00\x00\x01"
    assert made[1].da == 4
    assert bus.faults(3) == ["plugin"]
    assert bus.state(3) is SlaveState.DATA_EXCHANGE
    bus.send(DriveCommand(3, "start", {}, 8))
    last = [e for e in bus.master.take_events() if isinstance(e, DriveEvent)][-1]
    assert last.payload["ok"] is False


@pytest.mark.parametrize(
    ("outputs", "events"),
    [
        pytest.param(b"\x01", [], id="outputs of the wrong length"),
        pytest.param(bytes(4), [{"type": "status", "speed": object()}], id="an event that is no plain data"),
    ],
)
def test_a_defect_of_the_plugin(outputs: bytes, events: list[dict[str, object]]) -> None:
    bus = exchanging(setup(3))
    unit = ScriptedPlugin()
    unit.outputs, unit.events = outputs, events
    bus.image.plugin = unit
    bus.send(SetMode(Mode.OPERATE))
    assert bus.hold()[0].data == bytes(4)
    assert bus.faults(3) == ["plugin"]


def test_unit_is_told_when_the_slave_is_lost() -> None:
    bus = exchanging(setup(3))
    unit = ScriptedPlugin()
    bus.image.plugin = unit
    bus.slaves.clear()
    bus.hold()
    assert unit.losses == 1


def test_a_plugin_is_told_and_nothing_is_half_applied() -> None:
    bus = operating(setup(3))
    unit = bus.image.plugin = ScriptedPlugin()
    before = bus.master.handlers[3]
    with pytest.raises(UsageError, match="its drive plugin is made for 4 octets of inputs"):
        bus.send(ReparameteriseSlave(setup(3, config=b"\x10")))
    with pytest.raises(UsageError, match="no slave with address 9"):
        bus.send(ReparameteriseSlave(setup(9)))
    bus.run(10 * MS)
    assert bus.master.handlers[3] is before
    assert before.state is SlaveState.DATA_EXCHANGE
    assert unit.losses == 0
    bus.send(ReparameteriseSlave(setup(3, groups=(1,))))
    assert unit.losses == 1
    assert bus.image.plugin is unit
