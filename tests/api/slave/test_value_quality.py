"""The quality of values on a bus: what the diagnosis of a rack says about a named value, and when."""

from __future__ import annotations

import asyncio
import csv
from contextlib import AbstractAsyncContextManager
from pathlib import Path

import pytest
from api_kit import begun
from rack_kit import CONFIG, LINE_BREAK, Rack, device, rack

import dpstack
from dpstack import AlarmType, Specifier
from dpstack.api.bus.bus import core_of
from dpstack.api.bus.events_json import event_json
from dpstack.api.slave.quality_events import QualityChanged
from dpstack.errors import SlaveFault, UsageError
from dpstack.plant.quality import Quality
from dpstack.slave import ModuleState, SlaveDescription, UserDiag, channel_block, identifier_block
from dpstack.trace import Severity

pytestmark = pytest.mark.virtual_time

DPV1_RACK = SlaveDescription(
    ident=0x1234, name="rack", configs=(CONFIG,), dpv1=True, alarms=("pull_plug", "diagnostic"), alarm_sequence=8
)


def dpv1_rack() -> AbstractAsyncContextManager[Rack]:
    return rack(DPV1_RACK, dpv1={"alarms": ["pull_plug", "diagnostic"], "alarm_mode": 3})


def qualities(slave: dpstack.Slave) -> dict[str, str]:
    """Those that are not good."""
    found = {name: slave.value(name).quality.value for name in slave}
    return {name: quality for name, quality in found.items() if quality != "good"}


async def told(bus: dpstack.Bus, slave: dpstack.Slave, **wanted: str) -> None:
    await core_of(bus).until_round(lambda: qualities(slave) == wanted, timeout=1)


async def test_a_broken_wire_makes_one_value_bad_and_goes_with_the_diagnosis() -> None:
    async with rack() as (bus, slave, served):
        assert qualities(slave) == {}
        assert slave.value("level").text == ""
        device(served).diag = UserDiag.of(identifier_block([2], 5), LINE_BREAK)
        await told(bus, slave, level="bad")
        found = slave.value("level")
        assert (found.quality, slave.quality("level")) == (Quality.BAD, Quality.BAD)
        assert found.text == "line break: slot 3, input channel 0"
        assert found.since_ns == slave.snapshot.diagnosis_ns
        assert not found.good
        # its number is still there, and the data of the slave arrive
        assert found.value == 0
        assert slave.inputs_valid
        assert slave.value("level", int) == 0
        device(served).diag = UserDiag()
        await told(bus, slave)


async def test_an_announced_diagnosis_makes_values_uncertain_until_it_is_read() -> None:
    seen: list[dict[str, str]] = []
    async with rack() as (bus, slave, served):
        seen.append(qualities(slave))
        device(served).diag = UserDiag.of(identifier_block([2], 5), LINE_BREAK)

        def look() -> bool:
            now = qualities(slave)
            if not seen or seen[-1] != now:
                seen.append(now)
            return now == {"level": "bad"}

        await core_of(bus).until_round(look, timeout=1)
    everything = dict.fromkeys(("door", "level", "flow", "valve", "setpoint"), "uncertain")
    assert seen == [{}, everything, {"level": "bad"}]


async def test_a_diagnosis_of_a_slot_and_of_nothing() -> None:
    async with rack() as (bus, slave, served):
        device(served).diag = UserDiag.of(identifier_block([4], 5))
        await told(bus, slave, setpoint="uncertain")
        assert slave.value("setpoint").text == "has a diagnosis: slot 5"
        device(served).diag = UserDiag.of(channel_block(20, 0, 6, input=True), fault=False)  # there is no slot 21
        await told(bus, slave)
        assert "slot 21" in slave.conspicuous
        device(served).diag = UserDiag.of(channel_block(20, 0, 6, input=True), LINE_BREAK)
        await told(bus, slave, level="bad")
        device(served).diag = UserDiag.of(channel_block(20, 0, 6, input=True))  # a fault, and nowhere else
        await told(bus, slave, **dict.fromkeys(slave, "uncertain"))
        assert (
            slave.value("door").text
            == "line break: slot 21, input channel 0 (unspecific); the configuration has slots 1 to 5"
        )
        device(served).diag = UserDiag(b"", fault=True)
        await told(bus, slave, **dict.fromkeys(slave, "uncertain"))
        device(served).diag = UserDiag.of(LINE_BREAK, overflow=True)
        await told(bus, slave, **dict.fromkeys(slave, "uncertain") | {"level": "bad"})
        device(served).diag = UserDiag(b"", stat=True)
        await told(bus, slave, **dict.fromkeys(slave, "bad"))


