"""An acknowledged alarm that stands in the diagnosis once more: still, or is it the next one, exactly alike?

Slaves differ; which of the two is assumed when: docs/decisions/alarms.md#the-same-alarm-again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

from dpstack.dp.pdu.alarm_blocks import Alarm
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.units import NEVER, NS_PER_MS

#: a slave has so long to take an acknowledged alarm out of its diagnosis
SETTLE: Final = 100 * NS_PER_MS


class Key(NamedTuple):
    """What is one alarm while it is open."""

    type: int
    slot: int
    sequence: int

    @classmethod
    def of(cls, alarm: Alarm) -> Key:
        """Of ``alarm``."""
        return cls(alarm.type, alarm.slot, alarm.sequence)


class Asked(NamedTuple):
    """The slave asked for ``diagnosis``, where ``alarm`` stands; ``octets`` are its block."""

    alarm: Alarm
    octets: bytes
    diagnosis: Diagnosis


@dataclass(slots=True)
class _Settled:
    """Acknowledged, and in every diagnosis since."""

    octets: bytes
    until: int
    #: delivered only because it stood there
    again: bool
    #: the slave asked to be read since
    asked: Asked | None = None


class Settling:
    """Those of one slave; ``in_order``: its Alarm_Mode is a sequence mode."""

    def __init__(self, in_order: bool) -> None:
        self._settled: dict[Key, _Settled] = {}
        self._counting = in_order
        self._keeps = False
        #: the diagnosis has to be read again then
        self.look_at: int = NEVER

    def raised(self, alarm: Alarm) -> None:
        self._counting = self._counting or alarm.sequence > 0
        self._settled.pop(Key.of(alarm), None)

    def over(self, key: Key, octets: bytes, again: bool, now: int) -> None:
        """Its acknowledgement had its end; ``again``: :meth:`still` had doubts about it."""
        self._settled[key] = _Settled(octets, now + SETTLE, again)

    def displaced(self, keys: set[Key]) -> list[Asked]:
        """``keys`` are in the diagnosis, the others are gone; those of them that were the next ones after all."""
        gone = [self._settled.pop(key).asked for key in [key for key in self._settled if key not in keys]]
        return [asked for asked in gone if asked is not None and keys]

    def still(self, alarm: Alarm, octets: bytes, diagnosis: Diagnosis, flagged: bool, now: int) -> bool:
        """The old one. ``flagged``: the slave asked for this diagnosis."""
        settled = self._settled.get(Key.of(alarm))
        if settled is None or settled.octets != octets:
            return False
        if self._counting:
            return True
        if flagged:
            settled.asked = Asked(alarm, octets, diagnosis)
        if now < settled.until:
            self.look_at = min(self.look_at, settled.until)
            return True
        if settled.asked is not None:
            return False
        self._keeps = self._keeps or settled.again
        return self._keeps

    def doubtful(self, key: Key, octets: bytes) -> bool:
        """The one that is not :meth:`still` the old one has nothing to tell it by."""
        settled = self._settled.get(key)
        return settled is not None and settled.octets == octets and settled.asked is None

    def clear(self) -> None:
        self._settled.clear()
        self.look_at = NEVER
