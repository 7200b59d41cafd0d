"""Triggers of a capture, and the window around them: keeps what mattered, in bounded memory."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Generic, NamedTuple, TypeVar

from dpstack.capture.transmission import Damage, Transmission
from dpstack.decode.log_text import from_hex
from dpstack.errors import UsageError
from dpstack.fdl.codec import decode
from dpstack.monitor.counters import Change, Counters
from dpstack.params import BROADCAST
from dpstack.units import ns_to_s

T = TypeVar("T")

#: memory of what is held before a trigger, in octets; a transmission needs about this many besides its own
MOST_HELD: Final = 64 << 20
_OVERHEAD: Final = 250
#: changes of a station that are triggers, by their names
_CHANGES: Final = frozenset({"lost", "diagnosis", "back", "left", "mode", "rate"})
_RETRY: Final = re.compile(r"retry(?:\s*>\s*(\d{1,3}))?")
_STATION: Final = re.compile(r"station\s+(\d{1,3})")


class Trigger(NamedTuple):
    """A condition. ``kind``: a change, "retry", "station", "damage" or "octets"; ``number``: of repetitions, of a
    station, or the damage; ``octets``: the pattern."""

    text: str
    kind: str
    number: int = 0
    octets: bytes = b""


def parse_trigger(text: str) -> Trigger:
    """A trigger from its text: ``lost``, ``back``, ``diagnosis``, ``left``, ``mode``, ``rate``, ``retry>2``,
    ``damaged``, ``bad fcs``, ``station 5`` or octets in hex. Raises UsageError.
    """
    words = " ".join(text.lower().split())
    if words in _CHANGES:
        return Trigger(words, words)
    if words == "bad fcs":
        return Trigger(words, "damage", Damage.FCS)
    if words == "damaged":
        return Trigger(words, "damage", sum(Damage))
    if found := _RETRY.fullmatch(words):
        return Trigger(words, "retry", int(found[1] or 0))
    if found := _STATION.fullmatch(words):
        address = int(found[1])
        if address > BROADCAST:
            raise UsageError(f"trigger {text!r}: station addresses are 0..{BROADCAST}")
        return Trigger(words, "station", address)
    try:
        octets = from_hex(text)
    except UsageError:
        octets = b""
    if not octets:
        known = ", ".join((*sorted(_CHANGES), "retry>2", "damaged", "bad fcs", "station 5"))
        raise UsageError(f"trigger {text!r} is not known; there are {known}, or octets in hex such as 68 05 05 68")
    return Trigger(octets.hex(" "), "octets", octets=octets)


class Triggers:
    """Watches the transmissions of one bus for any of ``triggers``, with :attr:`counters` of the bus."""

    def __init__(self, triggers: Sequence[Trigger] = ()) -> None:
        self.counters = Counters(self._on_change)
        #: how often each trigger fired; those that hold on count once for each transmission
        self.fired: dict[str, int] = {trigger.text: 0 for trigger in triggers}
        self._triggers = tuple(triggers)
        self._kinds = frozenset(trigger.kind for trigger in triggers)
        self._changes: list[Change] = []
        self._repeats = 0

    def _on_change(self, change: Change) -> None:
        if change.kind in self._kinds:
            self._changes.append(change)

    def add(self, one: Transmission) -> str:
        """Count ``one``. Returns the triggers that fire at it, with their reasons; empty if none does."""
        counters = self.counters
        counters.add(one)
        if not self._triggers:
            return ""
        repeats, before = counters.repeats, self._repeats
        self._repeats = repeats
        reasons = []
        for trigger in self._triggers:
            reason = ""
            match trigger.kind:
                case "retry":
                    if repeats > trigger.number and repeats != before:
                        reason = f"{trigger.text} (repetition {repeats})"
                case "damage":
                    reason = trigger.text if one.damage & trigger.number else ""
                case "octets":
                    reason = trigger.text if trigger.octets in one.octets else ""
                case "station":
                    telegram = decode(one.octets)
                    if telegram is not None and trigger.number in (telegram.sa, telegram.da):
                        reason = trigger.text
                case kind:
                    reason = "; ".join(f"{kind} ({change.text})" for change in self._changes if change.kind == kind)
            if reason:
                self.fired[trigger.text] += 1
                reasons.append(reason)
        self._changes.clear()
        return "; ".join(reasons)


@dataclass(slots=True)
class _Held(Generic[T]):
    t_ns: int
    size: int
    item: T


class Kept(NamedTuple, Generic[T]):
    """An item to keep. ``remark``: on the first one of a window, and at the trigger."""

    item: T
    remark: str


class Window(Generic[T]):
    """Holds the items of the last ``before_ns`` until a trigger, and lets those pass up to ``after_ns`` behind the last
    one. ``most``: memory in octets; if it is not enough, the oldest items go, and a remark says so.
    """

    def __init__(self, before_ns: int, after_ns: int, most: int = MOST_HELD) -> None:
        self._before_ns = before_ns
        self._after_ns = after_ns
        self._most = most
        self._held: deque[_Held[T]] = deque()
        self._size = 0
        self._until: int | None = None  # end of the open window
        self._reason = ""  # of the open window
        self._left_out = 0  # items since the last window
        self._squeezed = False  # memory was not enough
        #: number of windows so far
        self.count = 0

    def add(self, t_ns: int, octets: int, item: T, reason: str) -> list[Kept[T]]:
        """The items to keep now. ``t_ns``: time of ``item``; ``octets``: its length; ``reason``: of the trigger, or
        empty."""
        is_open = self._until is not None and t_ns <= self._until
        if reason:
            self._until = t_ns + self._after_ns
            remark = f"trigger: {reason}" if not is_open or reason != self._reason else ""
            self._reason = reason
            return [Kept(item, remark)] if is_open else [*self._open(t_ns), Kept(item, self._first(remark))]
        if is_open:
            return [Kept(item, "")]
        self._hold(_Held(t_ns, octets + _OVERHEAD, item))
        return []

    def _open(self, t_ns: int) -> list[Kept[T]]:
        self.count += 1
        self._expire(t_ns)
        items = [held.item for held in self._held]
        self._held.clear()
        self._size = 0
        if not items:
            return []
        return [Kept(items[0], self._first("")), *(Kept(item, "") for item in items[1:])]

    def _first(self, remark: str) -> str:
        """The remark on the first item of a window: the number of items left out before it."""
        count, self._left_out = self._left_out, 0
        squeezed, self._squeezed = self._squeezed, False
        why = f" ({ns_to_s(self._before_ns):g} s before the trigger need more memory)" if squeezed else ""
        left = f"{count} transmissions before this one were not kept{why}" if count else ""
        return "; ".join(part for part in (left, remark) if part)

    def _hold(self, held: _Held[T]) -> None:
        self._held.append(held)
        self._size += held.size
        self._expire(held.t_ns)
        while self._size > self._most:
            self._squeezed = True
            self._forget()

    def _expire(self, t_ns: int) -> None:
        while self._held and self._held[0].t_ns < t_ns - self._before_ns:
            self._squeezed = False
            self._forget()

    def _forget(self) -> None:
        self._size -= self._held.popleft().size
        self._left_out += 1
