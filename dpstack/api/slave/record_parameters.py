"""PROFIdrive parameter access (record 47) for asyncio programs: many parameters, whole lists, progress."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Sequence
from typing import TypeVar

from dpstack.argcheck import whole_number
from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.errors import DriveError, DriveFault, DriveTimeout, ParameterError, UsageError
from dpstack.profile import CommandError
from dpstack.profile.record47 import (
    PROGRAM,
    Address,
    Answer,
    Counters,
    Description,
    Item,
    Limits,
    ParameterClient,
    Pause,
    Progress,
    ReadParameter,
    ReadReq,
    Refused,
    Result,
    Silent,
    Transport,
    Values,
    WriteReq,
    defined,
    describe,
    read_limits,
    read_out,
    texts,
)
from dpstack.text import brief
from dpstack.units import NEVER, NS_PER_S, s_to_ns

T = TypeVar("T")
#: carries out one Read or Write: returns the data read, b"" after a Write, the negative response, or Silent
CarryOut = Callable[[ReadReq | WriteReq], Awaitable[bytes | Refused | Silent]]


class RecordParameters:
    """The parameters of the drive ``name``, in ``slot``. ``carry_out`` carries out each Read and Write; requests of
    several tasks wait for each other.

    ``timeout`` in seconds for the whole call; None: no limit besides that of each service. A parameter that the drive
    refuses is an ErrorValue in the result. All methods raise DriveTimeout if the drive does not answer,
    ParameterError if it has no record 47. ``longest``: octets that one Read or Write can carry, unless ``limits``
    has them.
    """

    def __init__(
        self,
        name: str,
        carry_out: CarryOut,
        slot: int,
        *,
        object: int = 1,
        limits: Limits | None = None,
        longest: int = MAX_RECORD,
    ) -> None:
        whole_number("slot", slot), whole_number("object", object)
        self._name = name
        self._carry_out = carry_out
        known = Limits(octets=longest) if limits is None else limits
        self._client = ParameterClient(slot, object=object, limits=known, references=PROGRAM)
        self._limits_known = limits is not None
        self._one_by_one = asyncio.Lock()

    @property
    def counters(self) -> Counters:
        """Counters of requests, services, octets and failures."""
        return self._client.counters

    async def limits(self, timeout: float | None = None) -> Limits:
        """The limits in the drive's PNU 974; requests respect them from now on."""
        found = await self._run(lambda deadline: read_limits(self._client, deadline), timeout)
        self._limits_known = True
        return found

    async def read(
        self, items: Sequence[Address | Item | int], *, timeout: float | None = None, progress: Progress | None = None
    ) -> list[Result]:
        """Read ``items`` in as few requests as possible: one result for each. A plain number: a parameter, no array."""
        wanted = _wanted(items)
        return await self._run(lambda deadline: self._client.read(wanted, deadline, progress), timeout)

    async def change(
        self, items: Sequence[tuple[Address, Values]], *, timeout: float | None = None, progress: Progress | None = None
    ) -> list[Result]:
        """Write ``items``: Values of format Zero for each change that the drive accepts. Raises ValueError for values
        that do not fit.
        """
        if not all(isinstance(one, tuple) and [*map(type, one)] == [Address, Values] for one in items):
            raise UsageError(f"{items!r}: give a list of (Address(pnu), Values(format, (value,)))")
        return await self._run(lambda deadline: self._client.change(items, deadline, progress), timeout)

    async def defined(self, timeout: float | None = None) -> list[int]:
        """The numbers of the drive's own list (980 to 989)."""
        return await self._run(lambda deadline: defined(self._client, deadline), timeout)

    async def describe(self, pnus: Sequence[int], *, timeout: float | None = None) -> list[Description | None]:
        """The descriptions, None if the drive has none."""
        return await self._run(lambda deadline: describe(self._client, pnus, deadline), timeout)

    async def texts(self, pnu: int, count: int, *, first: int = 0, timeout: float | None = None) -> list[str]:
        """The texts of a parameter's values or elements, from ``first`` on."""
        return await self._run(lambda deadline: texts(self._client, pnu, count, deadline, first=first), timeout)

    async def read_out(
        self,
        *,
        described: bool = True,
        timeout: float | None = None,
        progress: Progress | None = None,
        describing: Progress | None = None,
    ) -> list[ReadParameter]:
        """Every parameter of the drive's list with its values. ``progress`` counts the values, ``describing`` the
        descriptions before.

        Reads its limits first if they are not known.
        """

        def begin(deadline: int) -> Transport[list[ReadParameter]]:
            if not self._limits_known:
                yield from read_limits(self._client, deadline)
                self._limits_known = True
            return (yield from read_out(self._client, deadline, progress, described=described, describing=describing))

        return await self._run(begin, timeout)

    async def _run(self, begin: Callable[[int], Transport[T]], timeout: float | None) -> T:
        loop = asyncio.get_running_loop()
        async with self._one_by_one:
            transport = begin(NEVER if timeout is None else _now(loop) + s_to_ns(timeout))
            try:
                service = next(transport)
                while True:
                    data: bytes | Refused | Silent = b""
                    if isinstance(service, Pause):  # the drive does not signal its answer: ask again later
                        await asyncio.sleep(service.ns / NS_PER_S)
                    else:
                        data = await self._carry_out(service)
                    service = transport.send(Answer(_now(loop), data))
            except StopIteration as end:
                result: T = end.value
                return result
            except CommandError as error:
                raise drive_error(self._name, error.kind, error.text, error.number) from None
            finally:
                transport.close()


def drive_error(name: str, kind: object, text: object, number: object = None) -> DriveError:
    """The exception of a failed order to the drive ``name``: of the parameter ``number``, if ``kind`` says so."""
    message = f"drive {name}: {text}"
    match kind:
        case "fault":
            return DriveFault(name, message)
        case "timeout":
            return DriveTimeout(name, message)
        case "parameter":
            return ParameterError(name, number if isinstance(number, int) else -1, message)
    return DriveError(name, message)


def _wanted(items: Iterable[Address | Item | int]) -> list[Address | Item]:
    """``items`` as a list of addresses. Raises UsageError for anything else."""
    if not isinstance(items, Iterable) or isinstance(items, (Address, Item, str)):
        raise UsageError(f"{brief(items)} is no list of parameters: give for instance [930, Address(964, 0, 7)]")
    found = list(items)
    wrong = next((one for one in found if not isinstance(one, (Address, Item, int))), None)
    if wrong is not None:
        raise UsageError(f"{brief(wrong)} is no parameter: give its number, or Address(pnu, subindex, elements)")
    return [Address(one) if isinstance(one, int) else one for one in found]


def _now(loop: asyncio.AbstractEventLoop) -> int:
    return s_to_ns(loop.time())