async def test_a_slave_that_is_lost_has_stale_values_and_a_new_diagnosis_afterwards() -> None:
    async with rack() as (bus, slave, served):
        device(served).diag = UserDiag.of(LINE_BREAK)
        await told(bus, slave, level="bad")
        await slave.deactivate()
        await told(bus, slave, **dict.fromkeys(slave, "stale"))
        assert slave.value("level").text.startswith("the slave is not in data exchange")
        device(served).diag = UserDiag()
        await slave.activate()
        await slave.ready()
        await told(bus, slave)


async def test_alarms_stand_until_their_slot_is_good() -> None:
    async with dpv1_rack() as (bus, slave, served):
        await served.alarm(AlarmType.DIAGNOSIS, 3, specifier=Specifier.APPEARS)
        await told(bus, slave, level="uncertain", flow="uncertain")
        assert slave.value("flow").text == "diagnosis alarm: slot 3"
        await served.alarm(AlarmType.DIAGNOSIS, 3, specifier=Specifier.DISAPPEARS_OTHERS)
        await bus.rotated(2)
        assert qualities(slave) == {"level": "uncertain", "flow": "uncertain"}
        await served.alarm(AlarmType.DIAGNOSIS, 3, specifier=Specifier.DISAPPEARS)
        await told(bus, slave)
        await served.alarm(AlarmType.PULL, 1)
        await told(bus, slave, door="bad")
        assert slave.value("door").text == "module pulled: slot 1"
        await served.alarm(AlarmType.PLUG, 1)
        await told(bus, slave)
        await served.alarm(AlarmType.PULL, 1)
        await told(bus, slave, door="bad")
        await slave.reparameterise(watchdog_ms=500)  # a new bring-up: the alarms of before are void
        await told(bus, slave)


async def test_a_module_status() -> None:
    async with dpv1_rack() as (bus, slave, served):
        states = (ModuleState.OK, ModuleState.OK, ModuleState.INVALID, ModuleState.WRONG, ModuleState.MISSING)
        served.module_status(states)
        await told(bus, slave, level="bad", flow="bad", valve="bad", setpoint="bad")
        assert slave.value("setpoint").text == "no module: slot 5"


async def test_a_program_that_waits_for_a_value_that_gets_bad() -> None:
    async with rack() as (_, slave, served):
        waiting = await begun(slave.until(lambda values: bool(values["level"] == 7)), 0.1)
        other = await begun(slave.until(lambda values: bool(values["flow"] == 7)), 0.1)
        device(served).diag = UserDiag.of(LINE_BREAK)
        with pytest.raises(SlaveFault, match=r"level is bad, nothing can wait for it: line break: slot 3, input chann"):
            await waiting
        assert not other.done()
        other.cancel()


async def test_events_of_a_value_whose_quality_changes() -> None:
    events: list[dpstack.Event] = []
    async with rack(events=events) as (bus, slave, served):
        device(served).diag = UserDiag.of(identifier_block([2], 5), LINE_BREAK)
        await told(bus, slave, level="bad")
        await asyncio.sleep(2)
        device(served).diag = UserDiag()
        await told(bus, slave)
        await asyncio.sleep(2)
    told_of = [event for event in events if isinstance(event, QualityChanged)]
    assert [event.text for event in told_of] == [
        "slave 9 (rack): level is bad (line break: slot 3, input channel 0)",
        "slave 9 (rack): level is good",
    ]
    assert [event.severity for event in told_of] == [Severity.ERROR, Severity.INFO]
    assert event_json(told_of[0], 1.5) == {
        "event": "quality",
        "t": 1.5,
        "address": 9,
        "name": "rack",
        "values": {"level": {"quality": "bad", "text": "line break: slot 3, input channel 0"}},
        "left_out": 0,
        "text": told_of[0].text,
    }


async def test_a_slave_that_flaps_a_diagnosis_has_bounded_events_and_the_quality_follows() -> None:
    events: list[dpstack.Event] = []
    seen: set[str] = set()
    async with rack(events=events) as (bus, slave, served):

        def look() -> bool:
            seen.add(slave.value("level").quality.value)
            device(served).diag = UserDiag() if seen_bad() else UserDiag.of(LINE_BREAK)
            return False

        def seen_bad() -> bool:
            return slave.value("level").quality is Quality.BAD

        with pytest.raises(TimeoutError):
            await core_of(bus).until_round(look, timeout=5)
        device(served).diag = UserDiag()
        await told(bus, slave)
        await asyncio.sleep(2)
    found = [event for event in events if isinstance(event, QualityChanged)]
    assert {"bad", "good"} <= seen
    assert 4 <= len(found) <= 8
    assert found[-1].values[0].quality is Quality.GOOD
    assert sum(event.left_out for event in found) > 20


