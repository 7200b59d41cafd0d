"""Fault injection on the medium, with one seed: bit noise; transmissions dropped, damaged or delayed by choice."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from random import Random
from typing import Final

from dpstack.errors import ConfigError
from dpstack.phy.noise import BitNoise
from dpstack.sim.transmission import Transmission
from dpstack.units import BITS_PER_CHAR

#: selects transmissions by sender, octets or telegram
Which = Callable[[Transmission], bool]

_DATA_BIT_0: Final = 0x002


@dataclass(slots=True)
class _Fault:
    """A fault for the next ``left`` transmissions that ``which`` selects; None = all of them."""

    which: Which
    act: Callable[[Transmission], None]
    left: int | None


class Faults:
    """The faults of one world. ``armed`` is False while there are none, so that a bus without faults costs nothing."""

    def __init__(self, seed: int) -> None:
        self.armed = False
        self._rng = Random(seed)
        self._faults: list[_Fault] = []
        self._noise: BitNoise | None = None

    # --- commands ---
    def noise(self, per_bit: float) -> None:
        """From now on each bit on the wire is inverted with the probability ``per_bit`` (0..0.5); 0 ends it."""
        if not 0.0 <= per_bit <= 0.5:
            raise ConfigError(f"noise of {per_bit} per bit: give a probability from 0 to 0.5")
        self._noise = BitNoise(per_bit, self._rng) if per_bit else None
        self._update_armed()

    def drop(self, which: Which, *, times: int | None = 1) -> None:
        """Drop the next ``times`` transmissions that ``which`` selects (None = all): no station hears them."""
        self._add(which, _drop, times)

    def damage(
        self, which: Which, *, octet: int | None = None, flips: int = _DATA_BIT_0, times: int | None = 1
    ) -> None:
        """Invert the bits ``flips`` of one octet (its number, from the end when negative; None = one by chance).

        ``flips``: bit 0 start, 1..8 data, 9 parity, 10 stop. One inverted bit drops the octet, two data bits change it.
        """
        if not 0 < flips < 1 << BITS_PER_CHAR:
            raise ConfigError(
                f"flips = {flips:#x}: a character has {BITS_PER_CHAR} bits, at least one must be inverted"
            )

        def act(tx: Transmission) -> None:
            size = len(tx.octets)
            number = self._rng.randrange(size) if octet is None else octet % size
            tx.flips[number] = tx.flips.get(number, 0) ^ flips

        self._add(which, act, times)

    def delay(self, which: Which, by_ns: int, *, times: int | None = 1) -> None:
        """Begin the next ``times`` transmissions that ``which`` selects ``by_ns`` later than their stations wanted."""
        if by_ns < 0:
            raise ConfigError(f"a delay of {by_ns} ns: nothing can be sent before its time")

        def act(tx: Transmission) -> None:
            tx.start_ns += by_ns
            tx.end_ns += by_ns
            tx.forced = True
            tx.notes.append("delayed")

        self._add(which, act, times)

    def clear(self) -> None:
        self._faults.clear()
        self._noise = None
        self._update_armed()

    # --- for the medium ---
    def apply(self, tx: Transmission) -> None:
        """Apply the faults to ``tx``: ``lost``, ``flips``, a later start."""
        for fault in list(self._faults):
            if not fault.which(tx):
                continue
            fault.act(tx)
            if fault.left is not None:
                fault.left -= 1
                if not fault.left:
                    self._faults.remove(fault)
                    self._update_armed()
        if self._noise is not None:
            for number, mask in self._noise.flips(len(tx.octets)).items():
                tx.flips[number] = tx.flips.get(number, 0) ^ mask

    def _add(self, which: Which, act: Callable[[Transmission], None], times: int | None) -> None:
        if times is not None and times < 1:
            raise ConfigError(f"times = {times}: give 1 or more, or None for all")
        self._faults.append(_Fault(which, act, times))
        self._update_armed()

    def _update_armed(self) -> None:
        self.armed = bool(self._faults) or self._noise is not None


def _drop(tx: Transmission) -> None:
    tx.lost = True
    tx.notes.append("dropped")
