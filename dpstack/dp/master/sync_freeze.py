"""Global_Control with SYNC, FREEZE or their ends: one order, and both in every cycle.

An order says whom it concerns, and what must have happened first. In every cycle: FREEZE at its beginning, SYNC at its
end; inputs of one moment, outputs at one moment.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from dpstack.dp.master.commands import Mode, SendControl
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.slave_handler import SlaveHandler
from dpstack.dp.pdu.requests import GlobalControl
from dpstack.dp.slave_params import SlaveParams, group_mask
from dpstack.errors import ConfigError, UsageError


class Missing(NamedTuple):
    """A slave that an order cannot do without."""

    address: int
    why: str


class ControlOrder:
    """An order under way; ``sent`` once its telegram went out (then it only waits for the picture)."""

    __slots__ = ("_marks", "_mask", "command", "sent")

    def __init__(self, command: SendControl) -> None:
        self.command = command
        self.sent = False
        self._mask = group_mask(command.groups)
        self._marks: dict[SlaveHandler, int] | None = None

    def members(self, handlers: Iterable[SlaveHandler]) -> list[SlaveHandler]:
        """The slaves of its groups that are in service, in any state."""
        return [h for h in handlers if h.state is not SlaveState.DEACTIVATED and _concerns(h.setup, self._mask)]

    def control(self, *, clear: bool) -> GlobalControl:
        """Its telegram; it says the master's mode too."""
        c = self.command
        return GlobalControl(
            clear=clear, unfreeze=c.unfreeze, freeze=c.freeze, unsync=c.unsync, sync=c.sync, group_mask=self._mask
        )

    def begin_round(self, handlers: Iterable[SlaveHandler]) -> None:
        """Exchanges are counted from the first round on that began after the order (after its telegram)."""
        if self._marks is None:
            self._marks = {h: h.exchanges for h in self.members(handlers)}

    def went_out(self) -> None:
        """Its telegram is on the wire: a whole exchange with everybody follows."""
        self.sent = True
        self._marks = None

    def missing(self, members: Sequence[SlaveHandler]) -> Missing | None:
        """The first slave that is not in data exchange, where one whole exchange with each is wanted."""
        if self.command.settle or self.command.picture:
            for handler in members:
                if handler.state is not SlaveState.DATA_EXCHANGE:
                    fault = handler.fault
                    why = fault.message if fault is not None else f"it is in {handler.state.value}"
                    setup = handler.setup
                    text = f"slave {setup.address} ({setup.name}) is not in data exchange: {why}"
                    return Missing(setup.address, text)
        return None

    def exchanged(self, members: Sequence[SlaveHandler]) -> bool:
        """Whether there was the whole exchange with every slave that is wanted now."""
        if not (self.sent or self.command.settle):
            return True
        marks = self._marks
        if marks is None:
            return False
        return all(h.exchanges > marks.setdefault(h, h.exchanges) for h in members)


def check_order(command: SendControl, handlers: Iterable[SlaveHandler], mode: Mode) -> None:
    """Raises UsageError where ``command`` cannot be carried out in ``mode``, naming what is in the way."""
    if mode <= Mode.STOP:
        raise UsageError(
            f"SYNC and FREEZE cannot be sent in {mode.name.capitalize()}: order clear() or operate() first"
        )
    if command.settle and mode is not Mode.OPERATE:
        raise UsageError("in Clear all outputs are zero: order operate() before outputs are passed on by SYNC")
    if any(not 1 <= group <= 8 for group in command.groups):
        raise UsageError(f"groups are numbered 1..8, {list(command.groups)} were given")
    setups = [h.setup for h in handlers if h.state is not SlaveState.DEACTIVATED]
    mask = group_mask(command.groups)
    members = [setup for setup in setups if _concerns(setup, mask)]
    if not members:
        known = ", ".join(str(g) for g in sorted({g for setup in setups for g in setup.groups})) or "none"
        asked = ", ".join(map(str, command.groups)) or "all"
        raise UsageError(f"no slave is in group {asked}; groups of this bus: {known}")
    for asked_for, key in ((command.sync, "sync"), (command.freeze, "freeze")):
        unable = [setup for setup in members if asked_for and not getattr(setup, key)]
        if unable:
            who = ", ".join(f"slave {s.address} ({s.name})" for s in unable)
            raise UsageError(
                f"{who}: not parameterised for {key.upper()}; give it {key} = true where the device knows that, or "
                f"leave it out of the groups"
            )


def _concerns(setup: SlaveParams, mask: int) -> bool:
    return not mask or bool(setup.group_mask & mask)


class CyclicControl:
    """The groups (1..8; none: nothing is sent) that every cycle in Operate sends a FREEZE, else a SYNC, to."""

    __slots__ = ("_mask", "freeze", "groups")

    def __init__(self, groups: tuple[int, ...], *, freeze: bool) -> None:
        if any(not 1 <= group <= 8 for group in groups):
            raise ConfigError(f"{_key(freeze)}: groups are numbered 1..8, {list(groups)} were given")
        self.groups = groups
        self.freeze = freeze
        self._mask = group_mask(groups)

    def __bool__(self) -> bool:
        return bool(self.groups)

    def control(self) -> GlobalControl:
        """Its telegram, which says Operate too."""
        return GlobalControl(freeze=self.freeze, sync=not self.freeze, group_mask=self._mask)

    def concerns(self, setup: SlaveParams) -> bool:
        """Whether the slave is in one of the groups."""
        return bool(setup.group_mask & self._mask)

    def reaches(self, handler: SlaveHandler) -> bool:
        """Whether the slave takes the telegram: it is in one of the groups and in data exchange."""
        return handler.state is SlaveState.DATA_EXCHANGE and self.concerns(handler.setup)

    def check(self, setup: SlaveParams) -> None:
        """Raises ConfigError for a slave of the groups that is not parameterised for it."""
        name = "freeze" if self.freeze else "sync"
        if self.concerns(setup) and not getattr(setup, name):
            raise ConfigError(
                f"slave {setup.address} ({setup.name}) is in a group of {_key(self.freeze)} and not parameterised for "
                f"{name.upper()}: give it {name} = true where the device knows that, or leave it out of the group"
            )

    def refuse(self, command: SendControl) -> None:
        """Raises UsageError for an order about what every cycle does."""
        asked = command.freeze or command.unfreeze if self.freeze else command.sync or command.unsync
        if asked and self.groups and (not command.groups or set(command.groups) & set(self.groups)):
            named = ", ".join(map(str, self.groups))
            raise UsageError(
                f"every cycle sends {'FREEZE' if self.freeze else 'SYNC'} to group {named} ({_key(self.freeze)}): "
                f"take the groups out of there to order it yourself"
            )


def _key(freeze: bool) -> str:
    return "cycle_freeze" if freeze else "cycle_sync"
