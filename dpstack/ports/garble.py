"""What a wire does to octets: noise. Seeded, so that a run can be repeated."""

from __future__ import annotations

import math
import random

from dpstack.errors import ConfigError
from dpstack.units import BITS_PER_CHAR


def intact(octets: bytes, flips: dict[int, int]) -> bytes:
    """What a receiver at the sender's rate is left with: ``octets`` without the damaged ones."""
    return bytes(octet for number, octet in enumerate(octets) if number not in flips) if flips else octets


class Noise:
    """Damages bits independently with probability ``error_rate`` (0..1 exclusive).

    A damaged octet is dropped, as a UART with IGNPAR does: on a pty error marks cannot be injected.
    """

    def __init__(self, error_rate: float, rng: random.Random) -> None:
        if not 0 <= error_rate < 1:
            raise ConfigError(f"error rate {error_rate} is a probability per bit: 0 <= P < 1, for instance 1e-4")
        self.error_rate = error_rate
        self.damaged = 0
        self._rng = rng
        self._log_good = math.log1p(-error_rate)
        self._bits_left = self._next_gap()  # good bits until the next damaged one

    def flips(self, octets: bytes) -> dict[int, int]:
        """The bits of ``octets`` that are inverted, by octet number: bit 0 is the start bit, bit 10 the stop bit."""
        size = len(octets) * BITS_PER_CHAR
        place = self._bits_left
        flips: dict[int, int] = {}
        while place < size:
            number, bit = divmod(int(place), BITS_PER_CHAR)
            flips[number] = flips.get(number, 0) | 1 << bit
            place += 1 + self._next_gap()
        self._bits_left = place - size
        self.damaged += len(flips)
        return flips

    def strike(self, octets: bytes) -> bytes:
        """``octets`` without the damaged ones."""
        return intact(octets, self.flips(octets))

    def _next_gap(self) -> float:
        if not self.error_rate:
            return math.inf
        return math.floor(math.log(1 - self._rng.random()) / self._log_good)
