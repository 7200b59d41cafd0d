"""Stories of a token ring by seed: masters that come and go, slaves of octets, lost and damaged telegrams, noise.

``python tests/kits/stories ring`` writes ``tests/snapshots/ring_stories.jsonl``, one line a story. A transmission is
the idle time before it in bits and its octets (``2>3`` is a token from 2 to 3), with ``!`` if it was damaged. A
sequence that repeats itself stands in brackets, with its number.
"""

from __future__ import annotations

import json
import random
from collections.abc import Iterator, Sequence
from pathlib import Path

from ring_bus import ListUser, RingBus, Sent

from dpstack.errors import DpError
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOffline, GoOnline
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import Req
from dpstack.machine import HeldUp, LineDown, LineUp
from dpstack.phy.patience import EXACT, Patience

SNAPSHOT = Path(__file__).parents[2] / "snapshots" / "ring_stories.jsonl"
STORIES = 40
_ADDRESSES = (0, 1, 2, 3, 5, 8)
_SLAVES = (4, 6, 9)
#: of a port that delivers late
_LATE = Patience(known_ns=500_000, unknown_ns=300_000, unknown_divisor=4, stall_ns=200_000, sending_ns=100_000)
_REQUESTS = (
    Request(4, Req.SRD_HIGH, b"\1\2"),
    Request(4, Req.SRD_LOW, b"", 60, 62),
    Request(6, Req.SDA_LOW, b"\3", patient=True),
    Request(9, Req.SRD_HIGH, b"", 60, 62, retry=False),
    Request(6, Req.FDL_STATUS),
    Request(127, Req.SDN_HIGH, b"\0\0", 58, 62),
    Request(77, Req.SRD_LOW, b"\5", 61, 62),
    Request(4, Req.SRD_HIGH, b"\1\2", restart=True, extra_ns=100_000),
)


class _Slave:
    """Answers with octets; now and then with others, late, or not at all."""

    def __init__(self, address: int, dice: random.Random) -> None:
        self._address = address
        self._dice = dice
        self.trouble = 0.0

    def __call__(self, octets: bytes, now: int) -> tuple[int, bytes] | None:
        saps = octets[0] == 0x68 and octets[4] & 0x80
        da, sa, fc = octets[1:4] if octets[0] == 0x10 else (octets[4] & 0x7F, octets[5] & 0x7F, octets[6])
        if not fc & 0x40 or fc & 0x0F not in (3, 5, 9, 12, 13):
            return None
        if fc & 0x0F == 9:
            answer = self._sd1(sa, 0)
        elif fc & 0x0F in (3, 5):
            answer = b"\xe5"
        else:
            head = bytes((sa | 0x80, da | 0x80, 8, octets[8], octets[7])) if saps else bytes((sa, da, 8))
            answer = self._sd2(head + b"\xaa\xbb")
        if self._dice.random() < self.trouble:
            answer = self._dice.choice(
                (b"", answer[:-2], self._sd1(sa, 3), self._sd1(sa, 2), self._sd1(sa ^ 1, 0), b"\xe5", bytes(4))
            )
        delay = self._dice.choice((11, 11, 37, 60))
        if self._dice.random() < self.trouble / 4:
            delay = 400
        return (delay, answer) if answer else None

    def _sd1(self, da: int, fc: int) -> bytes:
        return bytes((0x10, da, self._address, fc, da + self._address + fc & 0xFF, 0x16))

    @staticmethod
    def _sd2(body: bytes) -> bytes:
        return bytes((0x68, len(body), len(body), 0x68)) + body + bytes((sum(body) & 0xFF, 0x16))


def _shown(log: Sequence[Sent], bus: RingBus) -> Iterator[str]:
    end = 0
    for sent in log:
        octets = sent.octets
        named = f"{octets[2]}>{octets[1]}" if octets[0] == 0xDC and len(octets) == 3 else octets.hex()
        yield f"{(sent.start - end) * bus.baud // 1_000_000_000} {named}{'!' * sent.garbled}"
        end = max(end, sent.end)


def _squeezed(entries: list[str]) -> str:
    """Sequences of up to eight entries that come three times or more in brackets."""
    found: list[str] = []
    at = 0
    while at < len(entries):
        for period in range(1, 9):
            block = entries[at : at + period]
            times = 1
            while entries[at + times * period : at + (times + 1) * period] == block:
                times += 1
            if times > 2:
                found.append(f"({', '.join(block)})*{times}")
                at += times * period
                break
        else:
            found.append(entries[at])
            at += 1
    return ", ".join(found)


