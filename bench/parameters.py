"""Reading a PROFIdrive device's own list of 1000 parameters over record 47: how long it takes, in virtual time, exact.

975 words and 25 arrays of eight double words, as numbers and first values, and with all descriptions and whole arrays;
a device that has its response at once, and one that works 10 ms at each request.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import dpstack
from bench.report import Report
from dpstack.profile import ParamSpec, ParamStore, ParamTable, ParamType
from dpstack.profile.record47 import Counters, ParameterServer, Rules, StoreParameters, TimedRecords
from dpstack.slave import DpSlave, SlaveDescription
from dpstack.units import NS_PER_MS, baud_text

_BAUDS: Final = (500_000, 1_500_000)
_WORDS: Final = range(1, 976)
_ARRAYS: Final = range(2000, 2025)
_ELEMENTS: Final = 8
COUNT: Final = len(_WORDS) + len(_ARRAYS)
MIXER: Final = SlaveDescription.simple(0x1234, inputs=4, outputs=4, name="mixer", dpv1=True)
_ADDRESS: Final = 9


@dataclass(frozen=True, slots=True)
class Reading:
    """``seconds`` of the bus for so many ``parameters``, and what it took."""

    seconds: float
    parameters: int
    counters: Counters


def mixer(busy_ms: int = 0) -> DpSlave:
    """The device, ``busy_ms`` at each request."""
    words = [ParamSpec(number=n, name=f"p{n}", title="Word", factory=n % 1000) for n in _WORDS]
    arrays = [
        ParamSpec(number=n, name=f"p{n}", title="Sets", type=ParamType.U32, per_set=True, factory=7) for n in _ARRAYS
    ]
    store = ParamStore(ParamTable((*words, *arrays)), {}, sets=_ELEMENTS)
    server = ParameterServer(StoreParameters(store), Rules(busy_ns=busy_ms * NS_PER_MS))
    return DpSlave(MIXER, lambda outputs, elapsed: outputs, parameters=TimedRecords(server))


def read_out(baud: int, *, described: bool, busy_ms: int = 0) -> Reading:
    async def main() -> Reading:
        world = dpstack.World()
        async with (
            dpstack.slave.serve_slave(mixer(busy_ms), world=world, address=_ADDRESS, baud=baud),
            dpstack.open_bus(port="virtual", baud=baud, slaves=[MIXER.table(_ADDRESS)], world=world) as bus,
        ):
            await bus.operate()
            await bus.ready()
            parameters = bus.slave(_ADDRESS).parameters()
            began = bus.seconds
            found = await parameters.read_out(described=described)
            return Reading(bus.seconds - began, len(found), parameters.counters)

    return dpstack.run_virtual(main())


def run(argv: Sequence[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench parameters")
    parser.add_argument("--bauds", type=int, nargs="*", default=_BAUDS)
    parser.add_argument("--busy-ms", type=int, nargs="*", default=(0, 10), help="what the device takes for a request")
    args = parser.parse_args(argv)
    report = Report("parameters")
    for baud in args.bauds:
        for described in (False, True):
            for busy_ms in args.busy_ms:
                _add(report, read_out(baud, described=described, busy_ms=busy_ms), baud, described, busy_ms)
    return report


def _add(report: Report, seen: Reading, baud: int, described: bool, busy_ms: int) -> None:
    what = "with descriptions and arrays" if described else "first values"
    busy = f", {busy_ms} ms a request" if busy_ms else ""
    head = f"{baud_text(baud)}, {seen.parameters} parameters, {what}{busy}"
    report.exact(head, seen.seconds, "s")
    if not busy_ms:
        report.exact(f"{head}: services", seen.counters.services, "")
        report.exact(f"{head}: octets of records", seen.counters.octets, "")
