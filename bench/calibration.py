"""The unit of all durations here: one write and read of 17 octets on an ``os.pipe``, measured in the same run."""

from __future__ import annotations

import os
import time
from statistics import median

_OCTETS = bytes(17)


def calibrate(rounds: int = 15, loops: int = 2_000) -> float:
    """Nanoseconds per write and read of 17 octets: the median of ``rounds`` of ``loops`` each."""
    reader, writer = os.pipe()
    read, write, clock = os.read, os.write, time.perf_counter_ns
    results = []
    try:
        for _ in range(rounds):
            begin = clock()
            for _ in range(loops):
                write(writer, _OCTETS)
                read(reader, 64)
            results.append((clock() - begin) / loops)
    finally:
        os.close(reader)
        os.close(writer)
    return median(results)
