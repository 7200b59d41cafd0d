"""Noise x baud x stations: what becomes of a bus, as numbers that are kept in ``tests/snapshots``.

A change of behaviour is a diff to read: ``python tests/kits/noise_matrix.py`` writes the snapshots anew (``--soak`` the
large one too). Everything is decided by the seed, so a snapshot is exact.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path

from bus_kit import SimBus, all_exchange
from fire_kit import FireRing
from support import MS, S

from dpstack.dp.master.events import SlaveState, SlaveStateChanged
from dpstack.dp.master.master import Master
from dpstack.fdl.active.station import ActiveStation
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.trace import Event
from dpstack.units import BAUD_RATES, bits_to_ns

SNAPSHOTS = Path(__file__).parents[1] / "snapshots"
NOISE = (0.0, 1e-5, 1e-4, 1e-3)
#: masters, slaves
STATIONS = ((1, 1), (1, 8), (3, 3))
#: name: rates, bits with noise, seeds
MATRICES = {
    "noise": ((19_200, 500_000, 12_000_000), 100_000, (1,)),
    "noise_soak": (BAUD_RATES, 300_000, (1, 2)),
}
#: outputs change this often during the noise
_CHANGES = 20

Row = dict[str, int | str]


def rows(name: str) -> Iterator[tuple[str, Row]]:
    """The cells of the matrix ``name``: what it is, and its numbers."""
    rates, bits, seeds = MATRICES[name]
    for baud in rates:
        for noise in NOISE:
            for masters, slaves in STATIONS:
                for seed in seeds:
                    title = f"{baud} bit/s, {noise:g} per bit, {masters} masters, {slaves} slaves, seed {seed}"
                    yield title, _cell(baud, noise, masters, slaves, bits, seed)


def _cell(baud: int, noise: float, masters: int, slaves: int, bits: int, seed: int) -> Row:
    world = World(seed=seed)
    stations, users, events = _bus(world, baud, masters, slaves)
    assert world.run(world.now + 600 * S, lambda: _exchanging(users)), "no bring-up without noise"
    begun, told = _exchanges(users), len(events)
    trouble = _trouble(stations)
    world.faults.noise(noise)
    sent: set[bytes] = {bytes(12)}
    wrong = 0
    for number in range(_CHANGES):
        outputs = bytes([number + 1, 0x68, 0xE5, 0x10, 0xDC, 0x16] * 2)
        sent.add(outputs)
        for user in users:
            for image in user.images.values():
                image.outputs = outputs
        world.run_for(bits_to_ns(bits // _CHANGES, baud))
        wrong += sum(image.inputs not in sent for user in users for image in user.images.values())
    row: Row = {"exchanges": _exchanges(users) - begun, "wrong inputs": wrong}
    row |= {name: value - trouble[name] for name, value in _trouble(stations).items() if value != trouble[name]}
    changed = [event for event in events[told:] if isinstance(event, SlaveStateChanged)]
    if changed:
        row["slaves lost"] = sum(event.state is SlaveState.OFFLINE for event in changed)
    assert world.referee is not None
    if world.referee.violations:
        row["referee"] = len(world.referee.violations)
    world.faults.clear()
    since = world.now

    def well() -> bool:
        return _exchanging(users) and all(s.in_ring for s in stations)

    back = well() or world.run(since + 60 * S, well)
    row["back after ms"] = (world.now - since) // MS if back else "never"
    return row


def _bus(world: World, baud: int, masters: int, slaves: int) -> tuple[list[ActiveStation], list[Master], list[Event]]:
    watchdog_ms = max(200, 60_000_000 // baud)  # a round takes its time at low rates
    if masters == 1:
        params = BusParams.preset(baud, address=2, hsa=10)
        bus = SimBus(world, params, range(20, 20 + slaves), watchdog_ms=watchdog_ms)
        return [bus.station], [bus.master], bus.events
    params = BusParams.preset(baud, address=2, hsa=10, gap=1)
    ring = FireRing(world, params, tuple(range(2, 2 + masters)), slaves=True, watchdog_ms=watchdog_ms)
    return list(ring.masters.values()), list(ring.dp.values()), ring.events


def _exchanging(users: list[Master]) -> bool:
    return all(map(all_exchange, users))


def _exchanges(users: list[Master]) -> int:
    return sum(h.exchanges for user in users for h in user.handlers.values())


def _trouble(stations: list[ActiveStation]) -> dict[str, int]:
    totals: dict[str, int] = {}
    for station in stations:
        remote = station.stats.stations.values()
        counted = {
            "retries": sum(s.retries for s in remote),
            "given up": sum(s.timeouts for s in remote),
            "late or wrong": sum(s.late + s.wrong for s in remote),
            "tokens lost": station.stats.tokens_lost,
            "tokens repeated": station.stats.token_retries,
            "withdrawn": station.stats.withdrawn,
            "bad frames": station.decoder_stats.bad,
        }
        for name, value in counted.items():
            totals[name] = totals.get(name, 0) + value
    return totals


def text_of(name: str) -> str:
    """The matrix ``name`` as its file: one line a cell."""
    lines = [f"  {json.dumps(title)}: {json.dumps(row)}" for title, row in rows(name)]
    return "{\n" + ",\n".join(lines) + "\n}\n"


def path_of(name: str) -> Path:
    """Where the snapshot is kept."""
    return SNAPSHOTS / f"{name}.json"


if __name__ == "__main__":
    for matrix in MATRICES if "--soak" in sys.argv else ("noise",):
        path_of(matrix).write_text(text_of(matrix))
