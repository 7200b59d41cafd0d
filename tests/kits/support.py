"""Kit of every layer: worlds with a referee, the decoded wire log, dummy stations, values narrowed to their types.

In a test ask for the fixture ``world``: ``w = world(seed=3)`` makes a World whose referee is checked at the end.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TypeVar

from dpstack.decode.wire_log import render
from dpstack.fdl.interface import BusStation
from dpstack.fdl.telegram import Telegram
from dpstack.sim.referee import Rule
from dpstack.sim.world import World
from dpstack.trace import Event
from dpstack.units import NEVER, NOW, chars_to_ns

US = 1_000
MS = 1_000_000
S = 1_000_000_000


E = TypeVar("E", bound=Event)
T = TypeVar("T")


def present(value: T | None) -> T:
    """The value, which must not be None."""
    assert value is not None
    return value


def instance(value: object, kind: type[T]) -> T:
    """The value, which must be of this kind."""
    assert isinstance(value, kind)
    return value


class KeepsEvents:
    """Base of the kits that keep all ``events`` of a station."""

    events: list[Event]

    def events_of(self, kind: type[E]) -> list[E]:
        """The events of one kind, oldest first. Each has a time."""
        assert all(type(event.t_ns) is int for event in self.events)
        return [event for event in self.events if isinstance(event, kind)]


class WorldFactory:
    """Makes worlds and remembers them."""

    def __init__(self) -> None:
        self.worlds: list[World] = []

    def __call__(
        self,
        *stations: BusStation,
        seed: int = 0,
        start_ns: int = 0,
        referee: bool = True,
        keep: int = 400,
        token_rules: bool = True,
        expect: Iterable[Rule] = (),
    ) -> World:
        """A world with ``stations``. ``token_rules`` False: for scripted stations without a ring.

        ``expect``: rules of the referee that the stations must break.
        """
        made = World(seed=seed, start_ns=start_ns, referee=referee, keep=keep)
        self.worlds.append(made)
        if made.referee is not None:
            made.referee.token_rules = token_rules
            made.referee.expect(*expect)
        for station in stations:
            made.add(station)
        return made

    def check(self) -> None:
        """The referee of each world judges the whole run."""
        for made in self.worlds:
            if made.referee is not None:
                made.referee.check()


def wire_log(world: World, last: int = 80) -> str:
    """The last transmissions, decoded, for people."""
    return render(list(world.log)[-last:], world.baud)


@dataclass
class Dummy:
    """A station that is a script: sends ``plan`` (time in ns, octets) and notes what it hears."""

    address: int = 1
    baud: int = 500_000
    hears_all: bool = False
    plan: list[tuple[int, bytes]] = field(default_factory=list)
    #: (delay in ns, octets) to be sent after every telegram addressed to it
    reply: tuple[int, bytes] | None = None
    heard: list[tuple[int, Telegram]] = field(default_factory=list)
    octets: list[tuple[int, bytes]] = field(default_factory=list)
    edges: list[int] = field(default_factory=list)
    ends: list[int] = field(default_factory=list)
    commands: list[object] = field(default_factory=list)
    held_up: None = None
    events: list[Event] = field(default_factory=list)
    wakes: int = 0

    def receive(self, chunk: bytes, now: int) -> int:
        self.octets.append((now, chunk))
        return self.wake_at()

    def telegram(self, telegram: Telegram, now: int) -> None:
        self.heard.append((now, telegram))
        if self.reply is not None and telegram.da == self.address:
            delay, octets = self.reply
            self.plan.append((now + delay, octets))

    def activity(self, now: int) -> None:
        self.edges.append(now)

    def sent(self, at: int) -> int:
        self.ends.append(at)
        return NOW

    def take_tx(self, now: int) -> bytes | None:
        self.wakes += 1
        if self.plan and self.plan[0][0] <= now:
            return self.plan.pop(0)[1]
        return None

    def wake_at(self) -> int:
        return self.plan[0][0] if self.plan else NEVER

    def take_events(self) -> list[Event]:
        events, self.events = self.events, []
        return events

    def command(self, command: object, now: int) -> None:
        self.commands.append(command)

    @property
    def text(self) -> bytes:
        """All octets heard one by one, in one piece."""
        return b"".join(chunk for _, chunk in self.octets)


def ends(start_ns: int, octets: bytes, baud: int = 500_000) -> int:
    """When ``octets`` that begin at ``start_ns`` are over."""
    return start_ns + chars_to_ns(len(octets), baud)


def texts(events: Iterable[Event]) -> list[str]:
    """The lines of ``events`` for people."""
    return [event.text for event in events]
