"""Real devices of the table of faults: slaves that misbehave, a babbler, a slave that reboots, noise on one stub."""

from __future__ import annotations

from dataclasses import dataclass, field
from random import Random
from typing import Any

from dpstack.dp.pdu.diag_blocks import UserDiag
from dpstack.dp.slave.application import SlaveApp
from dpstack.dpv1.slave.device import Device
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.fdl.interface import RS_REPLY, Reply
from dpstack.fdl.passive.station import PassiveStation
from dpstack.fdl.telegram import Telegram
from dpstack.sim.transmission import Transmission
from dpstack.trace import Event
from dpstack.units import NEVER, NOW, bits_to_ns, chars_to_ns


class Picky(MirrorDevice):
    """Accepts ``wanted`` as user parameters and nothing else; a bad length is refused as such."""

    def __init__(self, ident: int, config: bytes, wanted: bytes, **more: Any) -> None:
        super().__init__(ident, config, **more)
        self.wanted = wanted

    def check_prm(self, user_prm: bytes) -> str | None:
        if len(user_prm) != len(self.wanted):
            return f"{len(user_prm)} octets of user parameters, {len(self.wanted)} are needed"
        pairs = enumerate(zip(user_prm, self.wanted, strict=True), 8)
        return next((f"octet {number} is {got:02X}" for number, (got, good) in pairs if got != good), None)


class DpV0Only(MirrorDevice):
    """Knows no DP-V1: refuses parameters with DPV1_Enable in the first octet."""

    def check_prm(self, user_prm: bytes) -> str | None:
        return "DPV1_Enable" if user_prm and user_prm[0] & 0x80 else None


class NeedsDpV1(MirrorDevice):
    """Works only with a DP-V1 master: refuses parameters without DPV1_Enable."""

    def check_prm(self, user_prm: bytes) -> str | None:
        return None if user_prm and user_prm[0] & 0x80 else "no DPV1_Enable"


class Ill(MirrorDevice):
    """Reports a static diagnosis for good: its supply of 24 V is missing, say."""

    ext = b""

    def user_diag(self) -> UserDiag:
        return UserDiag(self.ext, bool(self.ext), True)


class RefusesService(SlaveApp):
    """Answers RS to one service, ``dsap`` (None: Data_Exchange); ``refused_service`` counts."""

    def __init__(self, device: Device, dsap: int | None) -> None:
        super().__init__(device)
        self._closed = dsap
        self.refused_service = 0

    def serve(self, request: Telegram, now: int) -> Reply | None:
        if request.dsap == self._closed:
            self.refused_service += 1
            return RS_REPLY
        return super().serve(request, now)


class Hasty(PassiveStation):
    """Answers sooner than the 11 bit times that a master has to turn its transmitter round."""

    def set_min_tsdr(self, bits: int) -> None:
        super().set_min_tsdr(bits)
        self._t_sdr_ns = self.params.ns(4)


class Deaf:
    """A station that only sends leaves out all that it receives."""

    held_up: None = None

    def receive(self, chunk: bytes, now: int) -> int:
        return NOW

    def telegram(self, telegram: Telegram, now: int) -> None:
        pass

    def activity(self, now: int) -> None:
        pass

    def sent(self, at: int) -> int:
        return NOW

    def take_events(self) -> list[Event]:
        return []

    def command(self, command: object, now: int) -> None:
        pass


@dataclass(eq=False)
class Babbler(Deaf):
    """A station that sends noise from ``start_ns`` on and leaves no silence."""

    rng: Random
    start_ns: int = 0
    baud: int = 500_000
    address: int = 126
    hears_all: bool = False
    chunks: int = 0
    _free_ns: int = field(default=0)

    def take_tx(self, now: int) -> bytes | None:
        if now < self.wake_at():
            return None
        octets = bytes(self.rng.choice((0x00, 0xFF, 0x55, self.rng.randrange(256))) for _ in range(60))
        self.chunks += 1
        self._free_ns = now + chars_to_ns(len(octets), self.baud)
        return octets

    def wake_at(self) -> int:
        return max(self.start_ns, self._free_ns)


@dataclass(eq=False)
class RudeMaster(Deaf):
    """A master that never listened whether its address is free: every ``period_ns`` it asks one of ``slaves`` for its
    diagnosis, in the next pause between two telegrams of the others."""

    address: int
    slaves: list[int]
    start_ns: int
    period_ns: int
    baud: int
    hears_all: bool = True
    requests: int = 0
    _at: int = NEVER

    def telegram(self, telegram: Telegram, now: int) -> None:
        if now >= self.start_ns:
            self._at = now + bits_to_ns(20, self.baud)

    def activity(self, now: int) -> None:
        self._at = NEVER

    def take_tx(self, now: int) -> bytes | None:
        if now < self._at:
            return None
        slave = self.slaves[self.requests % len(self.slaves)]
        self.requests += 1
        self._at = NEVER
        self.start_ns = now + self.period_ns
        body = bytes((slave | 0x80, self.address | 0x80, 0x6D, 60, 62))
        return bytes((0x68, len(body), len(body), 0x68)) + body + bytes((sum(body) & 0xFF, 0x16))

    def wake_at(self) -> int:
        return self._at


class Share:
    """Selects a share of the transmissions that ``which`` of them are: of one slave, or to it."""

    def __init__(self, rng: Random, share: float, address: int, *, to: bool = False) -> None:
        self._rng = rng
        self._share = share
        self._address = address
        self._to = to
        self.hits = 0

    def __call__(self, tx: Transmission) -> bool:
        telegram = tx.telegram
        if self._to:
            mine = telegram is not None and telegram.da == self._address and telegram.fc & 0x40 > 0
        else:
            mine = tx.sender == f"slave {self._address}"
        hit = mine and self._rng.random() < self._share
        self.hits += hit
        return hit
