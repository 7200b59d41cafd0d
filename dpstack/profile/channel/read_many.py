"""Several parameters by one order: in few requests where the way to the drive has them, else one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from dpstack.profile.channel.base import ParameterChannel, ParamKey
from dpstack.profile.model.jobs import CommandError, Steps

#: of each parameter its outcome, or ``error``, ``text`` and ``number`` of what the drive refused
Found = list[dict[str, object]]


@runtime_checkable
class ReadsMany(Protocol):
    """A parameter channel whose requests carry several parameters."""

    @property
    def per_request(self) -> int:
        """How many one request carries."""

    def read_many(self, keys: Sequence[ParamKey], deadline: int) -> Steps[Found]:
        """One entry for each of ``keys``. Raises CommandError for what is no refusal of the drive."""


def read_many(access: ParameterChannel, keys: Sequence[ParamKey], deadline: int) -> Steps[Found]:
    """By ``access``, whatever it can. Raises CommandError for what is no refusal of the drive."""
    if isinstance(access, ReadsMany):
        return (yield from access.read_many(keys, deadline))
    found: Found = []
    for key in keys:
        try:
            found.append((yield from access.read(key, deadline)))
        except CommandError as error:
            found.append(refused(error))
    return found


def per_request(access: object) -> int:
    """How many parameters one request of ``access`` carries."""
    return access.per_request if isinstance(access, ReadsMany) else 1


def refused(error: CommandError) -> dict[str, object]:
    """The entry of a parameter that the drive refused; any other error is raised again."""
    if error.kind != "parameter":
        raise error
    return {"error": error.kind, "text": error.text, "number": error.number}
