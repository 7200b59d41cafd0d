"""A served page over literal items: a plant with drives, named values and hostile texts, and what its orders were."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterable
from datetime import UTC, datetime
from typing import Any, Final

from dpstack.web.rights import Rights
from dpstack.web.source import GivenItems, Kind
from dpstack.web.web_server import serve

#: t = 0 of the plant, seconds since 1970
STARTED: Final = 1_763_830_000.0
SECRET: Final = "a-secret-of-this-start"
SCRIPT: Final = "<script>alert(1)</script>"
IMAGE: Final = "<img src=x onerror=alert(2)>"
#: letters that turn the direction around
TURNED: Final = "\u202etxt.exe"
LONG: Final = "W" * 200
EMOJI: Final = "pump \U0001f468\u200d\U0001f527 \U0001f6a8"
STORY: Final[dict[str, Any]] = {
    "slave": "gate",
    "address": 15,
    "source": "run",
    "state": "fault",
    "steps": [
        {
            "t": 0.1,
            "asked": "Set_Prm",
            "sent": "b801020b0b0b00",
            "answered": "SC",
            "received": "",
            "text": "Set_Prm was acknowledged",
        },
        {
            "t": 0.2,
            "asked": "Chk_Cfg",
            "sent": "205110",
            "answered": "SC",
            "received": "",
            "text": "Chk_Cfg was acknowledged",
        },
    ],
    "causes": [
        {
            "cause": "module_order",
            "confidence": 0.92,
            "meaning": "the modules are the right ones in another order",
            "for": [f"the slave says {SCRIPT}"],
            "against": ["none"],
            "next": "change the order",
        },
    ],
}
RECORD: Final[dict[str, Any]] = {"slot": 1, "index": 47, "length": 5, "data": "3c623e00ff"}
IM: Final[dict[str, Any]] = {"im": {"0": {"manufacturer_id": 42, "order_id": IMAGE, "serial_number": "17"}}}
#: time-stamped events; the texts of the last one are hostile
STAMPS: Final[dict[str, Any]] = {
    "index": 103,
    "events": [
        {"time": "2026-11-29T02:30:00.120Z", "slot": 4, "signal": 15, "state": 1, "state_text": "active", "kind": 1,
         "kind_text": "change"},
        {"time": "2026-11-29T02:30:00.240Z", "slot": 4, "signal": 15, "state": 0, "state_text": "not active", "kind": 1,
         "kind_text": "change"},
        {"time": IMAGE, "slot": 0, "signal": 0, "state": 0, "state_text": SCRIPT, "kind": 133,
         "kind_text": f"buffer overrun {TURNED}"},
    ],
}  # fmt: skip
_VALUE: Final[dict[str, Any]] = {"name": f"ai1.{IMAGE}", "slot": 1, "index": 26, "type": SCRIPT, "access": "r"}
#: a process device of PROFIBUS PA whose every text is hostile
PROCESS_DEVICE: Final[dict[str, Any]] = {
    "asked": "show",
    "identity": {"maker": SCRIPT, "device": IMAGE, "serial": TURNED, "tag": LONG, "message": f"it says {SCRIPT}"},
    "diagnosis": {"category": "failure", "texts": [IMAGE], "extension_texts": [f"maker: {SCRIPT}"]},
    "write_protection": IMAGE,
    "directory": 1,
    "remarks": [f"the directory {IMAGE}"],
    "parameters": [
        {
            "name": "ai1",
            "kind": SCRIPT,
            "tag": IMAGE,
            "mode": SCRIPT,
            "target_mode": IMAGE,
            "alarms": SCRIPT,
            "slot": 1,
            "index": 16,
            "values": [
                {**_VALUE, "text": f"7 {SCRIPT}", "quality": "bad"},
                {**_VALUE, "unreadable": IMAGE},
            ],
        },
    ],
}


def slave_of(name: str, address: int, **more: Any) -> dict[str, Any]:
    """One slave of the item ``plant``."""
    return {
        "name": name,
        "address": address,
        "ident": "0x0B0B",
        "vendor": "Nobody",
        "model": "750-333",
        "gsd": "island.gsd",
        "modules": [
            {"slot": 1, "name": "8 DI", "config": "10", "inputs": 1, "input_at": 0, "input_width": 1, "outputs": 0},
            {"slot": 2, "name": "8 DO", "config": "20", "inputs": 0, "outputs": 1, "output_at": 0, "output_width": 1},
        ],
        "input_len": 1,
        "output_len": 1,
        "safe": "00",
        "watchdog_ms": 200,
        "groups": [],
        "dpv1": True,
        "every": 1,
        "inputs": [],
        "outputs": [],
        "drive": None,
        **more,
    }


def values_of(**more: Any) -> dict[str, Any]:
    """The values of one slave in a whole snapshot."""
    return {
        "state": "data_exchange",
        "inputs": "01",
        "outputs": "02",
        "held": None,
        "inputs_valid": True,
        "inputs_age_ms": 2.0,
        "fields": {},
        "held_fields": None,
        "fault": None,
        "diagnosis": {"flags": ["wd_on"], "texts": []},
        "conspicuous": "",
        "alarms": None,
        "drive": None,
        "exchanges": 1000,
        "retries": 0,
        "timeouts": 0,
        "telegrams": 2000,
        "late": 0,
        "wrong": 0,
        "bad": {},
        "watchdog_ms": 200,
        "master": None,
        "injected": [],
        **more,
    }


def drive_of(**more: Any) -> dict[str, Any]:
    """The status of a drive."""
    return {
        "state": "running",
        "running": True,
        "reached": True,
        "remote": True,
        "setpoint": 0.5,
        "speed": 0.5,
        "frequency_hz": 25.0,
        "current": 0.4,
        "torque": None,
        "warnings": [],
        "faults": [],
        "words": ["0237"],
        "bits": [],
        "settings": "checked",
        "settings_texts": [],
        **more,
    }


SLAVES: Final[dict[str, Any]] = {
    "3": slave_of(
        "hoist", 3, drive={"profile": "demag-dedrive", "telegram": "PPO1", "reference_hz": 50, "reference_rpm": None}
    ),
    "4": slave_of(
        "fan", 4, drive={"profile": "fuji-frenic", "telegram": "PPO3", "reference_hz": 50, "reference_rpm": None}
    ),
    "8": slave_of(
        "valves",
        8,
        inputs=[
            {"name": "level", "type": "i16", "at": "i16@0", "unit": "bar"},
            {"name": IMAGE, "type": "bool", "at": "bool@0.1", "unit": None},
        ],
        outputs=[{"name": "limit", "type": "bool", "at": "bool@0.0", "unit": None}],
    ),
    "12": slave_of(SCRIPT, 12, model=IMAGE, vendor=TURNED),
    "13": slave_of(LONG, 13),
    "14": slave_of(EMOJI, 14),
    "15": slave_of("gate", 15),
}
#: a bad channel and an uncertain one
DOUBTS: Final[list[dict[str, Any]]] = [
    {
        "slot": slot,
        "channel": 1,
        "direction": direction,
        "quality": quality,
        "reason": "channel",
        "text": f"{IMAGE}: slot {slot}, {direction} channel 1",
        "since": 0.05,
    }
    for slot, direction, quality in ((1, "input", "bad"), (2, "output", "uncertain"))
]
VALUES: Final[dict[str, Any]] = {
    "3": values_of(drive=drive_of()),
    "4": values_of(drive=drive_of(state="fault", running=False, speed=0.0, faults=[f"OC1 {SCRIPT}"])),
    "8": values_of(fields={"level": 12.5, IMAGE: True, "limit": False}, retries=3),
    "12": values_of(state="wait_ready", inputs_valid=False, conspicuous=f"module 3: {IMAGE}"),
    "13": values_of(),
    "14": values_of(doubts=DOUBTS),
    "15": values_of(
        state="fault",
        inputs_valid=False,
        inputs_age_ms=None,
        fault={"kind": "config", "text": "the configuration is refused"},
    ),
}


def plant(slaves: dict[str, Any] | None = None, **more: Any) -> dict[str, Any]:
    """The item ``plant``."""
    about = {
        "version": 1,
        "started": STARTED,
        "port": "/dev/ttyUSB0",
        "baud": 500_000,
        "driver": "process",
        "address": 2,
        "read_only": False,
        "virtual": False,
        "paced": True,
        "config": "/home/me/plant.toml",
        "parameters": {"t_sl": 200},
        "plan": {"rotation_us": {"min": 6100, "typical": 6472, "max": 9800}, "cycle_us": None},
        "slaves": SLAVES if slaves is None else slaves,
        **more,
    }
    return {"plant": about}


def snapshot(t: float, slaves: dict[str, Any], *, whole: bool = False, **bus: Any) -> dict[str, Any]:
    return {"snapshot": {"t": t, "whole": whole, "bus": bus, "slaves": slaves}}


def whole(t: float = 0.1, slaves: dict[str, Any] | None = None, **bus: Any) -> dict[str, Any]:
    """The first snapshot."""
    times = {"min": 6472, "p50": 6480, "p99": 7234, "p999": 8064, "max": 8064}
    all_of_bus = {
        "mode": "operate",
        "in_ring": True,
        "masters": [2],
        "clear": None,
        "rotations": 900,
        "rotation_us": times,
        "token_us": times,
        "paced": True,
        "histogram": [[6480.0, 800], [7234.0, 90], [8064.0, 10]],
        "retries": 3,
        "timeouts": 0,
        "tokens_lost": 0,
        "telegrams": 12000,
        "stale": False,
        **bus,
    }
    return snapshot(t, VALUES if slaves is None else slaves, whole=True, **all_of_bus)


def event(kind: str, t: float, text: str, **more: Any) -> dict[str, Any]:
    time = datetime.fromtimestamp(STARTED + t, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    return {"event": {"event": kind, "t": t, "time": time, "severity": "info", "text": text, **more}}


class _Answering(GivenItems):
    """Answers the commands of the control socket, and keeps the orders."""

    def __init__(self, kind: Kind) -> None:
        super().__init__(kind=kind)
        self.called: list[tuple[str, ...]] = []

    async def call(self, command: str, *args: str) -> object:
        self.called.append((command, *args))
        if command == "why":
            return STORY
        if command == "acyclic":
            return {"im": IM, "pa": PROCESS_DEVICE, "stamps": STAMPS}.get(args[1], RECORD)
        return {}


class ShownPlant:
    """A served page in a thread of its own. ``put`` sends it items; ``called``: commands that reached the run."""

    def __init__(self, *, kind: Kind = "run", control: bool = False, tokens: dict[str, str] | None = None) -> None:
        secret = SECRET if control and tokens is None else None
        self._rights = Rights(control=control, tokens=tokens, secret=secret)
        self._source = _Answering(kind)
        self._loop = asyncio.new_event_loop()
        self._ready = threading.Event()
        self._over = asyncio.Event()
        self.url = ""
        self._thread = threading.Thread(target=self._loop.run_until_complete, args=(self._serve(),), daemon=True)
        self._thread.start()
        assert self._ready.wait(20)

    async def _serve(self) -> None:
        async with serve(self._source, rights=self._rights) as server:
            self.url = server.url
            self._ready.set()
            await self._over.wait()

    def close(self) -> None:
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._over.set)
            self._thread.join(20)
            self._loop.close()

    @property
    def called(self) -> list[tuple[str, ...]]:
        return list(self._source.called)

    def put(self, *items: dict[str, Any]) -> None:
        for item in items:
            self._loop.call_soon_threadsafe(self._source.put, item)

    def show(self, events: Iterable[dict[str, Any]] = ()) -> None:
        """The plant and its first snapshot."""
        self.put(plant(), whole(), *events)


class Beating:
    """Sends a snapshot without changes every 0.2 s, so that the page stays alive; ``stop`` ends that."""

    def __init__(self, shown: ShownPlant, t: float = 0.2) -> None:
        self._shown = shown
        self._over = threading.Event()
        self.t = t
        self._thread = threading.Thread(target=self._beat, daemon=True)
        self._thread.start()

    def _beat(self) -> None:
        while not self._over.wait(0.2):
            self.t = round(self.t + 0.2, 3)
            self._shown.put(snapshot(self.t, {}))

    def stop(self) -> None:
        self._over.set()
        self._thread.join()
