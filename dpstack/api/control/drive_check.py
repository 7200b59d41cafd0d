"""Check of orders for a drive before the first of them goes out: numbers, ranges, names and steps of parameters."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

from dpstack.api.bus.remote_plugins import core_of
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.control.drive_commands import parse_order
from dpstack.errors import UsageError
from dpstack.profile import ListedParam


class DriveCheck:
    """The drive of ``slave`` as far as its plugin knows it without a bus. ``simulated``: the drive is simulated.

    The plugin is the one that would carry the orders out, so there is no second copy of its rules.
    """

    def __init__(self, slave: SlaveConfig, *, simulated: bool) -> None:
        self.name = slave.name
        self.kind = slave.profile.name if slave.profile is not None else ""
        self._core = core_of(slave, simulated=simulated)

    @property
    def parameters(self) -> tuple[ListedParam, ...]:
        """As its plugin declares them. Raises UsageError where the telegram has no parameter channel."""
        core = self._core
        if core is None or core.access is None:
            telegram = "it" if core is None else f"{core.telegram.name} of {self.kind}"
            raise UsageError(f"drive {self.name}: {telegram} has no parameter channel")
        return core.parameters()

    def order(self, word: str, args: Sequence[str]) -> None:
        """Raises UsageError where the plugin refuses the order before it sends anything."""
        order, core = parse_order(word, args).for_plugin, self._core
        if order is None or core is None:
            return
        events: list[dict[str, object]] = []
        with contextlib.suppress(Exception):  # a defect of the plugin is told where the order is carried out
            core.command(*order, 1, 0)
            events = core.take_events()
            core.lost(0)  # the order ends, the next one begins with a drive that does nothing
            core.take_events()
        for event in events:
            if event.get("error") == "usage":
                raise UsageError(f"drive {self.name}: {event.get('text')}")
