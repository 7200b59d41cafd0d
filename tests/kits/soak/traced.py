"""The long run with tracemalloc: memory by the line that took it, after a warm-up and at the end of so many exchanges.

The bus is that of a slice (:mod:`soak.slice`): its program and its readers go on, and a line that keeps more and more
shows as growth between the samples.
"""

from __future__ import annotations

import gc
import time
import tracemalloc
from typing import Any, Final

from soak.slice import Slice

import dpstack

#: parts of the run at which memory is looked at; the first ends the warm-up
_PARTS: Final = (0.3, 0.5, 0.75, 1.0)
_SHOWN: Final = 10


class Traced(Slice):
    """A slice that ends after ``exchanges`` Data_Exchange, with a snapshot of tracemalloc at each part of it."""

    def __init__(self, number: int, exchanges: int) -> None:
        super().__init__(number, exchanges)
        self.snapshots: list[tracemalloc.Snapshot] = []
        self.traced: list[tuple[int, int]] = []

    @property
    def done(self) -> int:
        return self.wire.answered.total()

    async def work(self) -> None:
        for part in _PARTS:
            await self.work_until(int(part * self.wanted))
            gc.collect()
            self.traced.append(tracemalloc.get_traced_memory())
            tracemalloc.reset_peak()
            self.snapshots.append(tracemalloc.take_snapshot())


def run_traced(exchanges: int, number: int = 0) -> dict[str, Any]:
    """Run ``exchanges`` and return the line of the results file: octets traced, peaks, and growth by line."""
    cpu, began = time.process_time(), time.time()
    tracemalloc.start(1)
    try:
        piece = Traced(number, exchanges)
        dpstack.run_virtual(piece.run())
    finally:
        tracemalloc.stop()
    warm, end = piece.snapshots[0], piece.snapshots[-1]
    grown = [
        (f"{_short(d.traceback[0].filename)}:{d.traceback[0].lineno}", d.size_diff, d.count_diff)
        for d in end.compare_to(warm, "lineno")
        if d.size_diff > 0
    ]
    return {
        "traced": exchanges,
        "exchanges": piece.done,
        "telegrams": piece.wire.telegrams,
        "parts": _PARTS,
        "octets": [now for now, _ in piece.traced],
        "peaks": [peak for _, peak in piece.traced],
        "grown": grown[:_SHOWN],
        "began": int(began),
        "cpu_s": round(time.process_time() - cpu, 1),
        "leftovers": piece.result["leftovers"],
        "faults": piece.faults,
    }


def _short(name: str) -> str:
    return "/".join(name.split("/")[-3:])
