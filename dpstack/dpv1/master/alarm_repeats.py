"""Acknowledged alarms that are in the diagnosis again: still the old alarm, or a new one with equal octets?

Slaves differ. The rules: docs/decisions/alarms.md#the-same-alarm-again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

from dpstack.dp.pdu.alarm_blocks import Alarm
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.units import NEVER, NS_PER_MS

#: time in which a slave takes an acknowledged alarm out of its diagnosis
SETTLE: Final = 100 * NS_PER_MS


class Key(NamedTuple):
    """The identity of an open alarm."""

    type: int
    slot: int
    sequence: int

    @classmethod
    def of(cls, alarm: Alarm) -> Key:
        return cls(alarm.type, alarm.slot, alarm.sequence)


class Asked(NamedTuple):
    """The slave asked for ``diagnosis``, which holds ``alarm``; ``octets``: its block."""

    alarm: Alarm
    octets: bytes
    diagnosis: Diagnosis


@dataclass(slots=True)
class _Settled:
    """An acknowledged alarm that every diagnosis since has held."""

    octets: bytes
    until: int
    #: delivered although its block was equal to the last one
    again: bool
    #: the slave has asked for a diagnosis since then
    asked: Asked | None = None


class Settling:
    """The acknowledged alarms of one slave; ``in_order``: its Alarm_Mode is a sequence mode."""

    def __init__(self, in_order: bool) -> None:
        self._settled: dict[Key, _Settled] = {}
        self._counting = in_order
        self._keeps = False
        #: time to read the diagnosis again
        self.look_at: int = NEVER

    def raised(self, alarm: Alarm) -> None:
        self._counting = self._counting or alarm.sequence > 0
        self._settled.pop(Key.of(alarm), None)

    def over(self, key: Key, octets: bytes, again: bool, now: int) -> None:
        """The slave took its acknowledgement; ``again``: :meth:`doubtful` was true of it."""
        self._settled[key] = _Settled(octets, now + SETTLE, again)

    def displaced(self, keys: set[Key]) -> list[Asked]:
        """Drop the alarms that are no longer in the diagnosis, which holds ``keys``. Returns those of them that were
        new alarms after all."""
        gone = [self._settled.pop(key).asked for key in [key for key in self._settled if key not in keys]]
        return [asked for asked in gone if asked is not None and keys]

    def still(self, alarm: Alarm, octets: bytes, diagnosis: Diagnosis, flagged: bool, now: int) -> bool:
        """True if ``alarm`` is the acknowledged one, still there. ``flagged``: the slave asked for this diagnosis."""
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
        """True if nothing but :meth:`still` tells a new alarm from the acknowledged one."""
        settled = self._settled.get(key)
        return settled is not None and settled.octets == octets and settled.asked is None

    def clear(self) -> None:
        self._settled.clear()
        self.look_at = NEVER
