"""What is told, ordered and known about the alarms of a slave, at its master. Plain data.

What is known stays whatever the slave's parameters are, also while DP-V1 is off.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

from dpstack.dp.acyclic.job import Outcome
from dpstack.dp.master.diag_reader import AlarmCounts
from dpstack.dp.master.events import SlaveEvent
from dpstack.dp.pdu.alarm_blocks import Alarm, Status
from dpstack.dp.pdu.diag_texts import DiagTexts, texts_of
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.machine import Order


@dataclass(frozen=True, slots=True)
class HoldAlarms(Order):
    """From now on alarms of the slave at ``address`` are acknowledged by AcknowledgeAlarm only; ``on`` False: by the
    station itself again, those that wait included."""

    address: int
    on: bool


@dataclass(frozen=True, slots=True)
class AcknowledgeAlarm(Order):
    """Acknowledge the alarm ``number`` (of AlarmRaised) of the slave at ``address``; its end is AlarmDone."""

    address: int
    number: int


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmRaised(SlaveEvent):
    """The slave raised ``alarm``; ``number`` counts those of this slave. ``diagnosis`` is the one it came in.

    ``held``: it waits for AcknowledgeAlarm. ``texts``: what else stands in that diagnosis (channels, modules), and what
    the GSD file says to the alarm, one line each.
    """

    number: int
    alarm: Alarm
    diagnosis: Diagnosis
    held: bool = False
    texts: tuple[str, ...] = ()

    @property
    def owed(self) -> bool:
        """The slave waits for its acknowledgement."""
        return self.held

    def _text(self) -> str:
        return "; ".join((f"{self.who}: {self.alarm.told}", *self.texts))


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmDone(SlaveEvent):
    """The one end of the alarm ``number``: the slave took its acknowledgement, or why there is none."""

    OWED = True

    number: int
    outcome: Outcome

    def _text(self) -> str:
        return f"{self.who}: " + (self.outcome.text or f"took the acknowledgement of alarm {self.number}")


@dataclass(frozen=True, slots=True, kw_only=True)
class StatusTold(SlaveEvent):
    """The slave's diagnosis holds a ``status`` that was not there before. Nobody acknowledges it."""

    status: Status

    TEMPLATE = "{e.who}: {e.status.told}"


def texts_beside(diagnosis: Diagnosis, alarm: Alarm, texts: DiagTexts | None) -> tuple[str, ...]:
    """What ``diagnosis`` says beside ``alarm``, and the texts of the GSD file to the alarm itself."""
    block = alarm.build()
    own = () if texts is None else texts.unit_diag_texts(block[1:])
    others = tuple(other for other in diagnosis.blocks if other.octets != block)
    return own + texts_of(others, texts, dpv1=True)


@dataclass(slots=True)
class AlarmBook:
    """``hold``: the application acknowledges (:class:`~dpstack.dpv1.master.alarm_events.HoldAlarms`); ``number`` of the
    last alarm; ``untaken``: numbers of those that are void, but not taken by the application yet."""

    counts: AlarmCounts = field(default_factory=AlarmCounts)
    number: int = 0
    hold: bool = False
    untaken: set[int] = field(default_factory=set)

    def count(self, name: str) -> None:
        self.counts = dataclasses.replace(self.counts, **{name: getattr(self.counts, name) + 1})
