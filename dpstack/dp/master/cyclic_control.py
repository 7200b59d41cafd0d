"""FREEZE at the beginning of every cycle and SYNC at its end: inputs of one moment, outputs at one moment."""

from __future__ import annotations

from dpstack.dp.master.commands import SendControl
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.slave_handler import SlaveHandler
from dpstack.dp.pdu.requests import GlobalControl
from dpstack.dp.slave_params import SlaveSetup, group_mask
from dpstack.errors import ConfigError, UsageError


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

    def concerns(self, setup: SlaveSetup) -> bool:
        """Whether the slave is in one of the groups."""
        return bool(setup.group_mask & self._mask)

    def reaches(self, handler: SlaveHandler) -> bool:
        """Whether the slave takes the telegram: it is in one of the groups and in data exchange."""
        return handler.state is SlaveState.DATA_EXCHANGE and self.concerns(handler.setup)

    def check(self, setup: SlaveSetup) -> None:
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
