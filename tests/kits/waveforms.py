"""Waveforms of a bus as a logic analyser records them, made bit by bit without the product's model of a UART."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterable
from fractions import Fraction

#: one token hold of master 2 with slave 5: outputs and inputs, a GAP poll of station 3, the token
TELEGRAMS = tuple(
    map(
        bytes.fromhex,
        (
            "68 05 05 68 05 02 5D 11 22 97 16",
            "68 05 05 68 02 05 08 33 44 86 16",
            "10 03 02 49 4E 16",
            "DC 02 02",
        ),
    )
)


def bits(octet: int) -> list[int]:
    """Start bit, data bits with the lowest first, even parity, stop bit."""
    data = [octet >> place & 1 for place in range(8)]
    return [0, *data, sum(data) % 2, 1]


def line(telegrams: Iterable[bytes], gap: int = 37) -> list[int]:
    """The bits of ``telegrams``, each after ``gap`` bits of an idle line, and the idle line behind them."""
    found: list[int] = []
    for telegram in telegrams:
        found += [1] * gap
        for octet in telegram:
            found += bits(octet)
    return found + [1] * gap


def sampled(levels: list[int], baud: int, rate: int) -> bytes:
    """One octet (0 or 1) for each sample at ``rate`` samples/s."""
    return bytes(levels[number * baud // rate] for number in range(len(levels) * rate // baud))


def times(levels: list[int], baud: int, rate: int) -> list[tuple[Fraction, int]]:
    """The first level and each change, with the time in s of the first sample that shows it."""
    found: list[tuple[Fraction, int]] = []
    for number, level in enumerate(sampled(levels, baud, rate)):
        if not found or found[-1][1] != level:
            found.append((Fraction(number, rate), level))
    return found


def session(samples: bytes, rate: str, probes: Iterable[str] = ("D0",), unit: int = 1, parts: int = 1) -> bytes:
    """A session file of sigrok with ``samples`` of ``unit`` octets each."""
    names = "".join(f"probe{number}={name}\n" for number, name in enumerate(probes, 1))
    size = -(-len(samples) // parts // unit) * unit
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("version", "2")
        archive.writestr(
            "metadata",
            "[global]\nsigrok version=0.5.2\n\n[device 1]\ncapturefile=logic-1\ntotal probes=8\n"
            f"samplerate={rate}\ntotal analog=0\n{names}unitsize={unit}\n",
        )
        for part in range(parts):
            archive.writestr(f"logic-1-{part + 1}", samples[part * size : (part + 1) * size])
    return file.getvalue()
