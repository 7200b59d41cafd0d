"""Literal items of the live stream for screen and fuzz targets: a plant with a drive, named values, and faults."""

from __future__ import annotations

from typing import Any

from verdicts_kit import verdicts

LONG = "[bold red]x[/] <b>\u202e\x1b[31m 🚀日本" + "long" * 50

Item = dict[str, Any]


def field(name: str, unit: str = "", at: str = "i16@0") -> dict[str, Any]:
    return {"name": name, "type": "i16", "at": at, "scale": 1, "offset": 0, "unit": unit}


def slave_plant(address: int, name: str, **more: Any) -> dict[str, Any]:
    found: dict[str, Any] = {
        "name": name, "address": address, "ident": "0x1234", "vendor": "Maker", "model": "Model", "gsd": None,
        "modules": [{"name": "2 AI", "config": "51", "inputs": 4, "outputs": 0}], "input_len": 4, "output_len": 2,
        "safe": "0000", "watchdog_ms": 200, "groups": [], "dpv1": False, "every": 1, "inputs": [], "outputs": [],
        "drive": None,
    }  # fmt: skip
    return found | more


def values(**more: Any) -> dict[str, Any]:
    found: dict[str, Any] = {
        "state": "data_exchange", "inputs": "00070022", "outputs": "0005", "held": None, "inputs_valid": True,
        "inputs_age_ms": 2.0, "fields": {}, "held_fields": None, "fault": None,
        "diagnosis": {"flags": ["wd_on"], "texts": []}, "conspicuous": "", "alarms": None, "drive": None,
        "exchanges": 100, "retries": 0, "timeouts": 0, "telegrams": 210, "late": 0, "wrong": 0, "bad": {},
        "watchdog_ms": 200, "master": None, "injected": [],
    }  # fmt: skip
    found |= more
    return found | verdicts(found)


def link(name: str, *, good: bool | None, text: str = "") -> dict[str, Any]:
    """A link to a publisher; without ``text`` its state is the name, too."""
    return {"publisher": 7, "name": name, "octets": "1:3", "to": 3, "good": good, "text": text or name}


def judged(**changes: Any) -> dict[str, Any]:
    """Changes of a slave with the verdicts on them."""
    return changes | verdicts(changes)


DRIVE = {
    "state": "fault", "running": False, "reached": False, "remote": True, "setpoint": 0.5, "speed": 0.1234,
    "frequency_hz": 6.2, "speed_rpm": 185.1, "current": 0.42, "torque": None, "warnings": [],
    "faults": ["F2100 overload"], "words": ["0231"], "bits": ["fault"], "settings": "checked", "settings_texts": [],
}  # fmt: skip


def plant(slaves: dict[str, Any], **more: Any) -> Item:
    found: Item = {
        "version": 1, "started": 1763830000.0, "port": "/dev/ttyUSB0", "baud": 500000, "driver": "process",
        "address": 2, "read_only": False, "virtual": False, "paced": True, "config": "plant.toml", "parameters": {},
        "plan": {"rotation_us": {"min": 900, "typical": 1100, "max": 4000}, "cycle_us": None}, "slaves": slaves,
    }  # fmt: skip
    return {"plant": found | more}


def bus(**more: Any) -> dict[str, Any]:
    found: dict[str, Any] = {
        "mode": "operate", "in_ring": True, "masters": [2], "clear": None, "rotations": 500, "telegrams": 4711,
        "rotation_us": {"min": 900, "p50": 1130, "p99": 1302, "p999": 1990, "max": 4012}, "retries": 3, "timeouts": 0,
        "token_us": {"min": 900, "p50": 1130, "p99": 1302, "p999": 1990, "max": 4012}, "late": 0, "stray": 0,
        "bad": {}, "stale": False, "age_ms": 80.0, "histogram": [[1000, 20], [1200, 400], [4012, 1]],
    }  # fmt: skip
    return found | more


def snapshot(slaves: dict[str, Any], *, t: float = 5.0, whole: bool = True, **of_bus: Any) -> Item:
    return {"snapshot": {"t": t, "whole": whole, "bus": bus(**of_bus) if whole else of_bus, "slaves": slaves}}