async def test_readings_of_a_value() -> None:
    async with rack() as (bus, slave, served):
        found: list[tuple[object, str]] = []

        async def follow() -> None:
            async for one in slave.readings("level"):
                found.append((one.value, one.quality.value))  # noqa: PERF401 - it is cancelled

        task = await begun(follow(), 0.1)
        device(served).diag = UserDiag.of(LINE_BREAK)
        await told(bus, slave, level="bad")
        await asyncio.sleep(0.1)
        device(served).diag = UserDiag()
        await told(bus, slave)
        await asyncio.sleep(0.1)
        task.cancel()
        assert found == [(0, "good"), (0, "uncertain"), (0, "bad"), (0, "good")]
        with pytest.raises(UsageError, match="no input is called"):
            await anext(slave.readings("nothing"))


async def test_a_recording_keeps_the_number_of_a_bad_value_only_beside_its_quality(tmp_path: Path) -> None:
    rows: dict[bool, list[dict[str, str]]] = {}
    for quality in (False, True):
        path = tmp_path / f"{quality}.csv"
        async with rack() as (bus, slave, served), bus.record(path, quality=quality):
            await asyncio.sleep(0.1)
            device(served).diag = UserDiag.of(LINE_BREAK)
            await told(bus, slave, level="bad")
            await asyncio.sleep(0.1)
            await slave.deactivate()
            await asyncio.sleep(1)
        with path.open(encoding="utf-8") as file:
            rows[quality] = list(csv.DictReader(file))
    values = [row["rack.level"] for row in rows[False] if row["rack.state"] == "data_exchange"]
    assert (values[0], values[-1]) == ("0", "")
    seen = list(dict.fromkeys((row["rack.level"], row["rack.level quality"]) for row in rows[True]))
    assert [one for one in seen if one[1]] == [("0", "good"), ("0", "uncertain"), ("0", "bad"), ("", "stale")]
    assert {row["rack.valve quality"] for row in rows[True][:-1]} == {"good", "uncertain", "stale"}


async def test_a_status_octet_and_a_float_that_is_no_number() -> None:
    names = {"inputs": {"p": {"at": "f32@0", "status": "u8@4", "quality": "pa-classic"}, "raw": "f32@0"}}
    pa = SlaveDescription(ident=0x1234, name="pa", configs=(bytes.fromhex("94 A4"),))
    async with rack(pa, **names, outputs={}) as (bus, slave, _):

        async def got(octets: str) -> list[tuple[str, str]]:
            slave.outputs = bytes.fromhex(octets)
            await core_of(bus).until_round(lambda: slave.inputs == slave.outputs, timeout=1)
            return [(slave.value(name).quality.value, slave.value(name).text) for name in ("p", "raw")]

        assert await got("3F800000 80") == [("good", ""), ("good", "")]
        assert await got("3F800000 10") == [("bad", "sensor failure (status 10)"), ("good", "")]
        assert await got("3F800000 52") == [
            ("uncertain", "sensor conversion not accurate, high limit (status 52)"),
            ("good", ""),
        ]
        assert await got("3F800000 A4") == [("good", "maintenance required (status A4)"), ("good", "")]
        nan = "not a number (NaN or infinite)"
        assert await got("7FC00000 80") == [("bad", nan), ("bad", nan)]


async def test_why_says_what_the_diagnosis_reports_and_what_to_do() -> None:
    async with rack() as (bus, slave, served):
        assert (await bus.why(9, ask=False)).first.cause == "healthy"
        device(served).diag = UserDiag.of(LINE_BREAK)
        await told(bus, slave, level="bad")
        first = (await bus.why(9, ask=False)).first
        assert first.cause == "own_diagnosis"
        assert first.meaning == "the slave is in data exchange, and reports: line break: slot 3, input channel 0"
        assert first.next == "check wire, terminal and sensor of this channel"
        assert slave.value("level").remedy == first.next


async def test_live_stream_and_summary_have_the_same() -> None:
    async with rack() as (bus, slave, served):
        device(served).diag = UserDiag.of(identifier_block([2], 5), LINE_BREAK)
        await told(bus, slave, level="bad")
        async for item in bus.live():
            if "snapshot" in item:
                values = item["snapshot"]["slaves"]["9"]
                break
        assert values["quality"] is None
        bad = values["qualities"]["level"]
        assert (bad["quality"], bad["reason"]) == ("bad", "channel_fault")
        assert bad["text"] == "line break: slot 3, input channel 0"
        assert values["qualities"].keys() == {"level"}
        (doubt,) = values["doubts"]
        assert (doubt["slot"], doubt["channel"], doubt["direction"], doubt["quality"]) == (3, 0, "input", "bad")
        assert (values["level"], values["inputs_valid"]) == ("error", True)
        assert values["remark"] == {"text": "line break: slot 3, input channel 0", "severity": "error"}
