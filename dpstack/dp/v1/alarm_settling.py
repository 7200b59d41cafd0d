"""An acknowledged alarm that stands in the diagnosis once more: still, or is it the next one, exactly alike?

Slaves differ: some number their alarms in type mode too (Lenze I/O system 1000: 0 to 31), some never (ifm AC412S: the
number is always 0, and "appears" may come several times); some take an alarm out of the diagnosis once it is
acknowledged, some leave it there until they have something else to say. Decisions:

- One that was gone meanwhile, or that the slave asks to be read (DH) with nothing else new, is the next one; that is
  :meth:`~dpstack.dp.v1.alarm_handler.AlarmHandler.take`'s. The rest is here.
- In sequence mode, and of a slave that has used a number other than 0, it is the old one.
- Where all numbers are 0 it is the old one for :data:`SETTLE`, then the next one: it may have been raised between the
  last data exchange and the reading, and lost it would hold up its type for ever.
- Was that a mistake (it stands there yet again, and the slave did not ask to be read), the slave leaves them standing;
  from then on it is the next one only where the slave asked to be read since.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

from dpstack.dp.v1.alarms import Alarm
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


@dataclass(slots=True)
class _Settled:
    """Acknowledged, and in every diagnosis since."""

    octets: bytes
    until: int
    #: delivered only because it stood there
    again: bool
    #: the slave asked to be read since
    asked: bool = False


class Settling:
    """Those of one slave; ``in_order``: its Alarm_Mode is a sequence mode."""

    def __init__(self, in_order: bool) -> None:
        self._settled: dict[Key, _Settled] = {}
        self._counting = in_order
        self._keeps = False
        #: the diagnosis has to be read again then
        self.look_at: int = NEVER

    def raised(self, alarm: Alarm) -> None:
        """One that is delivered."""
        self._counting = self._counting or alarm.sequence > 0

    def over(self, key: Key, octets: bytes, again: bool, now: int) -> None:
        """Its acknowledgement had its end; ``again``: :meth:`still` had doubts about it."""
        self._settled[key] = _Settled(octets, now + SETTLE, again)

    def standing(self, keys: set[Key]) -> None:
        """``keys`` are in the diagnosis, the others are gone."""
        for key in self._settled.keys() - keys:
            del self._settled[key]

    def still(self, key: Key, octets: bytes, asked: bool, now: int) -> bool:
        """The old one. ``asked``: the slave asked for this diagnosis."""
        settled = self._settled.get(key)
        if settled is None or settled.octets != octets:
            return False
        if self._counting:
            return True
        settled.asked = settled.asked or asked
        if now < settled.until:
            self.look_at = min(self.look_at, settled.until)
            return True
        if settled.asked:
            return False
        self._keeps = self._keeps or settled.again
        return self._keeps

    def doubtful(self, key: Key, octets: bytes) -> bool:
        """The one that is not :meth:`still` the old one has nothing to tell it by."""
        settled = self._settled.get(key)
        return settled is not None and settled.octets == octets and not settled.asked

    def clear(self) -> None:
        """Data exchange is over."""
        self._settled.clear()
        self.look_at = NEVER
