"""The schedule of one rotation: every telegram between two rounds of a master, recorded from time to time.

A rotation begins with the first Data_Exchange of a round, as ``rotation_us`` of ``monitor --json`` has it; on a bus
without Data_Exchange it begins where a master passes the token. Memory is bounded: at most :data:`MOST_KEPT` rotations
of :data:`MOST_TELEGRAMS` transmissions are kept, spread over the whole time.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Final, NamedTuple

from dpstack.capture.transmission import Transmission
from dpstack.decode.telegram import Explained, explain
from dpstack.fdl.codec import decode
from dpstack.fdl.telegram import COUNTED, FC_FCV, UNANSWERED, Kind, Telegram
from dpstack.params import BROADCAST
from dpstack.units import NS_PER_MS, NS_PER_S, chars_to_ns

#: rotations kept; one is the typical one in the end
MOST_KEPT: Final = 24
#: a rotation of more transmissions is not kept
MOST_TELEGRAMS: Final = 600
#: the pause after a recorded rotation, at first; it doubles each time half of the rotations are dropped
_FIRST_PAUSE_NS: Final = 100 * NS_PER_MS
#: without any Data_Exchange for this time the token begins a rotation
_NO_EXCHANGE_NS: Final = NS_PER_S


class Use(Enum):
    """Use of the wire."""

    TOKEN = "token"
    REQUEST = "request"
    ANSWER = "answer"
    DAMAGED = "damaged octets"


class Slot(NamedTuple):
    """One transmission of a rotation. ``start_ns``: from the begin of the rotation; ``idle_ns``: silence before it.

    ``sa``: the sender, None if the octets do not say it; ``da``: the receiver, None for an answer without addresses.
    ``text``: the service, or what the decoder says of the octets.
    """

    start_ns: int
    duration_ns: int
    idle_ns: int
    use: Use
    sa: int | None
    da: int | None
    size: int
    text: str


@dataclass(frozen=True, slots=True)
class Rotation:
    """One rotation. ``begun_ns``: since 1970; ``baud`` in bit/s; ``by_token``: it begins with a token."""

    begun_ns: int
    duration_ns: int
    baud: int
    by_token: bool
    slots: tuple[Slot, ...]

    def used_ns(self, use: Use) -> int:
        """Time of the wire that ``use`` takes."""
        return sum(slot.duration_ns for slot in self.slots if slot.use is use)

    @property
    def idle_ns(self) -> int:
        """Time in which nobody sends."""
        return max(0, self.duration_ns - sum(slot.duration_ns for slot in self.slots))


class _Mark(NamedTuple):
    """Telegrams that begin a rotation: Data_Exchange of a master with a slave, or the token of a master."""

    sa: int
    da: int | None  # None: the token


class _Kept(NamedTuple):
    mark: _Mark
    duration_ns: int
    transmissions: list[Transmission]


class ScheduleRecorder:
    """Records rotations among the transmissions given to :meth:`add`."""

    def __init__(self) -> None:
        self._kept: list[_Kept] = []
        self._pause_ns = _FIRST_PAUSE_NS
        self._begin_at = 0  # not before this time a rotation is recorded
        self._mark: _Mark | None = None
        self._current: list[Transmission] | None = None
        self._token_from = 0  # from this time on the token may begin a rotation

    def add(self, one: Transmission) -> None:
        """Look at one transmission. It costs one comparison while no rotation is recorded."""
        t_ns = one.t_ns
        if t_ns is None or t_ns < self._begin_at:
            return
        mark = None if one.damage else _mark_of(one.octets)
        current = self._current
        if current is None:
            self._begin(one, mark, t_ns)
            return
        if one.baud != current[0].baud or len(current) >= MOST_TELEGRAMS:
            self._pause(t_ns)
            self._mark = None
            return
        if mark is None or mark != self._mark or _repeats(one.octets, current[0].octets):
            current.append(one)
            return
        first = current[0]
        assert first.t_ns is not None
        if t_ns > first.t_ns:
            self._kept.append(_Kept(mark, t_ns - first.t_ns, current))
            if len(self._kept) >= MOST_KEPT:
                del self._kept[::2]
                self._pause_ns *= 2
        self._pause(t_ns)

    def _begin(self, one: Transmission, mark: _Mark | None, t_ns: int) -> None:
        if not self._token_from:
            self._token_from = t_ns + _NO_EXCHANGE_NS
        if mark is None or not one.baud or (mark.da is None and t_ns < self._token_from):
            return
        other = self._mark is not None and self._mark != mark
        if other and t_ns < self._token_from and self._mark != _Mark(mark.sa, None):
            return  # rotations are compared with each other as long as they begin with the same telegram
        self._mark = mark
        self._current = [one]

    def _pause(self, t_ns: int) -> None:
        self._current = None
        self._begin_at = t_ns + self._pause_ns
        self._token_from = 0

    def typical(self, near_ns: int | None = None) -> Rotation | None:
        """The recorded rotation whose duration is nearest to ``near_ns`` (None: to their median); None without any.

        Only recorded ones that begin like most of them count, and none that begins with a token if others do not.
        """
        if not self._kept:
            return None
        with_data = [kept for kept in self._kept if kept.mark.da is not None]
        mark = Counter(kept.mark for kept in with_data or self._kept).most_common(1)[0][0]
        of_mark = [kept for kept in self._kept if kept.mark == mark]
        if near_ns is None:
            near_ns = sorted(kept.duration_ns for kept in of_mark)[len(of_mark) // 2]
        nearest = min(of_mark, key=lambda kept: abs(kept.duration_ns - near_ns))
        return _rotation(nearest)


def _mark_of(octets: bytes) -> _Mark | None:
    telegram = decode(octets)
    if telegram is None:
        return None
    if telegram.kind is Kind.SD4:
        return _Mark(telegram.sa, None)
    if telegram.fc < 0 or not telegram.is_request or telegram.dsap is not None or telegram.da == BROADCAST:
        return None
    function = telegram.function
    return _Mark(telegram.sa, telegram.da) if function in COUNTED and function not in UNANSWERED else None


def _repeats(octets: bytes, first: bytes) -> bool:
    """A repetition has the same frame count bit; it begins no rotation."""
    telegram = decode(octets)
    return octets == first and telegram is not None and telegram.fc >= 0 and bool(telegram.fc & FC_FCV)


def _rotation(kept: _Kept) -> Rotation:
    first = kept.transmissions[0]
    begun_ns, baud = first.t_ns or 0, first.baud
    return Rotation(begun_ns, kept.duration_ns, baud, kept.mark.da is None, _slots(kept.transmissions, begun_ns, baud))


def _slots(transmissions: Sequence[Transmission], begun_ns: int, baud: int) -> tuple[Slot, ...]:
    slots: list[Slot] = []
    free_ns = 0
    for one in explain(transmissions):
        sent = one.transmission
        start_ns = (sent.t_ns or 0) - begun_ns
        duration_ns = chars_to_ns(len(sent.octets), baud)
        use, sa, da = _use(one.telegram, one)
        text = one.service or one.text
        slots.append(Slot(start_ns, duration_ns, max(0, start_ns - free_ns), use, sa, da, len(sent.octets), text))
        free_ns = max(free_ns, start_ns + duration_ns)
    return tuple(slots)


def _use(telegram: Telegram | None, one: Explained) -> tuple[Use, int | None, int | None]:
    """The use of the wire, sender and receiver."""
    if telegram is None or one.transmission.damage:
        return Use.DAMAGED, None, None
    if telegram.kind is Kind.SC:
        request = one.step.request
        return Use.ANSWER, None if request is None else request.da, None if request is None else request.sa
    if telegram.kind is Kind.SD4:
        return Use.TOKEN, telegram.sa, telegram.da
    return (Use.REQUEST if telegram.is_request else Use.ANSWER), telegram.sa, telegram.da
