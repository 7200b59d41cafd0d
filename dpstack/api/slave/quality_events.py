"""Events about the quality of named values by the slave's diagnosis and alarms: one a second for a slave at most."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Final

from msgspec import Struct

from dpstack.api.slave.slave import Slave
from dpstack.dp.master.events import SlaveDiagnosis, SlaveEvent, SlaveStateChanged
from dpstack.dpv1.master.alarm_orders import AlarmRaised
from dpstack.plant.quality import Quality
from dpstack.trace import Event, Severity
from dpstack.units import NS_PER_S

#: values that the text of an event names
_NAMED: Final = 5
_SEVERITIES: Final = {Quality.BAD: Severity.ERROR, Quality.UNCERTAIN: Severity.WARNING}


class ValueQuality(Struct, frozen=True):
    """The quality of one named value, and the reason in words."""

    #: name of the value
    name: str
    #: good, uncertain or bad
    quality: Quality
    #: the reason, fault first, then the place; empty for a good value
    text: str

    @property
    def line(self) -> str:
        """One line for people."""
        return f"{self.name} is {self.quality}" + (f" ({self.text})" if self.text else "")


class QualityChanged(SlaveEvent):
    """Named values of a slave have another quality by its diagnosis. ``left_out``: changes since the last event that
    were not reported, because a slave gets one event a second at most; ``values`` are the present ones."""

    #: the values with another quality than in the last event
    values: tuple[ValueQuality, ...]
    #: changes that were not reported
    left_out: int = 0

    @property
    def severity(self) -> Severity:
        """That of the worst value."""
        found = {one.quality for one in self.values}
        return next((severity for quality, severity in _SEVERITIES.items() if quality in found), Severity.INFO)

    def _json_fields(self) -> tuple[str, dict[str, object]]:
        """Name and fields of its JSON line, for :mod:`dpstack.api.bus.events_json`."""
        named = {one.name: {"quality": one.quality.value, "text": one.text} for one in self.values}
        return "quality", {"values": named, "left_out": self.left_out}

    def _text(self) -> str:
        lines = [one.line for one in self.values[:_NAMED]]
        more = len(self.values) - _NAMED
        lines += [f"{more} more values"] if more > 0 else []
        if self.left_out:
            were = "change was" if self.left_out == 1 else "changes were"
            lines.append(f"{self.left_out} {were} not reported before")
        return f"{self.who}: {', '.join(lines)}"


class QualityEvents:
    """Makes the events of a bus. ``publish`` gets them; ``now``: the time of the bus in ns."""

    def __init__(self, publish: Callable[[Event], None], now: Callable[[], int]) -> None:
        self._publish = publish
        self._now = now
        self._reported: dict[int, Mapping[str, ValueQuality]] = {}
        self._reported_at: dict[int, int] = {}
        self._left_out: dict[int, int] = {}
        self._timers: dict[int, asyncio.TimerHandle] = {}

    def event(self, event: SlaveEvent, slave: Slave | None) -> None:
        """Take an event about ``slave``; None: it was removed."""
        if slave is not None and isinstance(event, (SlaveDiagnosis, AlarmRaised, SlaveStateChanged)):
            self._look(slave)

    def end(self) -> None:
        """No further events."""
        for timer in self._timers.values():
            timer.cancel()
        self._timers.clear()

    def _look(self, slave: Slave, *, is_due: bool = False) -> None:
        address, now = slave.address, self._now()
        before, found = self._reported.get(address, {}), _qualities(slave)
        if found == before:
            return
        wait_ns = self._reported_at.get(address, -NS_PER_S) + NS_PER_S - now
        if wait_ns > 0 and not is_due:
            self._left_out[address] = self._left_out.get(address, 0) + 1
            if address not in self._timers:
                loop = asyncio.get_running_loop()
                self._timers[address] = loop.call_later(wait_ns / NS_PER_S, self._late, slave)
            return
        good = (ValueQuality(name, Quality.GOOD, "") for name in before if name not in found)
        changed = (one for name, one in found.items() if before.get(name) != one)
        self._reported[address], self._reported_at[address] = found, now
        # the change that is reported now was one of those
        left_out = max(0, self._left_out.pop(address, 0) - 1)
        self._publish(
            QualityChanged(t_ns=now, address=address, name=slave.name, values=(*changed, *good), left_out=left_out)
        )

    def _late(self, slave: Slave) -> None:
        del self._timers[slave.address]
        self._look(slave, is_due=True)  # a timer may be early by less than its clock shows
        self._left_out.pop(slave.address, None)


def _qualities(slave: Slave) -> dict[str, ValueQuality]:
    """The named values that are not good by the diagnosis, by name."""
    judged = slave.process_quality.by_diagnosis(announced=False)
    return {name: ValueQuality(name, one.quality, one.reason.with_note(one.note)) for name, one in judged.items()}
