"""Several passive stations behind one port: one decoder, one answer at a time, broadcasts to all.

This is what a simulation of many slaves on one serial port is. The stations share the receiver, so a telegram is
decoded once and handed whole to its addressee. The others need not hear the answer of one: a passive
station takes no notice of responses.
"""

from __future__ import annotations

from collections.abc import Iterable

from dpstack.errors import ConfigError, UsageError
from dpstack.fdl.commands import AtStation
from dpstack.fdl.decoder import Decoder
from dpstack.fdl.passive.station import PassiveStation
from dpstack.fdl.telegram import Telegram
from dpstack.machine import LineDown, LineUp
from dpstack.params import BROADCAST, BusParams
from dpstack.phy.line import Line
from dpstack.phy.patience import EXACT, Patience
from dpstack.trace import Event
from dpstack.units import NEVER


class Multidrop:
    """The machine of one port with several passive stations; raises ConfigError when two have one address.

    Stations come and go with :meth:`add` and :meth:`remove`, :meth:`silence` makes one deaf and mute for a while. When
    an application's deadline or address changes from outside (not by a telegram or a tick), call :meth:`poke`.
    """

    def __init__(self, stations: Iterable[PassiveStation], params: BusParams, *, patience: Patience = EXACT) -> None:
        self._patience = patience
        self._line = Line(params)
        self._decoder = Decoder(stall_ns=0)
        #: the counters of the shared receiver
        self.decoder_stats = self._decoder.stats
        self._due: dict[PassiveStation, int] = {}  # every station, and when its application wants its time
        self._next = NEVER  # the earliest of these
        self._index: dict[int, PassiveStation] = {}  # by address
        self._silent: dict[PassiveStation, int] = {}  # until when, in ns
        self._answering: PassiveStation | None = None
        self.set_params(params)
        for station in stations:
            self.add(station)

    # --- the stations ---
    @property
    def stations(self) -> tuple[PassiveStation, ...]:
        return tuple(sorted(self._due, key=lambda station: station.address))

    def add(self, station: PassiveStation) -> None:
        """Put one more station on the line. Raises ConfigError when its address is taken or its baud rate another."""
        address = station.address
        if address in self._index:
            raise ConfigError(f"two stations with address {address} on one port: give one of them another address")
        if station.baud != self.params.baud:
            raise ConfigError(f"station {address} listens at {station.baud} bit/s, the port at {self.params.baud}")
        self._due[station] = NEVER
        self.poke()

    def remove(self, address: int) -> PassiveStation:
        """Take a station off the line, with its answer if one is under way. Raises UsageError when there is none."""
        station = self._cut_off(address)
        del self._due[station]
        self._silent.pop(station, None)
        self.poke()
        return station

    def silence(self, address: int, until: int = NEVER) -> None:
        """Make a station deaf and mute until ``until`` (ns); its application goes on. Raises UsageError."""
        self._silent[self._cut_off(address)] = until

    def resume(self, address: int) -> None:
        """End a silence early. Raises UsageError when there is no such station."""
        self._silent.pop(self._station(address), None)

    def silent_until(self, address: int) -> int | None:
        """When a silence ends, in ns; None where the station is not silenced. Raises UsageError."""
        return self._silent.get(self._station(address))

    def poke(self) -> None:
        """Deadlines or addresses may have changed from outside: ask all stations."""
        self._sort()
        for station in self._due:
            self._due[station] = station.responder.wake_at()
        self._next = min(self._due.values(), default=NEVER)

    def set_params(self, params: BusParams) -> None:
        """Take baud rate and times from ``params`` for the port and all its stations; what is pending is forgotten."""
        #: rate and times of the port and all its stations
        self.params = params
        self.baud = params.baud
        self._line.set_params(params)
        self._decoder.stall_ns = self._line.t_stall_ns + self._patience.stall_ns
        self._decoder.reset()
        self._answering = None
        for station in self._due:
            station.set_params(params)

    # --- Machine ---
    def receive(self, chunk: bytes, now: int) -> None:
        self._line.idle_since = now  # receiving while sending implies sent
        for telegram in self._decoder.feed(chunk, now):
            self._deliver(telegram, now)
        if self._answering is not None:
            self._answering.line.note_activity(now)

    def sent(self, at: int) -> None:
        """The answer leaves the line at ``at``."""
        self._line.idle_since = at

    def wake(self, now: int) -> None:
        """Judge a stalled telegram, and let the applications have their time."""
        if self._decoder.stall_at() <= now:
            for telegram in self._decoder.stalled(now):
                self._deliver(telegram, now)
            if self._answering is not None:
                self._answering.drop_if_late(now)
        if self._next <= now:
            due = self._due
            for station, at in list(due.items()):
                if at <= now:
                    station.wake(now)
                    due[station] = station.responder.wake_at()
            self._next = min(due.values(), default=NEVER)

    def take_tx(self, now: int) -> bytes | None:
        """The one answer under way, once its gate is open."""
        station = self._answering
        if station is None or self._decoder.pending:
            return None
        octets = station.take_tx(now)
        if octets is not None:
            self._answering = None
        return octets

    def wake_at(self) -> int:
        """The earliest deadline of all."""
        if self._decoder.pending:
            own = self._decoder.stall_at()
        elif self._answering is not None:
            own = self._answering.answer_at()
        else:
            return self._next
        return own if own < self._next else self._next

    def take_events(self) -> list[Event]:
        """The events of all stations."""
        return [event for station in self._due for event in station.take_events()]

    def command(self, command: object, now: int) -> None:
        """:class:`LineDown` and :class:`LineUp` from the driver, :class:`AtStation`. UsageError on anything else."""
        if isinstance(command, AtStation):
            command.act(now)
            self.poke()
            return
        if not isinstance(command, LineDown | LineUp):
            raise UsageError(f"a multidrop port knows no {type(command).__name__}: tell the stations' applications")
        self._decoder.reset()
        self._line.idle_since = now
        self._answering = None
        for station in self._due:
            station.command(command, now)
        self.poke()

    # --- inside ---
    def _deliver(self, telegram: Telegram, now: int) -> None:
        if self._answering is not None:
            # whoever sends now does not wait for the answer any more
            self._answering.drop()
            self._answering = None
        da = telegram.da
        if da == BROADCAST:
            for station in list(self._due):
                self._hand(station, telegram, now)
            return
        found = self._index.get(da)
        if found is not None:
            self._hand(found, telegram, now)

    def _hand(self, station: PassiveStation, telegram: Telegram, now: int) -> None:
        if self._silent and self._is_silent(station, now):
            return
        address = station.address
        station.line.idle_since = self._line.idle_since
        station.take(telegram, now)
        if station.address != address:
            self._sort()  # Set_Slave_Add
        if station.answer_at() != NEVER:
            self._answering = station
        due = self._due
        before = due[station]
        at = due[station] = station.responder.wake_at()
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

    def _cut_off(self, address: int) -> PassiveStation:
        station = self._station(address)
        station.command(LineDown("off the line"), self._line.idle_since)
        if self._answering is station:
            self._answering = None
        return station

    def _station(self, address: int) -> PassiveStation:
        station = self._index.get(address)
        if station is None:
            known = ", ".join(str(s.address) for s in self.stations) or "none"
            raise UsageError(f"no station {address} on this port; there are: {known}")
        return station

    def _sort(self) -> None:
        """Index by the present addresses; of two stations with one address the first answers."""
        self._index = {}
        for station in self._due:
            self._index.setdefault(station.address, station)
