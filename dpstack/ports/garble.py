"""What a wire does to octets: noise. Seeded, so that a run can be repeated."""

from __future__ import annotations

import math
import random

from dpstack.errors import ConfigError
from dpstack.units import BITS_PER_CHAR


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

    def strike(self, octets: bytes) -> bytes:
        """``octets`` without the damaged ones."""
        if self._bits_left >= len(octets) * BITS_PER_CHAR:
            self._bits_left -= len(octets) * BITS_PER_CHAR
            return octets
        kept = bytearray()
        for octet in octets:
            if self._bits_left >= BITS_PER_CHAR:
                self._bits_left -= BITS_PER_CHAR
                kept.append(octet)
            else:
                self.damaged += 1
                self._bits_left = self._next_gap()
        return bytes(kept)

    def _next_gap(self) -> float:
        if not self.error_rate:
            return math.inf
        return math.floor(math.log(1 - self._rng.random()) / self._log_good)
