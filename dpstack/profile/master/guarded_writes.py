"""Writes of the application to parameters that the plugin relies on: refused while the motor may turn, read again.

The rule is the same for all drives; the columns ``use`` and ``acts`` of a plugin's table
(:class:`~dpstack.profile.model.params.ParamSpec`) and its settings say which parameters it concerns:

- a code of a process data map is only written by ``write_map``;
- any other one is refused while the motor may turn: from then on set point and actual speed would mean something else;
- at standstill it is written, and all settings are read again at once; no start begins meanwhile;
- what does not act at once keeps its old value for the plugin until the drive's power-on, or until the parameter that
  applies it is written.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import Protocol

from dpstack.profile.channel.base import ParameterChannel, ParamKey
from dpstack.profile.master.settings import Pending, SettingsCheck
from dpstack.profile.model.jobs import CommandError, Steps
from dpstack.profile.model.params import Use


class MayTurn(Protocol):
    """A drive that knows whether its motor may turn."""

    def may_turn(self) -> str | None: ...


class WritingCore(MayTurn, Protocol):
    """Master side of a drive as its writes use it (:class:`~dpstack.profile.master.core.DriveCore`)."""

    settings_check: SettingsCheck

    def use_of(self, key: ParamKey) -> Use: ...
    def acts_of(self, key: ParamKey) -> str: ...
    def label_of(self, key: ParamKey) -> str: ...
    def applier_of(self, key: ParamKey) -> str | None: ...
    def in_data_exchange(self, deadline: int) -> Steps[None]: ...
    def without_start(self, what: str) -> AbstractContextManager[None]: ...
    def before_applied(self, name: str, deadline: int) -> Steps[None]: ...


def guarded_write(
    core: WritingCore, access: ParameterChannel, key: ParamKey, value: float, deadline: int
) -> Steps[dict[str, object]]:
    """The job of a write. Raises CommandError, for a code of a map before anything else happens."""
    use = core.use_of(key)
    label = core.label_of(key)
    if use is Use.MAP:
        raise CommandError(
            "usage",
            f"{label} is a code of the process data map: written alone, it would put words of the present map into "
            "other parameters; use write_map, which changes map and values together at standstill",
        )
    name = core.applier_of(key)
    if use is Use.NONE and name is None:
        return access.write(key, value, deadline)
    return _write(core, access, key, value, deadline)


def _write(
    core: WritingCore, access: ParameterChannel, key: ParamKey, value: float, deadline: int
) -> Steps[dict[str, object]]:
    label, name, acts = core.label_of(key), core.applier_of(key), core.acts_of(key)
    yield from core.in_data_exchange(deadline)
    refuse_while_turning(core, f"{label} is not written", "the plugin relies on its value")
    check = core.settings_check
    with core.without_start(f"the write of {label}"):
        if name is not None and value:
            yield from core.before_applied(name, deadline)
        if acts:
            yield from check.keep(key, deadline)
        try:
            outcome = yield from access.write(key, value, deadline)
        finally:  # also without an answer it may have been written
            if name is not None and value:
                check.applied(name)
            check.changed()
        if acts:
            check.waits(Pending(key, label, acts))
    return outcome


def refuse_while_turning(core: MayTurn, what: str, why: str) -> None:
    """Raises CommandError if the motor may turn."""
    if (turning := core.may_turn()) is not None:
        raise CommandError("usage", f"{what}: {turning}, and {why}; stop() it first, then do it at standstill")
