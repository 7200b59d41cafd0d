"""Orders to the ``run`` that holds the port: to a drive, to the records of a slave, or to read a station."""

from __future__ import annotations

import asyncio
import dataclasses
import json
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Final, NotRequired, TypedDict

import msgspec

from dpstack.api.config.config import Config
from dpstack.api.control.client import ControlClient, checked, find_any_run, find_run
from dpstack.api.control.commands import UNASKED, ParsedCommand
from dpstack.api.control.drive_orders import PARAMETERS, READ_MANY
from dpstack.api.control.errors import failure
from dpstack.api.control.record_orders import COMMANDS, PA, OnProgress
from dpstack.api.lists.parameter_list import ParameterPlace, ParameterValue, Readable
from dpstack.api.lists.record_list import ListedValues
from dpstack.api.slave.station_report import Hex, StationReading
from dpstack.errors import ParameterError, PortError
from dpstack.profile import ListedParam


class Status(TypedDict):
    """The JSON of ``DriveStatus.as_dict``."""

    state: str
    running: bool
    reached: bool
    remote: bool | None
    setpoint: float
    speed: float | None
    frequency_hz: float | None
    speed_rpm: NotRequired[float | None]
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
    """The answer to orders to a drive except those in :data:`_ANSWERS`: the status afterwards."""

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
    """``read_many`` of a drive: each entry is a ``ParameterValue``, or the fields of an error answer."""

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


class StampedEventAnswer(TypedDict):
    """A time-stamped event of a :class:`StampsAnswer`."""

    time: str
    slot: int
    signal: int
    state: int
    state_text: str
    kind: int
    kind_text: str


class StampsAnswer(_OfSlave):
    """``stamps`` of a slave: the time-stamped events of a record."""

    index: int
    events: list[StampedEventAnswer]


class ListAnswer(_OfSlave):
    """``parameters`` of a slave; its entries come in earlier items."""

    object: int
    ident: int
    parameters: NotRequired[list[ListedValues]]


class ImAnswer(_OfSlave):
    """``im`` of a slave: the fields of each record, by its number."""

    im: dict[str, dict[str, Any]]


class HartAnswer(_OfSlave):
    """``hart`` of a slave: its transmitter, the answer to one ``command``, or all channels; ``rows`` for people."""

    channel: int | None
    command: int | None
    rows: list[tuple[str, str]]


class PaAnswer(TypedDict):
    """``pa`` of a slave: the order ``asked`` with its answer, see :mod:`dpstack.api.pa.orders`. Lists come in earlier
    items."""

    slave: str
    address: int
    asked: str


class ConfirmedAnswer(TypedDict):
    """``fdl``: the positive confirmation of a service, see :func:`dpstack.api.fdl.orders.carry_out`."""

    status: str
    text: str
    data: NotRequired[Hex]


class PpiAnswer(TypedDict):
    """``ppi``: the lines of :func:`dpstack.api.ppi.orders.carry_out`."""

    lines: list[dict[str, Any]]


class StationAnswer(TypedDict):
    """``diag``: the reading; its other keys are those of :func:`dpstack.api.slave.station_report.station_report`."""

    reading: StationReading


class ListedStation(TypedDict):
    """A station of a :class:`StationsAnswer`."""

    address: Annotated[int, msgspec.Meta(ge=0, le=126)]
    type: str
    ident: str | None
    state: str | None
    master: int | None
    name: str | None


class StationsAnswer(TypedDict):
    """``scan`` of a run."""

    baud: int
    address: int
    stations: list[ListedStation]
    notes: list[str]


class WhyStep(TypedDict):
    """A step of a :class:`WhyAnswer`."""

    t: float
    asked: str
    sent: Hex
    answered: str
    received: Hex
    text: str


class WhyCause(msgspec.Struct):
    """A cause of a :class:`WhyAnswer`; ``speaks_for`` is its key ``for``."""

    cause: str
    confidence: float
    meaning: str
    against: list[str]
    next: str
    speaks_for: list[str] = msgspec.field(name="for")


class WhyAnswer(TypedDict):
    """``why`` of a slave."""

    slave: str
    address: int
    source: str
    state: str
    steps: list[WhyStep]
    causes: Annotated[list[WhyCause], msgspec.Meta(min_length=1)]


_OF_RECORDS: Final[dict[str, type]] = {
    "read": RecordAnswer,
    "transport": RecordAnswer,
    "write": WriteAnswer,
    "stamps": StampsAnswer,
    "parameters": ListAnswer,
    "im": ImAnswer,
    "hart": HartAnswer,
    PA: PaAnswer,
}
#: the type of an answer by command of the run and order
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


async def _asked(
    client: ControlClient, *request: str, kind: type | None, progress: OnProgress | None = None
) -> dict[str, Any]:
    """The answer of the run to ``request``. A cancellation closes the connection, and thereby cancels the order."""
    try:
        answer = await asyncio.to_thread(client.call, *request, kind=kind, progress=progress)
    except asyncio.CancelledError:
        client.close()
        raise
    return dict(answer)


async def _carry_out(
    client: ControlClient, command: str, name: str, order: ParsedCommand, progress: OnProgress | None = None
) -> dict[str, Any]:
    kind = _ANSWERS[command].get(order.word, StatusAnswer if command == "drive" else None)
    return await _asked(client, command, name, order.word, *order.texts, kind=kind, progress=progress)


