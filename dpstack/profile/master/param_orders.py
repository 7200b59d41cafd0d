"""The orders of the application that go over the parameter channel: one parameter, or several at once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from dpstack.profile.channel.base import ParameterChannel, ParamKey
from dpstack.profile.channel.read_many import read_many
from dpstack.profile.model.jobs import Args, CommandError, Steps

if TYPE_CHECKING:
    from dpstack.profile.master.core import DriveCore

OPS: Final = ("read_many", "read", "write")
#: where an order says nothing, in seconds
_TIMEOUT: Final = 5.0


def steps(core: DriveCore, op: str, args: Args) -> Steps[dict[str, object]]:
    """What ``core`` does for the order ``op``, one of :data:`OPS`. Raises CommandError."""
    access = core.access
    if access is None:
        raise CommandError("usage", f"{core.telegram.name} of {core.drive} has no parameter channel")
    deadline = core.now + args.timeout_ns(_TIMEOUT)
    if op == "read_many":
        return _several(access, [_listed(one) for one in args.tables("parameters")], deadline)
    number, data_set, index = args.name_or_number("number"), args.integer("data_set"), args.integer("index")
    if op == "read":
        return access.read(ParamKey(number, data_set, index), deadline)
    key = ParamKey(number, data_set, index, args.flag("ram"))
    return _written(core, access.write(key, args.number("value"), deadline))


def _written(core: DriveCore, writing: Steps[dict[str, object]]) -> Steps[dict[str, object]]:
    outcome = yield from writing
    core.settings_check.changed()
    return outcome


def _listed(one: Args) -> ParamKey:
    key = ParamKey(one.name_or_number("number"), one.integer("data_set"), one.integer("index"))
    one.done()
    return key


def _several(access: ParameterChannel, keys: list[ParamKey], deadline: int) -> Steps[dict[str, object]]:
    return {"values": (yield from read_many(access, keys, deadline))}
