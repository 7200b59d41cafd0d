"""The line behind emulated adapters: pace, echo, a far end on a tty, damage, and noise with a seed."""

from __future__ import annotations

import os
import tty
from collections.abc import Callable, Sequence
from random import Random
from typing import Final

from vm_chips import BITS, Character, Chip, Host

_SD2: Final = 0x68


def with_noise(octets: bytes, random: Random, per_bit: float) -> list[Character]:
    """``octets`` as a UART receives them where each bit of a character is inverted with the probability ``per_bit``:
    the parity shows an odd number of errors, the stop bit and the start bit show theirs."""
    characters: list[Character] = []
    for octet in octets:
        flips = sum(1 << bit for bit in range(BITS) if random.random() < per_bit)
        data = flips >> 1 & 0xFF
        parity_shows = (flips >> 1 & 0x1FF).bit_count() & 1
        characters.append((octet ^ data, bool(parity_shows or flips & 1 or flips >> 10)))
    return characters


def swapped(octets: bytes) -> list[Character] | None:
    """An answer with data in which 01 00 arrives as 00 01: a parity error in both octets, and the same sum."""
    at = octets.find(b"\x01\x00", 7) if octets[:1] == bytes((_SD2,)) else -1
    if at < 0:
        return None
    damaged = octets[:at] + b"\x00\x01" + octets[at + 2 :]
    return [(octet, number in (at, at + 1)) for number, octet in enumerate(damaged)]


class Line:
    """One line with the chips of this program and, perhaps, a tty at its far end."""

    def __init__(self, host: Host) -> None:
        self.host = host
        self.chips: list[Chip] = []
        self.echo = False
        self.swap = False
        self.per_bit = 0.0
        self.random = Random(0)
        self.far = -1
        #: the rate of the stations at the far end, which understand no other; 0: any
        self.far_baud = 0
        self.sent = 0
        self._free: dict[Chip, float] = {}
        self._far_free = 0.0

    def open_far(self, path: str) -> int:
        self.far = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self.far)
        return self.far

    def send(self, chip: Chip, octets: bytes) -> float:
        """``chip`` sends; returns when the last bit has left."""
        self.sent += len(octets)
        end = max(self._free.get(chip, 0.0), self.host.now()) + len(octets) * BITS / max(chip.real, 50)
        self._free[chip] = end
        self.host.later(end, lambda: self._sent(chip, octets))
        return end

    def _sent(self, chip: Chip, octets: bytes) -> None:
        if self.far >= 0:
            if self._far_understands(chip):
                os.write(self.far, octets)
        elif len(self.chips) == 1 and not self.echo:
            self.host.log("line", octets=octets.hex())
        for other in self.chips:
            if other is not chip or self.echo:
                other.receive(self._heard(chip, other, octets))

    def _far_understands(self, chip: Chip) -> bool:
        """Whether the far end has the same rate and even parity."""
        return not self.far_baud or (abs(chip.real / self.far_baud - 1) < 0.04 and chip.parity == "E")

    def _heard(self, chip: Chip, other: Chip, octets: bytes) -> list[Character]:
        legible = abs(other.real / max(chip.real, 1) - 1) < 0.04
        return [(octet if legible else octet ^ 0xA5, not legible or chip.parity != other.parity) for octet in octets]

    def far_readable(self) -> bool:
        """Octets of the far end: they take their time on the line. False: the far end has gone."""
        try:
            octets = os.read(self.far, 4096)
        except OSError:
            return False
        chip = self.chips[0]
        end = max(self._far_free, self.host.now()) + len(octets) * BITS / max(chip.real, 50)
        self._far_free = end
        characters: Sequence[Character] | None = swapped(octets) if self.swap else None
        if not self._far_understands(chip):
            characters = [(octet ^ 0xA5, True) for octet in octets]
        elif characters is None:
            characters = with_noise(octets, self.random, self.per_bit)
        if any(bad for _, bad in characters) or bytes(octet for octet, _ in characters) != octets:
            arrived = bytes(octet for octet, _ in characters)
            self.host.log("damage", sent=octets.hex(), arrived=arrived.hex(), marks=sum(bad for _, bad in characters))
        self.host.later(end, _receiver(chip, characters))
        return True


def _receiver(chip: Chip, characters: Sequence[Character]) -> Callable[[], None]:
    return lambda: chip.receive(characters)
