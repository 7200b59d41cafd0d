"""Orders to the ``run`` that holds the port, over its control socket: to a drive, or to the records of a slave."""

from __future__ import annotations

import asyncio
import dataclasses
import json
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Final, NotRequired, TypedDict

import msgspec

from dpstack.api.config.config import Config
from dpstack.api.control.client import ControlClient, checked, find_run
from dpstack.api.control.commands import Order
from dpstack.api.control.drive_orders import PARAMETERS, READ_MANY
from dpstack.api.control.errors import failure
from dpstack.api.control.record_orders import COMMANDS, OnProgress
from dpstack.api.lists.parameter_list import ParameterPlace, ParameterValue, Readable
from dpstack.api.lists.record_list import ListedValues
from dpstack.errors import ParameterError, PortError
from dpstack.profile import ListedParam

Hex = Annotated[str, msgspec.Meta(pattern=r"^(?:[0-9a-fA-F]{2})*$")]


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


class StatusAnswer(_OfDrive):
    """The answer to all orders to a drive but those of :data:`_ANSWERS`: the status afterwards."""

    status: Status


class _Parameter(TypedDict):
    name: str | None
    value: int | float
    unit: str
    data_set: int | None


class ParameterAnswer(_OfDrive):
    """``read`` and ``write`` of a drive."""

    parameter: _Parameter


class ParametersAnswer(_OfDrive):
    """``parameters`` of a drive."""

    per_request: Annotated[int, msgspec.Meta(ge=1)]
    parameters: list[ListedParam]


class ReadManyAnswer(_OfDrive):
    """``read_many`` of a drive: each entry a ``ParameterValue``, or an error as it stands in an answer."""

    parameters: list[dict[str, Any]]


class _OfSlave(TypedDict):
    slave: str
    address: int
    slot: int


class WriteAnswer(_OfSlave):
    """``write`` of a slave's record."""

    index: int
    length: int


class RecordAnswer(WriteAnswer):
    """``read`` and ``transport`` of a slave."""

    data: Hex


class ListAnswer(_OfSlave):
    """``parameters`` of a slave; the entries come in items before."""

    object: int
    ident: int
    parameters: NotRequired[list[ListedValues]]


class ImAnswer(_OfSlave):
    """``im`` of a slave: the fields of each record, by its number."""

    im: dict[str, dict[str, Any]]


_OF_RECORDS: Final[dict[str, type]] = {
    "read": RecordAnswer,
    "transport": RecordAnswer,
    "write": WriteAnswer,
    "parameters": ListAnswer,
    "im": ImAnswer,
}
#: by the command of the run and the order
_ANSWERS: Final[dict[str, dict[str, type]]] = {
    "drive": {
        "read": ParameterAnswer,
        "write": ParameterAnswer,
        PARAMETERS: ParametersAnswer,
        READ_MANY: ReadManyAnswer,
    },
    "acyclic": _OF_RECORDS,
    "class2": _OF_RECORDS,
}


async def _carry_out(
    client: ControlClient, command: str, name: str, order: Order, progress: OnProgress | None = None
) -> dict[str, Any]:
    """The answer of the run to ``order``. Cancelled, the connection is closed, and so the order ends there."""
    kind = _ANSWERS[command].get(order.word, StatusAnswer if command == "drive" else None)
    try:
        answer = await asyncio.to_thread(
            client.call, command, name, order.word, *order.texts, kind=kind, progress=progress
        )
    except asyncio.CancelledError:
        client.close()
        raise
    return dict(answer)


async def through_run(
    config: Config, slave: int, order: Order, progress: OnProgress | None = None, *, master: int = 1
) -> dict[str, Any] | None:
    """As :func:`~dpstack.api.control.record_orders.carry_out`, by the run that has the port and the file of
    ``config``; None where no run answers for the port. ``master``: class 1 or 2.

    Raises what it raises there, UsageError where the run has another configuration file or no such slave, PortError.
    ``progress`` is called by another thread.
    """
    client = await asyncio.to_thread(find_run, config.port, config.file)
    if client is None:
        return None
    with client:
        answer = await _carry_out(client, COMMANDS[master], str(slave), order, progress)
    return ({PARAMETERS: []} if order.word == PARAMETERS else {}) | answer | {"order": order.word}


@dataclasses.dataclass(frozen=True, slots=True)
class RemoteDrive(Readable):
    """A drive of the run on a port. Made by :func:`find_drive`; ``kind`` is the name of its plugin."""

    client: ControlClient
    name: str
    kind: str
    address: int
    #: of a drive made by :meth:`listed`; ``per_request``: how many of them one request to the drive carries
    parameters: tuple[ListedParam, ...] = ()
    per_request: int = 1

    async def listed(self) -> RemoteDrive:
        """The drive with its parameters."""
        found = await self.carry_out(Order(PARAMETERS, (), {}))
        answer = checked(found, ParametersAnswer, self.client.port, PARAMETERS)
        return dataclasses.replace(self, parameters=tuple(answer["parameters"]), per_request=answer["per_request"])

    async def carry_out(self, order: Order) -> dict[str, Any]:
        """As :func:`dpstack.api.control.drive_orders.carry_out`, by the run."""
        return await _carry_out(self.client, "drive", self.name, order)

    async def read_many(
        self, parameters: Sequence[ParameterPlace], *, timeout: float = 5.0
    ) -> list[ParameterValue | ParameterError]:
        places = json.dumps([one.as_dict() for one in parameters])
        answer = (await self.carry_out(Order(READ_MANY, (places, f"timeout={timeout}"), {})))["parameters"]
        if len(answer) != len(parameters):
            raise PortError(
                f"{self.client.port}: {len(parameters)} parameters were asked for and {len(answer)} were told; is it "
                f"another version of dpstack?"
            )
        return [self._entry(one) for one in answer]

    def _entry(self, answer: Mapping[str, Any]) -> ParameterValue | ParameterError:
        if "error" not in answer:
            return checked(answer, ParameterValue, self.client.port, READ_MANY)
        error = failure(answer)
        if not isinstance(error, ParameterError):
            raise error
        return error


async def find_drive(config: Config, name: str) -> RemoteDrive | None:
    """The drive called ``name`` of the run that has the port and the file of ``config``; None where no run answers for
    the port.

    Raises UsageError where the run there has another configuration file or no such drive, BusError where the run cannot
    give it orders now, PortError where it cannot be reached.
    """
    client = await asyncio.to_thread(find_run, config.port, config.file)
    if client is None:
        return None
    try:
        answer = await _carry_out(client, "drive", name, Order("status", (), {}))
    except BaseException:
        client.close()
        raise
    return RemoteDrive(client, name, answer["type"], answer["address"])
