"""Answers of the control socket: the fields that this program relies on, by command, and the check of them.

The program at the other end may be another version of dpstack, or something else. Fields that are not named here are
passed on as they are, so that a newer program may have more of them.
"""

from __future__ import annotations

from typing import Annotated, Any, Final, NotRequired, TypedDict, TypeVar

import msgspec

from dpstack.api.lists.record_list import ListedValues
from dpstack.errors import PortError
from dpstack.profile import ListedParam

T = TypeVar("T")

Hex = Annotated[str, msgspec.Meta(pattern=r"^(?:[0-9a-fA-F]{2})*$")]


class Command(TypedDict):
    """A command in :class:`Help`."""

    command: str
    args: str
    text: str


class Help(TypedDict):
    """``help``: what the program is."""

    kind: str
    port: str
    pid: int
    commands: list[Command]
    name: NotRequired[str]
    config: NotRequired[str | None]


class Status(TypedDict):
    """A drive at one moment, as ``DriveStatus.as_dict`` writes it."""

    state: str
    running: bool
    reached: bool
    remote: bool
    setpoint: float
    speed: float | None
    frequency_hz: float | None
    current: float | None
    torque: float | None
    warnings: list[str]
    faults: list[str]
    words: list[str]
    bits: list[str]
    settings: NotRequired[str]
    settings_texts: NotRequired[list[str]]


class _OfDrive(TypedDict):
    drive: str
    type: str
    address: int


class DriveTold(_OfDrive):
    """An order to a drive without an answer of its own: the status afterwards."""

    status: Status


class _Parameter(TypedDict):
    name: str | None
    value: int | float
    unit: str
    data_set: int | None


class ParameterTold(_OfDrive):
    """``read`` and ``write`` of a drive."""

    parameter: _Parameter


class ParametersTold(_OfDrive):
    """``parameters`` of a drive."""

    per_request: Annotated[int, msgspec.Meta(ge=1)]
    parameters: list[ListedParam]


class ManyTold(_OfDrive):
    """``read_many`` of a drive: each entry a ``ParameterValue``, or an error as it stands in an answer."""

    parameters: list[dict[str, Any]]


#: of a drive, by the order; all others are :class:`DriveTold`
OF_DRIVE: Final[dict[str, type]] = {
    "read": ParameterTold,
    "write": ParameterTold,
    "parameters": ParametersTold,
    "read_many": ManyTold,
}


class _OfSlave(TypedDict):
    slave: str
    address: int
    slot: int


class WriteTold(_OfSlave):
    """``write`` of a slave's record."""

    index: int
    length: int


class RecordTold(WriteTold):
    """``read`` and ``transport`` of a slave."""

    data: Hex


class ListTold(_OfSlave):
    """``parameters`` of a slave; the entries come in items before."""

    object: int
    ident: int
    parameters: NotRequired[list[ListedValues]]


class ImTold(_OfSlave):
    """``im`` of a slave: the fields of each record, by its number."""

    im: dict[str, dict[str, Any]]


#: of a slave's records, by the order
OF_SLAVE: Final[dict[str, type]] = {
    "read": RecordTold,
    "transport": RecordTold,
    "write": WriteTold,
    "parameters": ListTold,
    "im": ImTold,
}


class Item(TypedDict, total=False):
    """What comes before the result of an order that takes its time: how far it is, a part of a long list."""

    progress: tuple[str, int, int]
    parameters: list[ListedValues]


def checked(value: object, kind: type[T], port: str, command: str) -> T:
    """The fields of ``kind`` in ``value``, which the program on ``port`` answered to ``command``. Raises PortError."""
    try:
        return msgspec.convert(value, kind)
    except (msgspec.ValidationError, UnicodeError) as error:  # a lone surrogate in a key, for instance
        raise PortError(
            f"{port}: the answer to {command!r} is not as dpstack writes it ({error}): is it another version?"
        ) from None
