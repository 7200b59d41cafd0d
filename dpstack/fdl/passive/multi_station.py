"""Several passive stations behind one port: one decoder, one answer at a time, broadcasts to all.

A simulation of many slaves on one serial port uses this machine. The stations share the receiver: it decodes a telegram
once and passes it to its addressee. The other stations need not hear an answer, apart from one to all stations (MSRD).
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Iterable
from operator import attrgetter
from typing import Final, NamedTuple

from dpstack.errors import ConfigError, UsageError
from dpstack.fdl.codec import decode
from dpstack.fdl.commands import AtStation
from dpstack.fdl.passive.station import PassiveReceiver, PassiveStation
from dpstack.fdl.telegram import Telegram
from dpstack.machine import LineDown
from dpstack.params import BROADCAST, BusParams
from dpstack.phy.patience import EXACT, Patience
from dpstack.trace import Event
from dpstack.units import NEVER, NOW

#: place of DA in a telegram with data
_DA_AT: Final = 4
_TO_ALL: Final = bytes((BROADCAST,))


class _Unasked(NamedTuple):
    """Octets that a faulty station sends at ``at`` (ns)."""

    at: int
    octets: bytes
    station: PassiveStation


class Multidrop(PassiveReceiver):
    """The machine of a port with several passive stations. Raises ConfigError when two ``stations`` have one address.

    :meth:`add` and :meth:`remove` change the set of stations; :meth:`silence` makes a station deaf and mute for a
    while. These raise UsageError for a station that is not on the port. A station may change its address at any time;
    of two stations that come to have the same one the first answers. After a change of a station's deadline other than
    by a telegram or a tick, call :meth:`poke`.
    """

    def __init__(self, stations: Iterable[PassiveStation], params: BusParams, *, patience: Patience = EXACT) -> None:
        super().__init__(params, patience)
        self._due: dict[PassiveStation, int] = {}  # all stations with the deadlines of their applications
        self._next = NEVER  # the earliest of these deadlines
        self._index: dict[int, PassiveStation] = {}  # by address
        self._silent: dict[PassiveStation, int] = {}  # silenced stations with the end of their silence, in ns
        self._answering: PassiveStation | None = None
        self._to_all: tuple[PassiveStation, Telegram] | None = None  # an answer to all that is being sent
        self._unasked: list[_Unasked] = []  # of faulty stations, the first one first
        self.set_params(params)
        for station in stations:
            if station.address in self._index:
                raise ConfigError(
                    f"two stations with address {station.address} on one port: give one of them another address"
                )
            self.add(station)

    # --- the stations ---
    @property
    def stations(self) -> tuple[PassiveStation, ...]:
        return tuple(sorted(self._due, key=lambda station: station.address))

    def add(self, station: PassiveStation) -> None:
        """Put a station on the line. Raises ConfigError for another baud rate than that of the port."""
        if station.baud != self.params.baud:
            raise ConfigError(
                f"station {station.address} listens at {station.baud} bit/s, the port at {self.params.baud}"
            )
        self._due[station] = NEVER
        station.on_move = self._index_addresses
        self._index_addresses()
        self.poke()

    def remove(self, station: PassiveStation) -> None:
        """Take ``station`` off the line, and drop its answer."""
        self._stop_answer(station)
        del self._due[station]
        self._silent.pop(station, None)
        station.on_move = None
        self._index_addresses()
        self.poke()

    def silence(self, station: PassiveStation, until: int = NEVER) -> None:
        """Make ``station`` deaf and mute until ``until`` (ns); its application continues."""
        self._stop_answer(station)
        self._silent[station] = until

    def resume(self, station: PassiveStation) -> None:
        """End a silence early."""
        self._check(station)
        self._silent.pop(station, None)

    def silent_until(self, station: PassiveStation) -> int | None:
        """End of a station's silence in ns; None when it is not silenced."""
        self._check(station)
        return self._silent.get(station)

    def send_at(self, station: PassiveStation, octets: bytes, at: int) -> None:
        """Send ``octets`` of a faulty ``station`` at ``at`` (ns), whatever is on the line then, unless the station is
        taken off the line or silenced before."""
        insort(self._unasked, _Unasked(at, octets, station), key=attrgetter("at"))

    def poke(self) -> None:
        """Read the deadline of every station anew."""
        for station in self._due:
            station.poke()
            self._due[station] = station.due
        self._next = min(self._due.values(), default=NEVER)

    def set_params(self, params: BusParams) -> None:
        """Take baud rate and times from ``params`` for the port and all its stations; answers are dropped."""
        super().set_params(params)
        for station in self._due:
            station.set_params(params)

    # --- Machine ---
    def receive(self, chunk: bytes, now: int) -> int:
        self.line.idle_since = now  # receiving while sending implies sent
        for telegram in self.decoder.feed(chunk, now):
            self._deliver(telegram, now)
        if self._answering is not None:
            self._answering.line.note_activity(now)
        return self.wake_at()

    def wake(self, now: int) -> None:
        """Process a stalled telegram, and call the applications at their deadlines."""
        if self.decoder.stall_at() <= now:
            for telegram in self.decoder.stalled(now):
                self._deliver(telegram, now)
            if self._answering is not None:
                self._answering.drop_if_late(now)
        if self._next <= now:
            due = self._due
            for station, at in list(due.items()):
                if at <= now:
                    station.wake(now)
                    due[station] = station.due
            self._next = min(due.values(), default=NEVER)

    def take_tx(self, now: int) -> bytes | None:
        """The answer that waits, once its T_SDR is over; octets of :meth:`send_at` at their time."""
        self.wake(now)
        if self._unasked and self._unasked[0].at <= now:
            return self._unasked.pop(0).octets
        station = self._answering
        if station is None or self.decoder.pending:
            return None
        octets = station.take_tx(now)
        if octets is not None:
            self._answering = None
            if octets[_DA_AT : _DA_AT + 1] == _TO_ALL and (telegram := decode(octets)) is not None:
                self._to_all = station, telegram
        return octets

    def wake_at(self) -> int:
        """The earliest of: stall of a telegram, start of the answer, deadline of an application, :meth:`send_at`."""
        if self.decoder.pending:
            own = self.decoder.stall_at()
        elif self._answering is not None:
            own = self._answering.answer_at()
        else:
            own = self._next
        if self._unasked and self._unasked[0].at < own:
            own = self._unasked[0].at
        return own if own < self._next else self._next

    def take_events(self) -> list[Event]:
        """The events of all stations."""
        return [event for station in self._due for event in station.take_events()]

    def command(self, command: object, now: int) -> None:
        super().command(command, now)
        if not isinstance(command, AtStation):
            for station in self._due:
                station.command(command, now)
        self.poke()

    def sent(self, at: int) -> int:
        """The answer leaves the line at ``at``: the other stations of this port hear one to all."""
        self.line.idle_since = at
        if self._to_all is not None:
            (sender, telegram), self._to_all = self._to_all, None
            for station in list(self._due):
                if station is not sender:
                    self._pass_to(station, telegram, at)
        return NOW

    # --- inside ---
    def _forget(self) -> None:
        super()._forget()
        self._answering = None
        self._to_all = None
        self._unasked = []

    def _deliver(self, telegram: Telegram, now: int) -> None:
        if self._answering is not None:
            # the sender of a new telegram no longer waits for the earlier answer
            self._answering.drop()
            self._answering = None
        da = telegram.da
        if da == BROADCAST:
            for station in list(self._due):
                self._pass_to(station, telegram, now)
            return
        found = self._index.get(da)
        if found is not None:
            self._pass_to(found, telegram, now)

    def _pass_to(self, station: PassiveStation, telegram: Telegram, now: int) -> None:
        if self._silent and self._is_silent(station, now):
            return
        station.line.idle_since = self.line.idle_since
        station.process(telegram, now)
        if station.answer_at() != NEVER:
            self._answering = station
        due = self._due
        before = due[station]
        at = due[station] = station.due
        if at < self._next:
            self._next = at
        elif before == self._next and at != before:
            self._next = min(due.values())

    def _is_silent(self, station: PassiveStation, now: int) -> bool:
        until = self._silent.get(station)
        if until is None:
            return False
        if now < until:
            return True
        del self._silent[station]
        return False

    def _stop_answer(self, station: PassiveStation) -> None:
        self._check(station)
        station.command(LineDown("off the line"), self.line.idle_since)
        if self._answering is station:
            self._answering = None
        self._unasked = [one for one in self._unasked if one.station is not station]

    def _check(self, station: PassiveStation) -> None:
        if station not in self._due:
            known = ", ".join(str(s.address) for s in self.stations) or "none"
            raise UsageError(f"station {station.address} is not on this port; there are: {known}")

    def _index_addresses(self) -> None:
        """Index by the present addresses; of two stations with one address the first answers."""
        self._index = {}
        for station in self._due:
            self._index.setdefault(station.address, station)
