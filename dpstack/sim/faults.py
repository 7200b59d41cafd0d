"""Fault injection on the medium, with one seed: bit noise, bursts and lost octets by chance; transmissions dropped,
damaged, cut short, repeated or delayed by choice."""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from typing import Final

from msgspec import Struct

from dpstack.errors import ConfigError
from dpstack.phy.noise import BitNoise, Bursts, LostOctets
from dpstack.sim.transmission import Transmission
from dpstack.units import BITS_PER_CHAR

#: selects transmissions by sender, octets or telegram
Which = Callable[[Transmission], bool]

Noise = BitNoise | Bursts | LostOctets

_DATA_BIT_0: Final = 0x002


class _Fault(Struct):
    """A fault for the next ``left`` transmissions that ``which`` selects; None = all of them."""

    which: Which
    act: Callable[[Transmission], None]
    left: int | None


class Faults:
    """The faults of one world. ``armed`` is False without any, so that a bus without faults costs nothing."""

    def __init__(self, seed: int) -> None:
        self.armed = False
        self._rng = Random(seed)
        self._faults: list[_Fault] = []
        #: noise by its kind: bit errors, bursts, lost octets
        self._noise: dict[type[Noise], Noise] = {}

    # --- commands ---
    def noise(self, per_bit: float) -> None:
        """From now on each bit on the wire is inverted with the probability ``per_bit`` (0..0.5); 0 ends it."""
        if not 0.0 <= per_bit <= 0.5:
            raise ConfigError(f"noise of {per_bit} per bit: give a probability from 0 to 0.5")
        self._set_noise(BitNoise, BitNoise(per_bit, self._rng) if per_bit else None)

    def bursts(self, per_bit: float, bits: int) -> None:
        """From now on a burst begins with each bit on the wire with the probability ``per_bit`` (0..0.5); 0 ends it.

        Of the ``bits`` (1 or more) bits on the wire in a burst each is inverted with the probability 1/2.
        """
        if not 0.0 <= per_bit <= 0.5 or bits < 1:
            raise ConfigError(f"bursts of {bits} bits, {per_bit} per bit: give 1 or more, and 0 to 0.5")
        self._set_noise(Bursts, Bursts(per_bit, bits, self._rng) if per_bit else None)

    def lose_octets(self, per_octet: float) -> None:
        """From now on each octet on the wire is lost with the probability ``per_octet`` (0..0.5); 0 ends it."""
        if not 0.0 <= per_octet <= 0.5:
            raise ConfigError(f"lost octets, {per_octet} per octet: give a probability from 0 to 0.5")
        self._set_noise(LostOctets, LostOctets(per_octet, self._rng) if per_octet else None)

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

    def truncate(self, which: Which, *, octets: int | None = None, times: int | None = 1) -> None:
        """Of the next ``times`` transmissions that ``which`` selects only the first ``octets`` are on the wire.

        ``octets`` None: a number by chance, at least one and not all; a single octet stays whole. The sender counts as
        free when the last of them has ended.
        """
        if octets is not None and octets < 1:
            raise ConfigError(f"truncated after {octets} octets: give 1 or more, or drop the transmission")

        def act(tx: Transmission) -> None:
            whole = len(tx.octets)
            kept = octets if octets is not None else self._rng.randrange(1, whole) if whole > 1 else whole
            if kept < whole:
                tx.cut_short(kept)

        self._add(which, act, times)

    def repeat(self, which: Which, gap_ns: int = 0, *, times: int | None = 1) -> None:
        """Each of the next ``times`` transmissions that ``which`` selects is on the wire twice, as behind a bad
        repeater: again ``gap_ns`` after its end, whatever is on the wire then."""
        if gap_ns < 0:
            raise ConfigError(f"repeated after {gap_ns} ns: a repetition cannot begin before the end")

        def act(tx: Transmission) -> None:
            tx.repeat_after_ns = gap_ns

        self._add(which, act, times)

    def clear(self) -> None:
        self._faults.clear()
        self._noise.clear()
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
        for noise in self._noise.values():
            for number, mask in noise.flips(len(tx.octets)).items():
                tx.flips[number] = tx.flips.get(number, 0) ^ mask

    def _add(self, which: Which, act: Callable[[Transmission], None], times: int | None) -> None:
        if times is not None and times < 1:
            raise ConfigError(f"times = {times}: give 1 or more, or None for all")
        self._faults.append(_Fault(which, act, times))
        self._update_armed()

    def _set_noise(self, kind: type[Noise], noise: Noise | None) -> None:
        if noise is None:
            self._noise.pop(kind, None)
        else:
            self._noise[kind] = noise
        self._update_armed()

    def _update_armed(self) -> None:
        self.armed = bool(self._faults or self._noise)


def _drop(tx: Transmission) -> None:
    tx.lost = True
    tx.notes.append("dropped")
