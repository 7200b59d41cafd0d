"""A drive of another program: commands to the ``run`` that holds the port, over its control socket; and its server."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Mapping, Sequence
from typing import Annotated, Any, Final, NotRequired, TypedDict

import msgspec

from dpstack.api.bus.bus import Bus
from dpstack.api.bus.parts import SEARCHING
from dpstack.api.config.config import Config
from dpstack.api.control.answers import checked
from dpstack.api.control.client import ControlClient, find_run
from dpstack.api.control.drive_commands import PARAMETERS, READ_MANY, carry_out
from dpstack.api.control.errors import failure
from dpstack.api.control.server import kept_alive
from dpstack.api.lists.dump_compare import ParameterPlace, ParameterValue
from dpstack.errors import BusError, ParameterError, PortError, UsageError
from dpstack.profile import ListedParam
from dpstack.text import number_or_name


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
    """An order to a drive without an answer of its own: the status afterwards."""

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


#: of a drive, by the order; all others are :class:`StatusAnswer`
OF_DRIVE: Final[dict[str, type]] = {
    "read": ParameterAnswer,
    "write": ParameterAnswer,
    "parameters": ParametersAnswer,
    "read_many": ReadManyAnswer,
}


def drive_order(bus: Bus, args: list[str]) -> AsyncIterator[object]:
    """``NAME ORDER [ARG]...`` at the drive of a run. A client that hangs up ends the order: nothing starts then."""
    if bus.searching:
        raise BusError(f"{SEARCHING}: the drives are known once it is found")
    if bus.config.bus.read_only:
        raise BusError("this run is read only: it gives no drive an order; end it and run without read_only")
    name, word, *rest = args
    drive = bus.drive(number_or_name(name))
    return kept_alive(carry_out(drive, word, rest), lambda: {"status": drive.status.as_dict()})


class RemoteDrive:
    """A drive of the ``run`` on a port. Made by :func:`find_drive`."""

    def __init__(self, client: ControlClient, name: str, pid: int) -> None:
        self.name = name
        #: of the run
        self.pid = pid
        self.kind = ""
        self.address = 0
        #: how many parameters one request to it carries, see :meth:`learn`
        self.per_request = 1
        self._client = client
        self._parameters: tuple[ListedParam, ...] | None = None

    @property
    def parameters(self) -> tuple[ListedParam, ...]:
        """The answer of the run. Raises UsageError before :meth:`learn`."""
        if self._parameters is None:
            raise UsageError(f"drive {self.name}: ask the run for its parameters first")
        return self._parameters

    async def meet(self) -> None:
        """Who it is. Raises UsageError where the run has no such drive, BusError where it cannot tell now."""
        answer = await self.order("status")
        self.kind, self.address = answer["type"], answer["address"]

    async def learn(self) -> None:
        answer = checked(await self.order(PARAMETERS), ParametersAnswer, self._client.port, PARAMETERS)
        self._parameters = tuple(answer["parameters"])
        self.per_request = answer["per_request"]

    async def order(self, word: str, args: Sequence[str] = ()) -> dict[str, Any]:
        """As :func:`~dpstack.api.control.drive_commands.carry_out`, over there. Cancelled, the connection is gone."""
        try:
            kind = OF_DRIVE.get(word, StatusAnswer)
            answer = await asyncio.to_thread(self._client.call, "drive", self.name, word, *args, kind=kind)
        except asyncio.CancelledError:
            self.close()
            raise
        return dict(answer)

    async def read_many(
        self, parameters: Sequence[ParameterPlace], *, timeout: float = 5.0
    ) -> list[ParameterValue | ParameterError]:
        places = json.dumps([one.as_dict() for one in parameters])
        answer = (await self.order(READ_MANY, (places, f"timeout={timeout}")))["parameters"]
        if len(answer) != len(parameters):
            raise PortError(
                f"{self._client.port}: {len(parameters)} parameters were asked for and {len(answer)} were told; is it "
                f"another version of dpstack?"
            )
        return [self._entry(one) for one in answer]

    def _entry(self, answer: Mapping[str, Any]) -> ParameterValue | ParameterError:
        if "error" not in answer:
            return checked(answer, ParameterValue, self._client.port, READ_MANY)
        error = failure(answer)
        if not isinstance(error, ParameterError):
            raise error
        return error

    def close(self) -> None:
        """Hang up; an order that is under way ends."""
        self._client.close()


async def find_drive(config: Config, name: str) -> RemoteDrive | None:
    """The drive called ``name`` of the run that has the port and the file of ``config``; None where no run answers for
    the port.

    Raises UsageError where the run there has another configuration file or no such drive, BusError, PortError where it
    cannot be reached.
    """
    client = await asyncio.to_thread(find_run, config.port, config.file)
    if client is None:
        return None
    try:
        answer = await asyncio.to_thread(client.help)
        drive = RemoteDrive(client, name, answer["pid"])
        await drive.meet()
    except BaseException:
        client.close()
        raise
    return drive