def event(text: str, address: int | None = None, severity: str = "info", kind: str = "notice") -> Item:
    found = {"event": kind, "t": 1.0, "time": "2026-01-31T12:00:01.000Z", "severity": severity, "text": text}
    return {"event": found | ({} if address is None else {"address": address, "name": "n"})}


def some_plant() -> list[Item]:
    """Alive with names and units, a drive with a fault, a lost one with old values, one with a hostile name."""
    named = {"inputs": [field("level", "bar", "i16@2"), field("limit")], "outputs": [field("target")]}
    slaves = {
        "3": slave_plant(3, "valves", **named),
        "4": slave_plant(4, "hoist", drive={"profile": "demag-dedrive", "telegram": "PPO1", "reference_rpm": 1500}),
        "8": slave_plant(8, "tank", **named),
        "125": slave_plant(125, LONG),
    }
    now = {
        "3": values(fields={"level": 3.4, "limit": True, "target": 5}, retries=3),
        "4": values(drive=DRIVE),
        "8": values(
            state="fault", inputs_valid=False, inputs_age_ms=3200.0,
            fields={"level": 9.75, "limit": False, "target": 0},
            fault={"kind": "cfg", "text": "Chk_Cfg refused: module 2"}, conspicuous="cfg_fault",
            diagnosis={"flags": ["cfg_fault"], "texts": ["module 2 [red]missing[/]"]},
        ),
        "125": values(conspicuous=LONG, held="0005", outputs="0000", links=[link(LONG, good=False)]),
    }  # fmt: skip
    events = [event("master: operate"), event(f"slave 125 ({LONG})", 125, "warning")]
    return [plant(slaves), *events, snapshot(now)]


BREAK = "line break: slot 3 (2 AI), input channel 0"
INVALID = "data invalid: slot 3 (2 AI)"


def doubt(channel: int | None, quality: str, reason: str, text: str) -> dict[str, Any]:
    return {"slot": 3, "channel": channel, "direction": "input", "quality": quality, "reason": reason, "text": text,
            "since": 4.5}  # fmt: skip


def rack_plant(**more: Any) -> list[Item]:
    """A rack whose wire at slot 3, channel 0 is broken, as the program of a bus shows it; another slave."""
    modules = [
        {"slot": 1, "name": "8 DI", "config": "10", "inputs": 1, "input_at": 0, "input_width": 1, "outputs": 0},
        {"slot": 2, "name": "8 DO", "config": "20", "inputs": 0, "outputs": 1, "output_at": 0, "output_width": 1},
        {"slot": 3, "name": "2 AI", "config": "51", "inputs": 4, "input_at": 1, "input_width": 16, "outputs": 0},
        {"slot": 4, "name": "2 AI", "config": "51", "inputs": 4, "input_at": 5, "input_width": 16, "outputs": 0},
    ]
    rack = slave_plant(
        8, "boiler rack", modules=modules, input_len=9, output_len=1, gsd="io-station",
        inputs=[
            field("limit", at="bool@0.0") | {"type": "bool", "slot": 1},
            field("level", "m", "i16@1") | {"slot": 3, "channel": 0},
            field("pressure", "bar", "i16@3") | {"slot": 3},
            field("temperature", "°C", "i16@5") | {"slot": 4},
        ],
        outputs=[field("inlet", at="bool@0.1") | {"type": "bool", "slot": 2}],
    )  # fmt: skip
    broken = values(
        inputs="01014004e2032f0000", outputs="02",
        fields={"limit": True, "level": 3.2, "pressure": 1.25, "temperature": 81.5, "inlet": True},
        diagnosis={"flags": ["ext_diag", "wd_on"], "texts": ["slot 3 (2 AI), input channel 0 (word): line break"]},
        conspicuous="ext_diag; slot 3 (2 AI), input channel 0 (word): line break",
        doubts=[doubt(0, "bad", "channel_fault", BREAK), doubt(None, "uncertain", "slot_fault", INVALID)],
        qualities={
            "level": {"quality": "bad", "reason": "channel_fault", "text": BREAK, "since": 4.5},
            "pressure": {"quality": "uncertain", "reason": "slot_fault", "text": INVALID, "since": 4.5},
        },
    )  # fmt: skip
    given = plant({"8": rack | more, "9": slave_plant(9, "other")})
    return [given, snapshot({"8": broken, "9": values()})]
