"""One station of a segment: its pty, its receiver, counters of octets and telegrams before noise."""

from __future__ import annotations

import os
from dataclasses import dataclass

from dpstack.fdl.decoder import Decoder
from dpstack.phy.uart import Receiver, flipped, waveform
from dpstack.ports.pty import PtyMaster
from dpstack.units import NEVER


@dataclass(slots=True)
class StationStats:
    """Counters of one station.

    Octets: ``sent``, ``received``, ``dropped`` (its pty was full), ``overrun`` (beyond the capacity of a paced wire).
    Telegrams it sent: ``telegrams`` in all, ``damaged`` those with an inverted bit, ``erased`` the damaged ones without
    any octet left, which no receiver can notice.
    """

    path: str
    sent: int = 0
    received: int = 0
    dropped: int = 0
    overrun: int = 0
    telegrams: int = 0
    damaged: int = 0
    erased: int = 0


class SegmentStation:
    """A pty of the segment and its state."""

    __slots__ = (
        "_arrived",
        "_damaged",
        "_receiver",
        "_telegrams",
        "master",
        "present",
        "reported",
        "silent_until",
        "stats",
    )

    def __init__(self, master: PtyMaster, link: str) -> None:
        self.master = master
        self.present = False
        #: it neither sends nor receives before this time (ns)
        self.silent_until = 0
        self.stats = StationStats(link)
        #: notices about this station that were reported; each is reported once
        self.reported: set[str] = set()
        self._receiver: Receiver | None = None  # while senders have another rate
        # finds the ends of its telegrams, before noise
        self._telegrams = Decoder(stall_ns=NEVER)
        self._damaged = self._arrived = False  # of the telegram it is sending: by noise; at least one octet

    def on_hang_up(self) -> None:
        """Note that no program has the station's pty open any more."""
        if self.present:
            self.present = False
            self.master.discard_unread()
            self._telegrams.reset()
            self._damaged = self._arrived = False

    def transmit(self, octets: bytes, flips: dict[int, int]) -> bytes:
        """It sends ``octets`` with the bits ``flips`` inverted: the octets that UARTs at its rate receive.

        A UART drops a character with a parity or framing error; two inverted bits may give another valid octet.
        """
        stats, telegrams = self.stats, self._telegrams
        if not flips and not telegrams.pending:
            stats.telegrams += len(telegrams.feed(octets, 0))
            self._damaged, self._arrived = False, bool(telegrams.pending)
            return octets
        arrived = bytearray()
        for number, octet in enumerate(octets):
            mask = flips.get(number, 0)
            got = flipped(octet, mask) if mask else octet
            if got is not None:
                arrived.append(got)
            self._damaged |= bool(mask)
            self._arrived |= got is not None
            found = len(telegrams.feed(octets[number : number + 1], 0))
            stats.telegrams += found
            if found and self._damaged:
                stats.damaged += 1
                stats.erased += not self._arrived
            if not telegrams.pending:
                self._damaged = self._arrived = False
        return bytes(arrived)

    def misread(self, octets: bytes, baud: int, reading: int, start_ns: int, flips: dict[int, int]) -> bytes:
        """Octets that its UART at ``reading`` bit/s receives of ``octets`` sent at ``baud`` from ``start_ns`` on."""
        receiver = self._receiver
        if receiver is None or receiver.baud != reading:
            receiver = self._receiver = Receiver(reading)
        received = receiver.idle(start_ns)
        received += receiver.sample(start_ns, waveform(octets, flips), baud)
        return bytes(character.octet for character in received if character.good)

    def deliver(self, octets: bytes) -> bool:
        """Write ``octets`` to its pty; False when that is full."""
        try:
            done = os.write(self.master.fd, octets)
        except OSError:  # full, or closed this very moment
            done = 0
        self.stats.received += done
        self.stats.dropped += len(octets) - done
        return done == len(octets)
