"""Telegrams PPO1 to PPO6 of PROFIdrive V2, and the baud rates, which several drives have alike."""

from __future__ import annotations

from typing import Final

from dpstack.profile import TelegramSpec

#: all rates of PROFIBUS DP but 31.25 kbit/s
TEN_RATES: Final = (9_600, 19_200, 45_450, 93_750, 187_500, 500_000, 1_500_000, 3_000_000, 6_000_000, 12_000_000)
#: identifier octets, and words of process data each way; F3 is the parameter channel
_ROWS: Final = (("F3 71", 2), ("F3 75", 6), ("71", 2), ("75", 6), ("F3 79", 10), ("79", 10))


def telegram(name: str, config: str, words: int, *, made_up: bool = False) -> TelegramSpec:
    """A telegram with so many words each way, by its identifier octets in hex."""
    octets, size = bytes.fromhex(config), 2 * words
    return TelegramSpec(name=name, config=octets, outputs=size, inputs=size, channel=len(octets) > 1, made_up=made_up)


def ppos(last: int, *, made_up: bool = False) -> dict[str, TelegramSpec]:
    """PPO1 to the ``last`` one, by name."""
    specs = (telegram(f"PPO{number}", *row, made_up=made_up) for number, row in enumerate(_ROWS[:last], 1))
    return {spec.name: spec for spec in specs}