class _Story:
    def __init__(self, seed: int) -> None:
        self.dice = dice = random.Random(seed)
        self.bus = RingBus(dice.choice((500_000, 500_000, 187_500, 9_600)), dice.choice(("whole", "octets", "chunk")))
        self.users: dict[int, ListUser] = {}
        self.slaves = {address: _Slave(address, dice) for address in _SLAVES}
        self.bus.slaves.update({address: slave for address, slave in self.slaves.items() if dice.random() < 0.8})
        self.loss = 0.0
        self.bus.drop = lambda sent: bool(self.loss) and dice.random() < self.loss
        self.patience = dice.choice((EXACT, EXACT, _LATE))
        self.lines: list[str] = []
        self._told = 0
        for address in dice.sample(_ADDRESSES, dice.choice((1, 2, 2, 3))):
            self.join(address)

    def join(self, address: int) -> None:
        user = self.users[address] = ListUser()
        gap, hsa = self.dice.choice((0, 1, 3)), self.dice.choice((8, 10))
        self.bus.master(address, user, patience=self.patience, gap=gap, hsa=hsa)

    def pick(self) -> ActiveStation | None:
        return self.dice.choice(self.bus.stations) if self.bus.stations else None

    def tell(self, line: str) -> None:
        self.lines.append(line)

    def run(self, bits: int) -> None:
        """Go on, and write down transmissions, events and ends of requests."""
        self.bus.run_bits(bits)
        new = self.bus.log[self._told :]
        told = _squeezed(list(_shown(self.bus.log, self.bus))[self._told :]) if new else ""
        self._told = len(self.bus.log)
        self.tell(told or "silence")
        for event in self.bus.events:
            self.tell(f"{event.t_ns // 1000} {event.text}")
        self.bus.events.clear()
        for address, user in self.users.items():
            for request, outcome, at in user.results:
                name = outcome.name if isinstance(outcome, Failure) else f"{outcome.fc:X} {outcome.data.hex()}"
                self.tell(f"{at // 1000} {address}: {request.da}/{request.dsap} {name}")
            user.results.clear()

    def happen(self) -> None:
        dice, bus = self.dice, self.bus
        station = self.pick()
        match dice.randrange(14):
            case 0 | 1 | 2 | 3 | 4:
                if station is not None:
                    user = self.users[station.address]
                    for _ in range(dice.choice((1, 3))):
                        dice.choice((user.high, user.low)).append(dice.choice(_REQUESTS))
                    self.tell(f"{station.address} has requests")
                    return
            case 5:
                self.loss = dice.choice((0.0, 0.05, 0.2))
                self.tell(f"loss {self.loss}")
            case 6:
                for slave in self.slaves.values():
                    slave.trouble = dice.choice((0.0, 0.0, 0.3))
            case 7:
                free = [one for one in _ADDRESSES if one not in {each.address for each in bus.stations}]
                if free and len(bus.stations) < 4:
                    self.join(dice.choice(free))
                    self.tell(f"{bus.stations[-1].address} joins")
            case 8:
                if station is not None and len(bus.stations) > 1:
                    bus.kill(station)
                    self.tell(f"{station.address} dies")
            case 9:
                octets = dice.choice((b"\xdc\x02\x05", b"\xdc\x03\x01", b"\0", b"\x10\x02", bytes(6), b"\xdc\x7f\x7f"))
                bus.transmit(octets, bus.now, -1)
            case 10:
                bus.deaf = {station} if station is not None and dice.random() < 0.5 else set()
                self.tell(f"deaf {len(bus.deaf)}")
            case _:
                if station is not None:
                    order = dice.choice(
                        (GoOffline(), GoOnline(), GoOnline(), LineDown("cut"), LineUp(), HeldUp(2_000_000, "held up"))
                    )
                    try:
                        bus.command(station, order)
                        self.tell(f"{station.address} {order}")
                    except DpError as error:
                        self.tell(f"{station.address} {order}: {error}")


def story(seed: int) -> str:
    """The transcript of one story."""
    told = _Story(seed)
    told.run(6_000)
    for _ in range(16):
        told.happen()
        told.run(told.dice.choice((150, 600, 2_000)))
    for station in told.bus.stations:
        told.tell(f"{station.address}: {station.state.name} {sorted(station.las)} {station.stats}")
    return "|".join(told.lines)


def lines(seeds: range) -> list[str]:
    """The lines of the snapshot for these seeds."""
    return [json.dumps([seed, story(seed)], ensure_ascii=False) for seed in seeds]
