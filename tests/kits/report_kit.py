"""A simulated bus that is listened to, and the report of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

from bus_kit import SimBus
from support import S

from dpstack.capture.listener import Listener
from dpstack.capture.transmission import Transmission
from dpstack.monitor.counters import Counters
from dpstack.monitor.monitor import Happening
from dpstack.monitor.report import Report
from dpstack.monitor.schedule import ScheduleRecorder
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.stats import Histogram

EPOCH = 1_790_000_000 * S
MADE = datetime(2026, 9, 21, 15, tzinfo=UTC)


def happened(t_ns: int, kind: str, address: int | None, text: str) -> Happening:
    """An entry of the time line."""
    return Happening(t_ns, kind, address, "", text)


@dataclass(repr=False)
class Heard:
    """A master (2) and its slaves at 500 kbit/s, heard from the first octet on."""

    addresses: Sequence[int] = (3, 4)
    silent: Sequence[int] = ()
    world: World = field(default_factory=lambda: World(seed=5, keep=200_000, referee=False))
    changes: list[Happening] = field(default_factory=list)
    heard: list[Transmission] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.counters = Counters(
            lambda one: self.changes.append(
                happened(one.t_ns, one.kind, None if one.address < 0 else one.address, one.text)
            )
        )
        self.recorder = ScheduleRecorder()
        params = BusParams.preset(500_000, address=2)
        self.bus = SimBus(self.world, params, list(self.addresses), silent=self.silent)
        self.world.add(Listener(self.world.now, self._add, baud=500_000, epoch_ns=EPOCH), name="listener")

    def _add(self, one: Transmission) -> None:
        self.heard.append(one)
        self.counters.add(one)
        self.recorder.add(one)

    def report(self, **changes: Any) -> Report:
        values: dict[str, Any] = {
            "summary": self.summary(),
            "counters": self.counters,
            "begun_ns": self.counters.begun_ns or 0,
            "version": "0.1.0",
            "made": MADE,
            "changes": self.changes,
            "rotation": self.recorder.typical(),
        }
        return Report(**{**values, **changes})

    def summary(self, *, timed: bool = True) -> dict[str, Any]:
        """The summary as ``monitor --json`` has it, with numbers that are easy to find again."""
        counters = self.counters
        masters = {
            str(address): {
                "mode": one.mode,
                "token_us": _points(one.token_ns) if timed else None,
                "rotation_us": _points(one.rotation_ns) if timed else None,
                "hold_us": _points(one.hold_ns) if timed else None,
                "gap_polls": one.gap_polls,
                "drops": 77,
                "slaves": sorted(one.slaves),
            }
            for address, one in counters.masters.items()
        }
        stations = {
            str(address): {
                "role": "slave",
                "name": f"name{address}",
                "ident": "0x1234",
                "model": "a model",
                "state": one.state,
                "master": 2,
                "requests": one.requests,
                "answers": one.answers,
                "damaged": one.damaged,
                "no_answer": one.no_answer,
                "repetitions": one.repetitions,
                "retry_depth": [8123, 4123],
                "repeated_polls": 901,
                "late": 902,
                "rs": 903,
                "rr": 904,
                "diagnoses": one.diagnoses,
                "diagnosis": "020c00021234",
                "diagnosis_texts": ["a line break"],
                "syncs": one.syncs,
                "lost": 905,
                "max_tsdr": 60,
                "tsdr_us": _points(one.answer_ns) if timed else None,
                "not_heard": ["parameters"],
                "verdict": "warning",
                "reasons": [f"station {address}: look at its connector"],
            }
            for address, one in counters.stations.items()
            if one.is_present and not one.is_master
        }
        return {
            "event": "summary",
            "time": "2026-09-21T14:13:20.000Z",
            "baud": 500_000,
            "seconds": 61.25,
            "telegrams": counters.telegrams,
            "load": 0.7153,
            "damaged": {"fcs": 31, "parity": 32},
            "unattributed": 33,
            "strays": 34,
            "timing": {"source": "tap", "resolution_us": 1.5, "batched": 0.0217},
            "masters": masters,
            "stations": stations,
            "not_heard": ["the parameters of two stations"],
            "verdict": "warning",
            "reasons": ["two stations need a look"],
        }


def _points(values: Histogram) -> dict[str, float] | None:
    if not values.count:
        return None
    points = {"min": 0.0, "p50": 0.5, "p99": 0.99, "max": 1.0}
    return {name: round(values.quantile_ns(q) / 1000, 1) for name, q in points.items()}
