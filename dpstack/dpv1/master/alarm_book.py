"""What is known of the alarms of one slave whatever its parameters are, also while DP-V1 is off."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

from dpstack.dpv1.master.alarm_events import AlarmCounts


@dataclass(slots=True)
class AlarmBook:
    """``hold``: the application acknowledges (:class:`~dpstack.dpv1.master.alarm_events.HoldAlarms`); ``number`` of the
    last alarm; ``untaken``: numbers of those that are void, but not taken by the application yet."""

    counts: AlarmCounts = field(default_factory=AlarmCounts)
    number: int = 0
    hold: bool = False
    untaken: set[int] = field(default_factory=set)

    def count(self, name: str) -> None:
        """One more."""
        self.counts = dataclasses.replace(self.counts, **{name: getattr(self.counts, name) + 1})
