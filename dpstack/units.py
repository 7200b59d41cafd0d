"""Units of time: integer nanoseconds, bit times, and the one rounding rule between them.

A duration is an ``int`` in nanoseconds (names end in ``_ns`` or are called ``now``, ``at``) or in bit times
(the standard's ``t_sl``, ``min_tsdr`` ...; names end in ``_bits`` if they are not the standard's).
Bits become nanoseconds at one place, :func:`bits_to_ns`, rounded to the nearest nanosecond. A *sum* of bits is
converted, never single bits, so that the error of a telegram is half a nanosecond and not 255 times that.
"""

from __future__ import annotations

from typing import Final

NS_PER_S: Final = 1_000_000_000
NS_PER_MS: Final = 1_000_000
NS_PER_US: Final = 1_000

#: A UART character on the wire: start, eight data bits, even parity, stop (8E1).
BITS_PER_CHAR: Final = 11

#: ``wake_at()`` of a machine that has something to do at once.
NOW: Final = 0
#: ``wake_at()`` of a machine that only waits for input.
NEVER: Final = (1 << 63) - 1

#: The baud rates of PROFIBUS-DP in bit/s (31.25 k is PA's), slowest first.
BAUD_RATES: Final = (
    9_600,
    19_200,
    31_250,
    45_450,
    93_750,
    187_500,
    500_000,
    1_500_000,
    3_000_000,
    6_000_000,
    12_000_000,
)
#: in place of a setting: the baud rate is found by listening (see :mod:`dpstack.api.bus.find_baud`), echo is recognised
AUTO: Final = "auto"


def bits_to_ns(bits: int, baud: int) -> int:
    """The duration of ``bits`` bit times at ``baud`` bit/s in nanoseconds, rounded to nearest."""
    return (bits * NS_PER_S + (baud >> 1)) // baud


def ns_to_bits(ns: int, baud: int) -> int:
    """The number of bit times at ``baud`` in ``ns`` nanoseconds, rounded to nearest."""
    return (ns * baud + NS_PER_S // 2) // NS_PER_S


def chars_to_ns(chars: int, baud: int) -> int:
    """The time ``chars`` octets without gaps take on the wire (11 bits each) in nanoseconds."""
    return bits_to_ns(chars * BITS_PER_CHAR, baud)


def ns_to_s(ns: int) -> float:
    """Nanoseconds as float seconds: for people and for APIs that want it, never for arithmetic."""
    return ns / NS_PER_S


def s_to_ns(seconds: float) -> int:
    """Float seconds as they come from users and asyncio, in nanoseconds, rounded to nearest."""
    return round(seconds * NS_PER_S)


def baud_text(baud: int) -> str:
    """A baud rate as people write it: ``500 kbit/s``, ``45.45 kbit/s``, ``12 Mbit/s``."""
    if baud >= 1_000_000:
        return f"{baud / 1_000_000:g} Mbit/s"
    return f"{baud / 1_000:g} kbit/s"


def ms_text(ns: int) -> str:
    """A time as people write it, in ms: ``0.0817 ms``, ``4.92 ms``, ``650 ms``."""
    return f"{ns / NS_PER_MS:.3g} ms" if ns < 100 * NS_PER_MS else f"{ns / NS_PER_MS:.0f} ms"
