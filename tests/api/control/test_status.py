"""``ctl status``: the outputs of the slaves, the masters in the ring, and everything injected from outside."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from api_kit import RAW, bench_of, bus_of, device_of, in_virtual_time

from dpstack.api.bus.events_json import event_json
from dpstack.api.control.control_server import ControlServer
from dpstack.api.control.handlers import control_run, run_status
from dpstack.api.control.simulation_handlers import control_segment
from dpstack.api.injected import Injected
from dpstack.api.slave_side.simulation import Segment, sim_event_json
from dpstack.cli.commands import ctl
from dpstack.dp.master.commands import Mode
from dpstack.errors import BusError, SlaveError, UsageError
from dpstack.units import ns_to_s

FAIL_SAFE: dict[str, object] = {
    "name": "brake",
    "address": 10,
    "ident": 0x1235,
    "config": "20 10",
    "fail_safe": True,
    "outputs": {"open": "bool@0.0"},
    "inputs": {"is_open": "bool@0.0"},
}
VALVE: dict[str, object] = {
    **RAW,
    "name": "valve",
    "address": 11,
    "outputs": {"open": "bool@0.0"},
    "inputs": {"is_open": "bool@0.0"},
}


def order(server: ControlServer, *words: str) -> object:
    """As the socket hands it over."""
    return server._handlers[words[0]](list(words[1:]))


def shown(result: object, capsys: pytest.CaptureFixture[str]) -> list[str]:
    ctl._show(result)
    return capsys.readouterr().out.splitlines()


# --- outputs and masters -------------------------------------------------------------------------------------------


@in_virtual_time
async def test_in_clear_it_shows_the_outputs_that_the_slave_has(capsys: pytest.CaptureFixture[str]) -> None:
    async with bus_of(RAW, FAIL_SAFE, VALVE) as bus:

        def told(address: int) -> dict[str, Any]:
            slaves: Any = run_status(bus)["slaves"]
            keys = ("inputs", "outputs", "held", "fields", "held_fields")
            return {key: value for key, value in slaves[str(address)].items() if key in keys}

        await bus.ready()
        bus.slave("raw").outputs = b"\xa5"
        bus.slave("brake")["open"] = True
        bus.slave("valve")["open"] = True
        await bus.rotated(bus.stats.rotations + 5)
        assert bus.mode is Mode.CLEAR
        assert told(9) == {"inputs": "00", "outputs": "00", "held": "a5"}
        nothing = {"inputs": "00", "outputs": "", "held": "01", "held_fields": {"open": True}}
        assert told(10) == {**nothing, "fields": {"is_open": False, "open": None}}
        zeros = {"inputs": "00", "outputs": "00", "held": "01", "held_fields": {"open": True}}
        assert told(11) == {**zeros, "fields": {"is_open": False, "open": False}}
        assert "    outputs: none" in shown(run_status(bus), capsys)
        await bus.operate()
        await bus.rotated(bus.stats.rotations + 5)
        assert told(9) == {"inputs": "a5", "outputs": "a5"}
        assert told(10) == {"inputs": "01", "outputs": "01", "fields": {"is_open": True, "open": True}}
        bench_of(bus).power(9, False)
        await bus.until(lambda: not bus.slave(9).ready_now, 5)
        assert (told(9)["outputs"], told(9)["held"]) == ("", "a5")
        await bus.clear()
        await bus.rotated(bus.stats.rotations + 5)
        assert told(11)["outputs"] == "00"


@in_virtual_time
async def test_outputs_that_are_set_in_clear_wait_for_operate_unless_they_are_for_now() -> None:
    async with bus_of(RAW, VALVE) as bus:
        run = control_run(bus, "virtual")

        async def answer(*words: str) -> Any:
            result: Any = order(run, *words)
            return await result

        await bus.ready()
        operate = "call operate() first (of a run: dpstack ctl virtual operate)"
        because = f"the bus is in Clear, nothing reaches valve: {operate}"
        assert bus.slave("valve").held_because == because
        assert await answer("set", "valve.open=on") == {"held": {"valve": f"held until operate: {because}"}}
        assert set((await answer("outputs", "raw=01", "valve=01"))["held"]) == {"raw", "valve"}
        with pytest.raises(BusError, match=r"^the bus is in Clear, nothing reaches valve: "):
            await answer("set", "now", "valve.open=off")
        with pytest.raises(BusError, match=r"^the bus is in Clear, nothing reaches raw: "):
            await answer("outputs", "now", "raw=02", "valve=00")
        assert (bus.slave("raw").outputs, bus.slave("valve").outputs) == (b"\x01", b"\x01")
        await bus.operate()
        assert bus.slave("valve").held_because is None
        assert [await answer("set", *now, "valve.open=off") for now in ((), ("now",))] == [None, None]
        bench_of(bus).power(9, False)
        await bus.until(lambda: not bus.slave(9).ready_now, 5)
        # nothing of an order takes effect where a part of it is refused
        with pytest.raises(SlaveError, match=r"^slave 9 is not in data exchange: ") as refused:
            await answer("outputs", "now", "valve=01", "raw=02")
        assert refused.value.address == 9
        assert bus.slave("valve").outputs == b"\x00"
        held = await answer("outputs", "valve=01", "raw=02")
        assert held["held"]["raw"].startswith("held until data exchange: slave 9 is not in data exchange: ")
        assert set(held["held"]) == {"raw"}
        for words in (("set", "now"), ("outputs", "now")):
            with pytest.raises(UsageError, match=r"^'now' is not SLAVE"):
                await answer(*words)


@in_virtual_time
async def test_masters_are_stations_and_no_count(capsys: pytest.CaptureFixture[str]) -> None:
    async with bus_of(RAW) as bus:
        await bus.ready()
        status = run_status(bus)
        assert (status["address"], status["masters"]) == (2, [2])
        assert "masters: station 2 (this one)" in shown(status, capsys)
    assert shown({"address": 2, "masters": [2, 5]}, capsys)[1] == "masters: station 2 (this one), station 5"


# --- done from outside ---------------------------------------------------------------------------------------------

DRIVES = [
    ("demag-dedrive", "F2100", {"telegram": "PPO1"}),
    ("fuji-frenic", "OL1", {"telegram": "PPO3", "ident": "ask"}),
    ("imo-hd2", "OL1", {"options": {"set_map": True, "map_outputs": "set_frequency", "map_inputs": "fault_code"}}),
    ("keb-f5", "E.OL", {}),
    ("ls-s100", "overcurrent", {}),
]


@pytest.mark.parametrize(("kind", "code", "keys"), DRIVES, ids=[one[0] for one in DRIVES])
@in_virtual_time
async def test_a_trip_stays_in_status_until_it_is_acknowledged(kind: str, code: str, keys: dict[str, Any]) -> None:
    drive_of = {"name": "it", "address": 3, "drive": kind, **keys}
    baud = 1_500_000 if kind == "imo-hd2" else 93_750  # which hears no other; at a low rate there is less to do
    async with bus_of(drive_of, baud=baud) as bus:
        server = control_run(bus, "virtual")
        bench = bench_of(bus)
        await bus.operate()
        await bus.ready()
        await bus.rotated(bus.stats.rotations + 30)
        assert bench.injected(3) == []
        order(server, "trip", "it", code)
        assert bench.injected(3) == [f"trip {code}"]
        drive = bus.drive("it")
        await bus.until(lambda: drive.status.state == "fault", 5)
        await bus.rotated(bus.stats.rotations + 30)
        assert bench.injected(3) == [f"trip {code}"]
        if kind == "demag-dedrive":  # it cannot be acknowledged before, nor while contacts control it
            await drive.write(412, 1)
            await asyncio.sleep(16)
        await drive.acknowledge()
        await bus.rotated(bus.stats.rotations + 30)
        assert bench.injected(3) == []


@in_virtual_time
async def test_a_run_on_virtual_tells_orders_and_keeps_them_in_status(capsys: pytest.CaptureFixture[str]) -> None:
    station = {"name": "io", "address": 8, "gsd": "io-station", "modules": ["8 DI", "8 DO", "2 AI"]}
    fan = {"name": "fan", "address": 4, "drive": "fuji-frenic", "telegram": "PPO3", "ident": "ask"}
    events: list[Injected] = []

    def on_event(event: object) -> None:
        if isinstance(event, Injected):
            events.append(event)

    async with bus_of(RAW, station, fan, on_event=on_event) as bus:
        server = control_run(bus, "virtual")
        await bus.ready()

        def injected(address: int) -> object:
            slaves: Any = run_status(bus)["slaves"]
            return slaves[str(address)].get("injected")

        load = device_of(bus, 4).motor.load
        for words in (
            "silence 9 2s",
            "warn 4 0080",
            "load fan 0.6",
            "release 4 off",
            "wire-break io 3 0 on",
            "pull 8 2",
        ):
            order(server, *words.split())
        assert injected(9) == ["silence for 2.0 s more"]
        assert injected(4) == ["warn 0080", "load 0.6", "release off"]
        assert injected(8) == ["pull 2", "wire-break 3 0 on"]
        assert "injected: warn 0080; load 0.6; release off" in "\n".join(shown(run_status(bus), capsys))
        await asyncio.sleep(1.5)
        assert injected(9) == ["silence for 0.5 s more"]
        await bus.slave(9).ready()
        assert injected(9) is None
        for words in (
            "silence 9",
            "warn 4 0",
            f"load 4 {load}",
            "release 4 on",
            "wire-break 8 3 0 off",
            "plug 8 2",
        ):
            order(server, *words.split())
        assert injected(9) == ["silence until resume"]
        assert (injected(4), injected(8)) == (None, None)
        order(server, "resume", "9")
        order(server, "power-off", "9")
        assert injected(9) == ["power-off"]
        order(server, "power-on", "9")
        assert injected(9) is None
        with pytest.raises(ValueError, match="is no alarm"):
            order(server, "trip", "4", "nonsense")
        assert injected(4) is None
        assert len(events) == 15
        assert events[0].text == "slave 9 (raw): silence 2s (dpstack ctl)"
        assert event_json(events[4], 0.25) == {
            "event": "injected",
            "t": 0.25,
            "address": 8,
            "name": "io",
            "command": "wire-break",
            "args": ["io", "3", "0", "on"],
            "text": "slave 8 (io): wire-break 3 0 on (dpstack ctl)",
        }
        assert sim_event_json(events[4], 0.25) == event_json(events[4], 0.25)


async def test_a_segment_tells_orders_and_keeps_them_in_status() -> None:
    events: list[Any] = []
    async with Segment(3) as segment:
        server = control_segment(segment, events.append)
        assert "injected" not in order(server, "status")  # type: ignore[operator]
        for words in ("noise 1e-4", "silence 0 5s", "silence 1"):
            order(server, *words.split())
        status: Any = order(server, "status")
        noise, first, second = status["injected"]
        assert noise == "noise 0.0001"
        assert first.startswith("station 0: silence for ")
        assert second == "station 1: silence until resume"
        with pytest.raises(UsageError, match="no station 7"):
            order(server, "silence", "7")
        for words in ("noise 0", "resume 0", "resume 1"):
            order(server, *words.split())
        assert "injected" not in order(server, "status")  # type: ignore[operator]
    assert [one.text for one in events] == [
        "the segment: noise 1e-4 (dpstack ctl)",
        "the segment: silence 0 5s (dpstack ctl)",
        "the segment: silence 1 (dpstack ctl)",
        "the segment: noise 0 (dpstack ctl)",
        "the segment: resume 0 (dpstack ctl)",
        "the segment: resume 1 (dpstack ctl)",
    ]
    text = "the segment: noise 1e-4 (dpstack ctl)"
    line = {"event": "injected", "t": 1.5, "command": "noise", "args": ["1e-4"], "text": text}
    assert events[0].as_dict(1.5) == line
    assert ns_to_s(events[0].t_ns) > 0
