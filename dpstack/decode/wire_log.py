"""Wire logs in words: the log that a failing test and the referee of a simulated bus print."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from dpstack.capture.transmission import Transmission
from dpstack.decode.telegram import explain
from dpstack.trace import WireEntry
from dpstack.units import NS_PER_US, ns_to_bits

#: a wire log shows so many octets of a transmission in full
SHOWN_OCTETS: Final = 32


def render(log: Iterable[WireEntry], baud: int) -> str:
    """The decoded wire log, a line for each transmission: its number, start in us, gap before it in bit times, sender,
    octets in hex (long ones without their middle), description and its course. A negative gap is an overlap.
    """
    entries = list(log)
    shown = [_hex(entry.octets) for entry in entries]
    width = max((len(octets) for octets in shown), default=0)
    lines = [f"{'no.':>5} {'start us':>14} {'gap bits':>9}  {'sender':<10} {'octets':<{width}}  telegram"]
    end: int | None = None
    explained = explain(Transmission(entry.octets, entry.start_ns, baud) for entry in entries)
    for entry, octets, one in zip(entries, shown, explained, strict=True):
        gap = "" if end is None else str(ns_to_bits(entry.start_ns - end, baud))
        start = f"{entry.start_ns // NS_PER_US}.{entry.start_ns % NS_PER_US:03}"
        sender = entry.sender or "?"
        text = f"{one.text}  [{entry.note}]" if entry.note else one.text
        lines.append(f"{one.number:>5} {start:>14} {gap:>9}  {sender:<10} {octets:<{width}}  {text}")
        end = entry.end_ns if end is None else max(end, entry.end_ns)
    return "\n".join(lines)


def _hex(octets: bytes) -> str:
    if len(octets) <= SHOWN_OCTETS:
        return octets.hex(" ")
    return f"{octets[: SHOWN_OCTETS - 8].hex(' ')} ... {octets[-4:].hex(' ')} ({len(octets)} octets)"
