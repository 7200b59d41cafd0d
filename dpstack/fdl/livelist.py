"""The live list: stations 0..126 on the bus with type and readiness, polled by FDL status.

The live list is the user of the link layer with the lowest priority (docs/reference/protocol.md#token-rotation): it
sends one request a token hold, in the time that other users leave. Its polls of silent addresses stay within an
:class:`Allowance`. Its requests change no station.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import Final

from msgspec import Struct

from dpstack.fdl.allowance import Allowance
from dpstack.fdl.events import StationFound
from dpstack.fdl.interface import Failure, LinkUser, Request
from dpstack.fdl.telegram import Req, StationType, Telegram
from dpstack.params import UNADDRESSED, BusParams
from dpstack.phy.patience import Patience
from dpstack.trace import Event
from dpstack.units import BITS_PER_CHAR, NS_PER_MS

#: 126 is the address of a slave as delivered; 127 is the broadcast address
ALL_ADDRESSES: Final = range(UNADDRESSED + 1)
#: the live list and GAP polls share the bus time for silent polls: each takes one half
_SHARES: Final = 2
#: an FDL status is SD1
_POLL_BITS: Final = 6 * BITS_PER_CHAR
#: least slack on a busy computer for an address that never answered (such a computer stalls for 10 to 30 ms and more)
_BUSY_NS: Final = 20 * NS_PER_MS
#: one late poll in this many means a busy computer; with fewer late polls a station that is polled twice is missed once
#: in 2500 times
_BUSY_POLLS: Final = 50


def live_allowance(params: BusParams, patience: Patience, now: int) -> Allowance:
    """The bus time for silent polls of a live list beside data exchange: half of the share that the patience allows."""
    return Allowance(_SHARES * patience.unknown_divisor, patience.silent_ns(params), now)


class LongLook(Struct, frozen=True):
    """An additional pass with longer time-outs over silent addresses, for a busy computer.

    A silent poll that takes ``late_ns`` or more from first bit to time-out shows that this computer is busy. When one
    poll in 50 is so late, a station that is a process of the same computer may have had no time for any request: it
    ignores a request that is followed by another one. So the live list polls every silent address once more. The
    time-out is longer by the delay of the latest poll, at least ``extra_ns`` and at most ``most_ns``. It repeats this
    pass as long as a pass finds a station.
    """

    late_ns: int
    extra_ns: int
    most_ns: int


def long_look(params: BusParams, patience: Patience) -> LongLook | None:
    """The pass for a port with ``patience``; None if its slack is as long anyway, or in virtual time."""
    extra_ns = min(patience.known_ns, _BUSY_NS) - patience.unknown_ns
    if extra_ns <= 0:
        return None
    poll_ns = params.ns(_POLL_BITS) + patience.sending_ns + patience.silent_ns(params)
    return LongLook(poll_ns + patience.unknown_ns // 2, extra_ns, patience.known_ns - patience.unknown_ns)


class LiveList(LinkUser):
    """The live list as a ``LinkUser``; it leaves out ``own``, the address of the polling station.

    It polls ``addresses`` in turn, and the silent ones in ``passes`` passes: a damaged answer or a host that stalls
    must not hide a station. Then the list is ``done``; with ``period_ns`` it begins again this time after the begin of
    the last list. ``allowance``: limit of the time for silent polls, None: no limit; ``quick_start``: no limit in the
    first pass. While there is no limit, ``long_look`` adds a pass for a busy computer.
    """

    def __init__(
        self,
        own: int,
        *,
        addresses: Iterable[int] = ALL_ADDRESSES,
        passes: int = 2,
        period_ns: int = 0,
        allowance: Allowance | None = None,
        quick_start: bool = False,
        long_look: LongLook | None = None,
    ) -> None:
        #: the stations that answered their last poll, with their type
        self.stations: dict[int, StationType] = {}
        #: addresses from which only damaged octets came: two stations with one address, or a bad line
        self.unreadable: set[int] = set()
        #: True when the list has polled every address: the silent ones in all passes, the others once
        self.done = False
        self._addresses = [address for address in addresses if address != own]
        self._passes = passes
        self._passes_left = passes - 1  # after this one
        self._period_ns = period_ns
        self._allowance = allowance
        self._limited = allowance is not None and not quick_start
        self._queue = deque(self._addresses)
        self._silent: list[int] = []  # of this pass
        self._long_look = long_look
        self._polls = self._late = 0  # silent polls, and the late ones among them
        self._latest_ns = 0  # the largest delay of a late poll
        self._newcomers = 0  # stations found in this pass
        self._extra_ns = 0  # in this pass
        self._turn = False  # the list has sent no poll in this hold yet
        self._waiting = -1  # the address polled now
        self._begun = -1  # begin of the list
        self._started = 0  # begin of the current poll
        self.events: list[Event] = []

    def ask_soon(self, address: int) -> None:
        """Poll ``address`` before all others, once."""
        if address != self._waiting and address not in self._queue:
            self._queue.appendleft(address)

    def forget(self, address: int, now: int) -> None:
        """Another user of the link layer found ``address`` silent."""
        self._note_station(address, None, now)

    # --- link user ----------------------------------------------------------------------------------------------
    def token_received(self, now: int) -> None:
        self._turn = True
        if self._begun < 0:
            self._begun = now
        if self._period_ns and now - self._begun >= self._period_ns and not self._queue and self._waiting < 0:
            self._begun = now
            self._passes_left = self._passes - 1
            self._queue.extend(self._addresses)

    def next_request(self, now: int, high_only: bool) -> Request | None:
        """The poll of the next address; a known station gets its slack and repetitions."""
        if high_only or not self._turn or not self._queue:
            return None
        address = self._queue[0]
        known = address in self.stations
        if not known and self._limited and self._allowance is not None and not self._allowance.allows(now):
            return None
        self._turn = False
        self._waiting = self._queue.popleft()
        return Request(address, Req.FDL_STATUS, patient=known, retry=known, extra_ns=self._extra_ns, answer=0)

    def started(self, request: Request, at: int) -> None:
        """The duration of a silent poll counts from ``at``."""
        self._started = at

    def result(self, request: Request, outcome: Telegram | Failure, now: int) -> None:
        """Note the station type in the answer. Silence counts in the last pass only."""
        address = request.da
        self._waiting = -1
        if outcome in (Failure.ABANDONED, Failure.REFUSED, Failure.HELD_BACK):
            self._queue.appendleft(address)
        elif isinstance(outcome, Telegram):
            self.unreadable.discard(address)
            self._note_station(address, outcome.station_type, now)
        else:
            self._no_answer(address, outcome is Failure.NO_ANSWER, now)
        if not self._queue:
            self._end_pass()

    def _no_answer(self, address: int, silent: bool, now: int) -> None:
        if not silent:
            self.unreadable.add(address)
        elif address not in self.stations:
            self._count_silent_poll(now - self._started)
        self._silent.append(address)
        if silent and self._passes_left == 0:  # unreadable octets prove nothing
            self._note_station(address, None, now)

    def _count_silent_poll(self, took_ns: int) -> None:
        self._polls += 1
        if self._allowance is not None:
            self._allowance.charge(took_ns)
        if self._long_look is not None and took_ns >= self._long_look.late_ns:
            self._late += 1
            self._latest_ns = max(self._latest_ns, took_ns - self._long_look.late_ns)

    @property
    def _busy(self) -> bool:
        return 0 < self._polls <= self._late * _BUSY_POLLS

    def _note_station(self, address: int, kind: StationType | None, now: int) -> None:
        known = self.stations.get(address)
        if kind is known:
            return
        if kind is None:
            del self.stations[address]
        else:
            self.stations[address] = kind
            self._newcomers += known is None
        self.events.append(StationFound(t_ns=now, address=address, kind=kind))

    def _end_pass(self) -> None:
        """Poll the silent addresses again while passes are left."""
        silent, self._silent = self._silent, []
        newcomers, self._newcomers = self._newcomers, 0
        if silent and self._passes_left > 0:
            self._passes_left -= 1
            self._queue.extend(silent)
        elif silent and self._begins_long_look(newcomers):
            self._queue.extend(silent)
        else:
            self.done = True
            self._limited = True
            self._extra_ns = 0

    def _begins_long_look(self, newcomers: int) -> bool:
        """Whether to add a pass with longer time-outs. ``newcomers``: stations found in the last pass."""
        look = self._long_look
        if look is None or self._limited:
            return False
        if self._extra_ns:
            return newcomers > 0
        self._extra_ns = min(max(look.extra_ns, self._latest_ns), look.most_ns) if self._busy else 0
        return self._busy

    def take_events(self) -> list[Event]:
        events = self.events.copy()
        self.events.clear()
        return events
