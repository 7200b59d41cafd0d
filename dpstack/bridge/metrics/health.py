"""``/healthz`` and ``/readyz``: whether the stream of the bus comes, and whether all slaves are in data exchange."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

from dpstack.monitor.verdict import CRITICAL, WARNING, Verdict
from dpstack.plant.judge import DATA_EXCHANGE, DEACTIVATED
from dpstack.plant.quality import Reason, clean
from dpstack.plant.tree import PlantTree
from dpstack.text import printable

#: reasons for which no value of the stream is of this moment
_NO_STREAM: Final = frozenset({Reason.WAITING, Reason.STREAM_SILENT, Reason.STREAM_LATE, Reason.ENDED, Reason.FAILED})


class Health(NamedTuple):
    """``text``: lines for people, printable, each with its end."""

    good: bool
    text: str


def stream_comes(tree: PlantTree) -> bool:
    """Whether the live stream of the bus comes, and in time."""
    trouble = tree.trouble(None)
    return trouble is None or trouble[0] not in _NO_STREAM


def liveness(tree: PlantTree) -> Health:
    """``/healthz``: this process answers, and the live stream of the bus comes."""
    if stream_comes(tree):
        return Health(True, "the live stream of the bus comes\n")
    trouble = tree.trouble(None)
    assert trouble is not None
    return Health(False, f"{_line(*trouble)}\n")


def readiness(tree: PlantTree, judge: Callable[[], Verdict]) -> Health:
    """``/readyz``: the bus operates (on a bus that is read only: its master is in the ring), and all slaves are in data
    exchange, but those that were taken out of service by order. If it is ready, ``judge`` is asked for further
    lines."""
    trouble = tree.trouble(None)
    if trouble is not None:
        return Health(False, f"{_line(*trouble)}\n")
    values = tree.bus_values
    lines = []
    if tree.plant is not None and tree.plant.read_only is True:
        if values.in_ring is not True:
            lines.append("the master is not in the token ring")
    elif values.mode != "operate":
        lines.append(f"the master is in {clean(values.mode) or 'an unknown mode'}, not in operate")
    served = 0
    for address, described in tree.slaves.items():
        slave = tree.slave_values(address)
        if slave.state == DEACTIVATED:
            continue
        served += 1
        if not tree.is_alive(address):
            trouble = tree.trouble(address)
            state = clean(slave.state) or "unknown"
            why = _line(*trouble) if trouble is not None and state == DATA_EXCHANGE else state
            lines.append(f"slave {address} ({printable(described.name)}) is not in data exchange: {why}")
    if lines:
        return Health(False, "".join(f"{line}\n" for line in lines))
    verdict = judge()
    judged = [f"verdict: {verdict.level}", *verdict.reasons] if verdict.level in (WARNING, CRITICAL) else []
    return Health(True, "\n".join([f"the bus operates; in data exchange: all slaves ({served})", *judged, ""]))


def _line(reason: Reason, note: str) -> str:
    if reason is Reason.WAITING:
        return "the bus is not open yet"
    return printable(reason.with_note(note))
