"""Transmissions one after another under the eyes of the referee.

Times at 500 kbit/s: a bit is 2 us. Preset there: T_SL 200, T_ID1 37, T_ID2 100, T_TO of station 2 is 10 T_SL = 2000.
"""

from __future__ import annotations

from support import Dummy, WorldFactory

from dpstack.params import BusParams
from dpstack.sim.token_watch import Rule
from dpstack.sim.world import World
from dpstack.units import chars_to_ns

BIT = 2_000
T_TO_2 = 2_000
PARAMS = BusParams.preset(500_000, address=2)

TOKEN = bytes.fromhex("DC 02 02")
ASK = bytes.fromhex("10 05 02 49 50 16")
ANSWER = bytes.fromhex("10 02 05 00 07 16")


#: sender, pause in bits, octets
Sent = tuple[object, int, bytes]


class Script:
    """Transmissions one after another, each ``pause`` bits after the one before has ended; then the verdict."""

    def __init__(self, world: WorldFactory, *, seed: int = 0, know: bool = True) -> None:
        self.world: World = world(seed=seed)
        assert self.world.referee is not None
        self.referee = self.world.referee
        self.stations: dict[object, Dummy] = {}
        self.at = 0
        if know:
            self.referee.know(PARAMS)

    def send(self, sender: object, pause: int, octets: bytes) -> None:
        """``sender`` is any name; a name of its own is a station of its own."""
        station = self.stations.get(sender)
        if station is None:
            station = self.stations[sender] = Dummy(octets[2] & 0x7F if len(octets) > 2 else 5)
            self.world.add(station, name=str(sender))
        self.at += pause * BIT
        station.plan.append((self.at, octets))
        self.world.poke(station)
        self.at += chars_to_ns(len(octets), 500_000)
        self.world.run_until(self.at)

    def play(self, *sent: Sent) -> None:
        for one in sent:
            self.send(*one)

    def claim(self, sender: object = "m2") -> None:
        self.send(sender, T_TO_2, TOKEN)

    def verdict(self) -> list[Rule]:
        """What was found; the fixture's check has nothing left to complain of."""
        self.world.run_for(1_000_000)
        found = [violation.rule for violation in self.referee.violations]
        self.referee.violations.clear()
        return found
