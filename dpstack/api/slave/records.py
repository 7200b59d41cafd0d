"""Read, Write and I&M of DP-V1 at one slave, over MS1 or MS2."""

from __future__ import annotations

import abc
import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import TYPE_CHECKING, Final, TypeVar

from dpstack.api.slave.services import time_of
from dpstack.argcheck import octets, whole
from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.master.ms1 import ReadRecord, RecordDone, WriteRecord
from dpstack.dpv1.pdu.error_codes import AGAIN, Decode
from dpstack.dpv1.pdu.im import IM_ANSWER, IM_INDEX, RECORDS, Im, Im0, build_call, number_of, parse_answer
from dpstack.dpv1.timeouts import service_timeout
from dpstack.errors import AcyclicError, PduError, SlaveFault, SlaveTimeout, UsageError
from dpstack.units import ns_to_s

if TYPE_CHECKING:
    from dpstack.api.slave.services import Services

T = TypeVar("T")
#: in seconds: limit for a slave that is not ready for a call, first and longest pause between two tries
_PATIENCE: Final = 2.0
_FIRST_PAUSE: Final = 0.002
_LONGEST_PAUSE: Final = 0.05


def usual_timeout(response_ns: int) -> float:
    """The timeout in seconds of one service, with its time in the queue: 10, longer where the slave may work on it for
    ``response_ns`` (0: not known)."""
    return ns_to_s(service_timeout(response_ns))


class RecordAccess(abc.ABC):
    """Read and Write of one slave, and I&M on top of them.

    A ``timeout`` in seconds counts from the call; None: :func:`usual_timeout`.
    """

    @property
    @abc.abstractmethod
    def address(self) -> int: ...

    @property
    @abc.abstractmethod
    def who(self) -> str: ...

    @property
    @abc.abstractmethod
    def longest(self) -> int:
        """Octets of data in one service, at most."""

    @property
    @abc.abstractmethod
    def usual_timeout(self) -> float:
        """The default timeout of a service in seconds."""

    @property
    @abc.abstractmethod
    def im_call(self) -> asyncio.Lock:
        """Held during an I&M call and the read of its answer: the slave handles one call at a time."""

    @abc.abstractmethod
    async def read(self, slot: int, index: int, length: int | None = None, *, timeout: float | None = None) -> bytes:
        """Up to ``length`` octets of a record (None: the longest possible)."""

    @abc.abstractmethod
    async def write(self, slot: int, index: int, data: bytes, *, timeout: float | None = None) -> None:
        """All of ``data``."""

    async def im(self, number: int = 0, *, slot: int = 0, timeout: float | None = None) -> Im:
        """I&M ``number`` 0..4 of ``slot``: the call, then its answer. Raises as :meth:`read`.

        A slave that is not ready (0xB5, 0xC0 to 0xC2: the codes of the parameter channel) is asked again for up to 2 s,
        or ``timeout`` where that is shorter.
        """
        if not 0 <= whole("number of I&M", number) <= 4:
            raise UsageError(f"there is no I&M{number}: 0..4")
        what = f"I&M{number} of slot {slot}"
        async with self._calling(what, timeout):
            await _until_ready(lambda: self.write(slot, IM_INDEX, build_call(number), timeout=timeout), timeout)
            length = min(IM_ANSWER, self.longest)
            answer = await _until_ready(lambda: self.read(slot, IM_INDEX, length, timeout=timeout), timeout)
        try:
            return parse_answer(answer, number)
        except PduError as error:
            raise SlaveFault(self.address, f"{self.who} gives no I&M{number}: {error}") from None

    async def write_im(self, record: Im, *, slot: int = 0, timeout: float | None = None) -> None:
        """Write I&M1 to I&M4. Raises as :meth:`read`."""
        if not isinstance(record, RECORDS):
            raise UsageError(f"{record!r} is no I&M record: give Im1(tag_function=...), Im2(date=...), Im3 or Im4")
        if isinstance(record, Im0):
            raise UsageError("I&M0 is what the device is: it cannot be written")
        try:
            call = build_call(number_of(record), record)
        except PduError as error:
            raise UsageError(str(error)) from None
        async with self._calling(f"I&M{number_of(record)} of slot {slot}", timeout):
            await _until_ready(lambda: self.write(slot, IM_INDEX, call, timeout=timeout), timeout)

    def _time(self, timeout: float | None) -> int:
        """In ns. Raises UsageError."""
        return time_of(self.usual_timeout if timeout is None else timeout)

    @contextlib.asynccontextmanager
    async def _calling(self, what: str, given: float | None) -> AsyncIterator[None]:
        """Lock out other I&M calls to this slave; a negative answer is raised as one to ``what``."""
        timeout = self.usual_timeout if given is None else given
        time_of(timeout)
        try:
            async with asyncio.timeout(timeout):
                await self.im_call.acquire()
        except TimeoutError:
            late = f"{self.who}: {what} had no turn within {timeout:g} s: another I&M call is under way"
            raise SlaveTimeout(self.address, f"{late}; give it a longer timeout") from None
        try:
            yield
        except AcyclicError as error:
            raise error.about(what) from None
        finally:
            self.im_call.release()


async def _until_ready(service: Callable[[], Awaitable[T]], timeout: float | None) -> T:
    """The result of ``service``, repeated while the slave is not ready and there is time."""
    loop = asyncio.get_running_loop()
    until, pause = loop.time() + min(_PATIENCE, _PATIENCE if timeout is None else timeout), _FIRST_PAUSE
    while True:
        try:
            return await service()
        except AcyclicError as error:
            if error.error_decode != Decode.DPV1 or error.code_1 not in AGAIN or loop.time() + pause > until:
                raise
        await asyncio.sleep(pause)
        pause = min(2 * pause, _LONGEST_PAUSE)


class Records(RecordAccess):
    """The records of a slave of this master (MS1)."""

    def __init__(self, services: Services, setup: SlaveParams) -> None:
        self._services = services
        self._setup = setup

    @property
    def address(self) -> int:
        return self._setup.address

    @property
    def who(self) -> str:
        return f"slave {self._setup.address} ({self._setup.name})"

    @property
    def im_call(self) -> asyncio.Lock:
        """One lock for all callers."""
        return self._services.im_call(self.address)

    async def read(self, slot: int, index: int, length: int | None = None, *, timeout: float | None = None) -> bytes:
        """Up to ``length`` octets (None: the longest possible)."""
        token = self._services.token()
        wanted = self.longest if length is None else whole("length", length)
        place = whole("slot", slot), whole("index", index)
        command = ReadRecord(token, self.address, *place, wanted, self._time(timeout))
        return (await self._services.do(token, command, RecordDone)).outcome.data

    async def write(self, slot: int, index: int, data: bytes, *, timeout: float | None = None) -> None:
        """All of ``data``."""
        data = octets("data", data)
        if self.longest < len(data) <= MAX_RECORD:
            raise UsageError(
                f"{self.who}: {len(data)} octets, its GSD file says C1_Max_Data_Len = {self.longest}: write less"
            )
        token = self._services.token()
        place = whole("slot", slot), whole("index", index)
        command = WriteRecord(token, self.address, *place, data, self._time(timeout))
        await self._services.do(token, command, RecordDone)

    @property
    def usual_timeout(self) -> float:
        """By C1_Response_Timeout."""
        dpv1 = self._setup.dpv1
        return usual_timeout(0 if dpv1 is None else dpv1.c1_response_timeout_ns)

    @property
    def longest(self) -> int:
        """C1_Max_Data_Len."""
        dpv1 = self._setup.dpv1
        return MAX_RECORD if dpv1 is None else dpv1.c1_max_data_len
