"""A station that only listens and delivers each transmission of the line. It never sends.

It is a protocol machine like every other station: the drivers run it on a port, the virtual world hands it telegrams.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from msgspec.structs import replace

from dpstack.capture.cutter import Cutter
from dpstack.capture.transmission import Transmission
from dpstack.errors import UsageError
from dpstack.fdl.baud_search import AutoBaud, BaudFound
from dpstack.fdl.codec import EMPTY_LE, encode, fcs
from dpstack.fdl.telegram import ED, Kind, Telegram
from dpstack.machine import LineDown, LineUp, RateRefused
from dpstack.params import T_SYN
from dpstack.trace import Event
from dpstack.units import NEVER, NOW, bits_to_ns

#: This many octets in a row that belong to no telegram mean that the rate of the bus has changed.
_OTHER_RATE: Final = 2_000

#: called with each transmission, in the order of their times
OnTransmission = Callable[[Transmission], None]


class Listener:
    """Listens at ``baud`` bit/s; None: finds the rate first, and again if it changes.

    Each transmission goes to ``on_transmission``; its time is the machine's time plus ``epoch_ns``. ``slack_ns``: delay
    of the port; ``settle_ns``, ``silence_ns``, ``limit_ns``: see :class:`AutoBaud`. Events: :class:`BaudFound`, at each
    rate found; :class:`BaudNotFound` if a search is limited, which is then over.
    """

    #: a listening station has no address
    address: Final = -1
    hears_all: Final = True
    held_up: Final = None

    def __init__(
        self,
        now: int,
        on_transmission: OnTransmission,
        *,
        baud: int | None = None,
        epoch_ns: int = 0,
        slack_ns: int = 0,
        settle_ns: int = 0,
        silence_ns: int = NEVER,
        limit_ns: int = NEVER,
    ) -> None:
        self._on_transmission = on_transmission
        self._epoch_ns = epoch_ns
        self._slack_ns = slack_ns
        self._settle_ns = settle_ns
        self._silence_ns = silence_ns
        self._limit_ns = limit_ns
        self._fixed = baud is not None
        self._events: list[Event] = []
        self._search: AutoBaud | None = None
        self._cutter: Cutter | None = None
        self._unread = 0  # octets in a row that belong to no telegram
        if baud is None:
            self._begin_search(now)
        else:
            self._listen_at(baud)

    @property
    def baud(self) -> int:
        """The rate to listen at now, in bit/s."""
        if self._search is not None:
            return self._search.baud
        assert self._cutter is not None
        return self._cutter.baud

    @property
    def found(self) -> int | None:
        """The rate of the bus in bit/s; None while it is searched for."""
        return None if self._cutter is None else self._cutter.baud

    def receive(self, chunk: bytes, now: int) -> int:
        if self._search is not None:
            self._search.receive(chunk, now)
            self._end_search()
        elif self._cutter is not None:
            self._deliver(self._cutter.feed(chunk, now), now)
        return self.wake_at()

    def telegram(self, telegram: Telegram, now: int) -> None:
        """A whole telegram, decoded by the virtual medium."""
        if self._search is not None:
            self._search.telegram(telegram, now)
            self._end_search()
        elif self._cutter is not None:
            self._deliver([*self._cutter.give_up(), *self._cutter.feed(_octets(telegram), now)], now)

    def activity(self, now: int) -> None:
        """Ignored: the time of a transmission follows from the end of its octets."""

    def sent(self, at: int) -> int:
        """Never called: it sends nothing."""
        return NOW

    def take_tx(self, now: int) -> None:
        """It only ends what is due."""
        if self._search is not None:
            self._search.wake(now)
            self._end_search()
        elif self._cutter is not None and self._cutter.stall_at() <= now:
            self._deliver(self._cutter.give_up(), now)

    def wake_at(self) -> int:
        if self._search is not None:
            return self._search.wake_at()
        return NEVER if self._cutter is None else self._cutter.stall_at()

    def take_events(self) -> list[Event]:
        events, self._events = self._events, []
        return events

    def command(self, command: object, now: int) -> None:
        """Commands of a driver. Raises ConfigError if the port can do no rate, UsageError on other commands."""
        match command:
            case LineDown() | LineUp():
                if self._search is not None:
                    self._search.command(command, now)
                elif self._cutter is not None:
                    self._deliver(self._cutter.give_up(), now)
            case RateRefused() if self._search is not None:
                self._search.command(command, now)
            case RateRefused(reason=reason):
                raise UsageError(reason)
            case _:
                raise UsageError(f"a station that only listens knows no {type(command).__name__}")

    # --- inside ---
    def _begin_search(self, now: int) -> None:
        self._cutter = None
        self._search = AutoBaud(
            now,
            silence_ns=self._silence_ns,
            limit_ns=self._limit_ns,
            slack_ns=self._slack_ns,
            settle_ns=self._settle_ns,
        )

    def _end_search(self) -> None:
        search = self._search
        if search is None or search.result is None:
            return
        self._events += search.take_events()
        if isinstance(search.result, BaudFound):
            self._listen_at(search.result.baud)

    def _listen_at(self, baud: int) -> None:
        self._search = None
        self._unread = 0
        self._cutter = Cutter(baud, bits_to_ns(T_SYN, baud) + self._slack_ns, self._epoch_ns)

    def _deliver(self, transmissions: list[Transmission], now: int) -> None:
        for one in transmissions:
            self._on_transmission(one)
            self._unread = self._unread + len(one.octets) if one.damage else 0
        if self._unread > _OTHER_RATE and not self._fixed and self._cutter is not None:
            for one in self._cutter.give_up():
                self._on_transmission(one)
            self._begin_search(now)


def _octets(telegram: Telegram) -> bytes:
    """The octets of ``telegram``, also of the two kinds that this project accepts and never sends."""
    if telegram.kind is Kind.SD3:
        body = encode(replace(telegram, kind=Kind.SD2))[4:]
        return bytes((Kind.SD3,)) + body  # without LE; the FCS is the same
    if telegram.empty_le3:
        body = bytes((telegram.da, telegram.sa, telegram.fc))
        return bytes((Kind.SD2, EMPTY_LE, EMPTY_LE, Kind.SD2)) + body + bytes((fcs(body), ED))
    return encode(telegram)
