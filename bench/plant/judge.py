"""The messages of a subscriber: counts and octets by kind, times of births and deaths, breaches of Sparkplug B.

The judge of each edge node is the host of tests/kits/sparkplug_host.py, which knows only the specification.
"""

from __future__ import annotations

import sys
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "kits"))

from sparkplug_host import Host, read_payload

#: breaches that are kept with their text
_MOST_FAULTS: Final = 20
_S: Final = 1_000_000_000


class Message(NamedTuple):
    """A message as it came. ``at``: CLOCK_MONOTONIC, ns; ``session``: number of the connection of the subscriber."""

    at: int
    session: int
    topic: str
    payload: bytes
    qos: int

    @property
    def octets(self) -> int:
        """Octets of the PUBLISH packet in MQTT 5 without properties."""
        rest = 2 + len(self.topic) + (2 if self.qos else 0) + 1 + len(self.payload)
        return 1 + (1 if rest < 128 else 2 if rest < 16_384 else 3) + rest

    @property
    def kind(self) -> str:
        """The kind of Sparkplug B; ``status`` and ``other`` for topics that are none."""
        words = self.topic.split("/")
        if words[0] == "spBv1.0" and len(words) > 3:
            return words[2]
        return "status" if words[-1] == "status" else "other"


@dataclass
class Verdict:
    """``births``, ``deaths``: node, device ("" for a node), time. By window: ``windows``: number and octets of each
    kind of message, ``peaks``: messages of the busiest second, ``metrics``: values in data. ``largest``: metrics and
    octets of the largest births. ``breaches``: of the specification, ``faults``: texts of the first ones; ``unpaired``:
    deaths whose number is not that of the last birth; ``unjudged``: messages of nodes without a birth, as behind a
    breach or a gap of the subscriber; ``historical``: values that came as history."""

    births: list[tuple[str, str, int]] = field(default_factory=list)
    deaths: list[tuple[str, str, int]] = field(default_factory=list)
    windows: dict[str, dict[str, list[int]]] = field(default_factory=dict)
    peaks: dict[str, int] = field(default_factory=dict)
    metrics: dict[str, int] = field(default_factory=dict)
    largest: dict[str, tuple[int, int]] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)
    breaches: int = 0
    unpaired: int = 0
    unjudged: int = 0
    historical: int = 0


class _Follower:
    """One edge node: its host, which is left alone from a breach until the next birth."""

    def __init__(self, group: str, node: str) -> None:
        self.host = Host(group, node)
        self.session = -1
        self.waits = True
        self.last_number: int | None = None


def judge(messages: Iterable[Message], group: str, windows: Mapping[str, tuple[int, int]]) -> Verdict:
    """The verdict on ``messages`` in their order. ``windows``: begin and end (ns) by name; messages are counted in
    each."""
    verdict = Verdict(windows={name: {} for name in windows}, metrics=dict.fromkeys(windows, 0))
    nodes: dict[str, _Follower] = {}
    seconds: dict[str, Counter[int]] = defaultdict(Counter)
    for message in messages:
        within = [name for name, (begin, end) in windows.items() if begin <= message.at < end]
        for name in within:
            count = verdict.windows[name].setdefault(message.kind, [0, 0])
            count[0] += 1
            count[1] += message.octets
            seconds[name][(message.at - windows[name][0]) // _S] += 1
        if not message.topic.startswith(f"spBv1.0/{group}/"):
            continue
        values = _follow(verdict, nodes, group, message)
        if message.kind in ("NDATA", "DDATA"):
            for name in within:
                verdict.metrics[name] += values
        elif "BIRTH" in message.kind:
            of_this = (values, message.octets)
            verdict.largest[message.kind] = max(of_this, verdict.largest.get(message.kind, of_this))
    verdict.peaks = {name: max(seconds[name].values(), default=0) for name in windows}
    return verdict


def _follow(verdict: Verdict, nodes: dict[str, _Follower], group: str, message: Message) -> int:
    """Judge one message; the number of its metrics."""
    _, _, kind, node, *rest = message.topic.split("/")
    if kind in ("NCMD", "DCMD", "STATE"):
        return 0
    device = rest[0] if rest else ""
    one = nodes.setdefault(node, _Follower(group, node))
    host = one.host
    if one.session != message.session:
        # nothing is known after a gap: a birth must come first
        host.lose_broker()
        one.session, one.waits = message.session, True
    if kind == "NBIRTH":
        one.waits = False
    if one.waits and kind != "NDEATH":
        verdict.unjudged += 1
        return 0
    try:
        host.feed(message.topic, message.payload, qos=message.qos)
    except (AssertionError, ValueError, KeyError, IndexError) as error:
        verdict.breaches += 1
        one.waits = True
        if len(verdict.faults) < _MOST_FAULTS:
            verdict.faults.append(f"{kind} of {node} {device}: {type(error).__name__} {str(error)[:200]}")
        return 0
    metrics = host.messages[-1][2].metrics if host.messages else []
    values = len(metrics)
    verdict.historical += sum(metric.historical for metric in metrics)
    if kind == "NDEATH":
        number = _number_of(message.payload)
        if one.last_number is not None and number != one.last_number:
            verdict.unpaired += 1
        verdict.deaths.append((node, "", message.at))
    elif kind == "NBIRTH":
        one.last_number = host.number
        verdict.births.append((node, "", message.at))
    elif kind == "DBIRTH":
        verdict.births.append((node, device, message.at))
    elif kind == "DDEATH":
        verdict.deaths.append((node, device, message.at))
    host.messages.clear()
    return values


def _number_of(payload: bytes) -> int | None:
    """bdSeq of an NDEATH."""
    number = read_payload(payload).metrics[0].value(4)
    return number if isinstance(number, int) else None
