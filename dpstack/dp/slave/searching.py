"""A machine around what listens at one rate: deaf to the bus until the rate is found, and again once it is lost.

When it is lost is told in :mod:`dpstack.dp.slave.baud_control`; around what: :mod:`dpstack.dp.slave.auto_baud` one
station, :mod:`dpstack.dp.slave.searching_port` all of a port.
"""

from __future__ import annotations

import abc
from typing import Protocol

from dpstack.dp.slave.baud_control import BaudState, BaudWatch
from dpstack.fdl.decoder import DecoderStats
from dpstack.machine import LineDown, LineUp, Machine, RateRefused
from dpstack.params import BusParams
from dpstack.trace import Event


class Listener(Machine, Protocol):
    """What hears at one rate."""

    @property
    def params(self) -> BusParams:
        """Rate and times."""

    @property
    def decoder_stats(self) -> DecoderStats:
        """The counters of its receiver."""

    def set_params(self, params: BusParams) -> None:
        """Take rate and times; what was pending is forgotten."""


class Searching(abc.ABC):
    """A machine around ``listener``. Who derives gives ``_watch``, whose callbacks are its own methods."""

    __slots__ = ("_events", "_listener", "_watch")

    _watch: BaudWatch

    def __init__(self, listener: Listener) -> None:
        self._listener = listener
        self._events: list[Event] = []

    @property
    def state(self) -> BaudState:
        """Of the watch over the rate."""
        return self._watch.state

    @property
    def baud(self) -> int:
        """The rate to listen at now, in bit/s."""
        return self._watch.baud

    # --- Machine ---
    def receive(self, chunk: bytes, now: int) -> None:
        """Octets from the line, at whatever rate it listens."""
        if self._watch.searching:
            self._watch.octets(chunk, now)
            return
        telegrams = self._listener.decoder_stats.telegrams
        self._listener.receive(chunk, now)
        if self._listener.decoder_stats.telegrams > telegrams:
            self._watch.heard(now)

    def sent(self, at: int) -> None:
        """The answer leaves the line at ``at``."""
        self._listener.sent(at)

    def wake(self, now: int) -> None:
        """Judge the search or the silence; applications have their time in every state."""
        self._listener.wake(now)
        self._watch.wake(now)

    def take_tx(self, now: int) -> bytes | None:
        """The answer under way; none while the rate is not known."""
        return None if self._watch.searching else self._listener.take_tx(now)

    def wake_at(self) -> int:
        """The listener's deadlines, those of the search, the end of patience with silence."""
        return min(self._listener.wake_at(), self._watch.wake_at())

    def take_events(self) -> list[Event]:
        """Its own events and the listener's."""
        events, self._events = self._events, []
        return events + self._listener.take_events()

    def command(self, command: object, now: int) -> None:
        """:class:`LineDown`, :class:`LineUp`, :class:`RateRefused` from the driver; UsageError on anything else."""
        if isinstance(command, RateRefused):
            self._watch.refused(now)
            return
        self._listener.command(command, now)
        if isinstance(command, (LineDown, LineUp)):
            self._watch.begin_anew()

    # --- for the watch ---
    def _found(self, params: BusParams, now: int) -> None:
        self._listener.set_params(params)

    def _reached(self, state: BaudState, now: int) -> None:
        if state is BaudState.SEARCH:
            self._listener.set_params(self._listener.params)  # what is pending is forgotten
            self._lost(now)
        self._events.append(self._told(state, None if state is BaudState.SEARCH else self._watch.baud, now))

    @abc.abstractmethod
    def _lost(self, now: int) -> None:
        """The rate is lost."""

    @abc.abstractmethod
    def _told(self, state: BaudState, baud: int | None, now: int) -> Event:
        """What is told of a state; ``baud`` in bit/s, None while it is searched."""
