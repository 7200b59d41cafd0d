"""A master that is not ours, written from octets: answers FDL status, takes the token, says its piece, passes it on."""

from __future__ import annotations

from dataclasses import dataclass, field

from dpstack.fdl.telegram import Telegram
from dpstack.trace import Event
from dpstack.units import NEVER, NOW


def fdl_status(da: int, sa: int) -> bytes:
    """The octets of an FDL status request."""
    return bytes((0x10, da, sa, 0x49, (da + sa + 0x49) & 0xFF, 0x16))


#: silence before what it sends, and after a request that nobody answers
GAP_BITS = 40
SLOT_BITS = 210


@dataclass
class ForeignMaster:
    """``ns`` gets its token. In each hold it sends ``says``; then the token.

    ``ready``: it asks to be let in. ``holds``: so many tokens it passes on, then it keeps the next one and is silent.
    """

    address: int
    ns: int
    says: tuple[bytes, ...] = ()
    ready: bool = True
    holds: int = 1 << 30
    baud: int = 500_000
    tokens: int = 0
    in_ring: bool = False
    held_up: None = None
    plan: list[tuple[int, bytes]] = field(default_factory=list)

    @property
    def hears_all(self) -> bool:
        return True

    def bits(self, count: int) -> int:
        return count * 1_000_000_000 // self.baud

    def token(self) -> bytes:
        return bytes((0xDC, self.ns, self.address))

    # --- the machine ---
    def telegram(self, telegram: Telegram, now: int) -> None:
        kind, da, sa, fc = telegram.kind, telegram.da, telegram.sa, telegram.fc
        if da != self.address:
            return
        if kind == 0x10 and fc == 0x49 and self.ready:
            status = 0x30 if self.in_ring else 0x20
            octets = bytes((0x10, sa, self.address, status, (sa + self.address + status) & 0xFF, 0x16))
            self.plan = [(now + self.bits(20), octets)]
        elif kind == 0xDC and self.ready:
            self.tokens += 1
            self.in_ring = True
            if self.tokens <= self.holds:
                self.speak(now)

    def speak(self, now: int) -> None:
        """Plan the telegrams of one token hold from ``now`` on."""
        gap = GAP_BITS
        for octets in (*self.says, self.token()):
            start = now + self.bits(gap)
            self.plan.append((start, octets))
            now = start + self.bits(11 * len(octets))
            gap = SLOT_BITS if octets[0] == 0x10 else GAP_BITS

    def receive(self, chunk: bytes, now: int) -> int:
        return NOW

    def activity(self, now: int) -> None:
        pass

    def sent(self, at: int) -> int:
        return NOW

    def wake_at(self) -> int:
        return self.plan[0][0] if self.plan else NEVER

    def take_tx(self, now: int) -> bytes | None:
        return self.plan.pop(0)[1] if self.plan and self.plan[0][0] <= now else None

    def take_events(self) -> list[Event]:
        return []

    def command(self, command: object, now: int) -> None:
        pass