async def through_run(
    config: Config, slave: int, order: ParsedCommand, progress: OnProgress | None = None, *, master: int = 1
) -> dict[str, Any] | None:
    """Have the run with the port and the file of ``config`` do :func:`~dpstack.api.control.record_orders.carry_out`;
    None if no run answers for the port. ``master``: class 1 or 2.

    Raises the errors of ``carry_out``, UsageError if the run has another configuration file or no such slave,
    PortError. Another thread calls ``progress``.
    """
    client = await asyncio.to_thread(find_run, config.port, config.file)
    if client is None:
        return None
    with client:
        answer = await _carry_out(client, COMMANDS[master], str(slave), order, progress)
    return ({PARAMETERS: []} if order.word in (PARAMETERS, PA) else {}) | answer | {"order": order.word}


async def reading_through_run(
    port: str, config: Config | None, station: str, *, ask: bool = True
) -> StationReading | None:
    """Have the run on ``port`` with the file of ``config`` (None: whatever file it has) read ``station``, an address or
    name; None if no run answers for the port. Without ``ask`` the run tells what it knows already of a slave of its
    own, and sends no telegram. Raises as :func:`through_run`.
    """
    if config is None:
        client = await asyncio.to_thread(find_any_run, port)
    else:
        client = await asyncio.to_thread(find_run, port, config.file)
    if client is None:
        return None
    with client:
        answer = await _asked(client, "diag", station, *_words(ask), kind=StationAnswer)
    return msgspec.convert(answer["reading"], StationReading)


async def fdl_through_run(port: str, words: Sequence[str]) -> dict[str, Any] | None:
    """Have the run on ``port`` carry out the order ``words`` of :mod:`dpstack.api.fdl.orders`; None if no run answers
    for the port. Raises FdlError, UsageError for what the run refuses, PortError."""
    client = await asyncio.to_thread(find_any_run, port)
    if client is None:
        return None
    with client:
        return await _asked(client, "fdl", *words, kind=ConfirmedAnswer)


async def ppi_through_run(port: str, words: Sequence[str]) -> list[dict[str, Any]] | None:
    """The same for an order of :mod:`dpstack.api.ppi.orders`: its lines. Raises CpuRefused, SlaveTimeout, UsageError,
    PortError."""
    client = await asyncio.to_thread(find_any_run, port)
    if client is None:
        return None
    with client:
        lines: list[dict[str, Any]] = (await _asked(client, "ppi", *words, kind=PpiAnswer))["lines"]
        return lines


async def why_through_run(config: Config, slave: int, *, ask: bool = True) -> dict[str, Any] | None:
    """The story of ``slave`` by the run with the port and the file of ``config``; None if no run answers
    for the port. Without ``ask`` the run sends no telegram for it. Raises as :func:`through_run`.
    """
    client = await asyncio.to_thread(find_run, config.port, config.file)
    if client is None:
        return None
    with client:
        return await _asked(client, "why", str(slave), *_words(ask), kind=WhyAnswer)


async def stations_through_run(config: Config) -> dict[str, Any] | None:
    """The stations that the run with the port and the file of ``config`` knows already, for which it sends no telegram;
    None if no run answers for the port. Raises as :func:`through_run`."""
    client = await asyncio.to_thread(find_run, config.port, config.file)
    if client is None:
        return None
    with client:
        return await _asked(client, "scan", UNASKED, kind=StationsAnswer)


def _words(ask: bool) -> tuple[str, ...]:
    return () if ask else (UNASKED,)


@dataclasses.dataclass(frozen=True, slots=True)
class RemoteDrive(Readable):
    """A drive of the run on a port. Made by :func:`find_drive`; ``kind`` is the name of its plugin."""

    client: ControlClient
    name: str
    kind: str
    address: int
    #: empty before :meth:`listed`; ``per_request``: number of parameters in one request to the drive
    parameters: tuple[ListedParam, ...] = ()
    per_request: int = 1

    async def listed(self) -> RemoteDrive:
        """The drive with its parameters."""
        found = await self.carry_out(ParsedCommand(PARAMETERS, (), {}))
        answer = checked(found, ParametersAnswer, self.client.port, PARAMETERS)
        return dataclasses.replace(self, parameters=tuple(answer["parameters"]), per_request=answer["per_request"])

    async def carry_out(self, order: ParsedCommand) -> dict[str, Any]:
        """Have the run do :func:`dpstack.api.control.drive_orders.carry_out`."""
        return await _carry_out(self.client, "drive", self.name, order)

    async def read_many(
        self, parameters: Sequence[ParameterPlace], *, timeout: float = 5.0
    ) -> list[ParameterValue | ParameterError]:
        places = json.dumps([one.as_dict() for one in parameters])
        answer = (await self.carry_out(ParsedCommand(READ_MANY, (places, f"timeout={timeout}"), {})))["parameters"]
        if len(answer) != len(parameters):
            raise PortError(
                f"{self.client.port}: {len(parameters)} parameters were asked for and {len(answer)} came; is it "
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
    """The drive ``name`` of the run that has the port and the file of ``config``; None if no run answers for the
    port.

    Raises UsageError if that run has another configuration file or no such drive, BusError if it can give no
    orders now, PortError if it does not answer.
    """
    client = await asyncio.to_thread(find_run, config.port, config.file)
    if client is None:
        return None
    try:
        answer = await _carry_out(client, "drive", name, ParsedCommand("status", (), {}))
    except BaseException:
        client.close()
        raise
    return RemoteDrive(client, name, answer["type"], answer["address"])
