"""Read, Write, I&M and PROFIdrive parameters of DP-V1 at one slave, over MS1 or MS2."""

from __future__ import annotations

import abc
import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import TYPE_CHECKING, Final, TypeVar

from msgspec import Struct

from dpstack.api.slave.services import Services, time_of
from dpstack.argcheck import octets, whole_number
from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.dpv1.timeouts import service_timeout
from dpstack.errors import AcyclicError, PduError, ServiceRefused, SlaveFault, SlaveTimeout, UsageError
from dpstack.text import brief
from dpstack.units import ns_to_s

if TYPE_CHECKING:
    from dpstack.api.config.slave import SlaveConfig
    from dpstack.api.pa.device import PaDevice
    from dpstack.api.slave.hart import HartDevice
    from dpstack.api.slave.record_parameters import RecordParameters
    from dpstack.dp.pdu.clock import StampedEvent
    from dpstack.dpv1.master.orders import RecordDone, RecordOrder
    from dpstack.dpv1.pdu.im import Im
    from dpstack.dpv1.pdu.read_write import Function, ReadReq, WriteReq

T = TypeVar("T")
#: in seconds: limit for a slave that is not ready for a call, first and longest pause between two tries
_PATIENCE: Final = 2.0
_FIRST_PAUSE: Final = 0.002
_LONGEST_PAUSE: Final = 0.05


def usual_timeout(response_ns: int) -> float:
    """The timeout in seconds of one service, with its time in the queue: 10, longer if the slave may work on it for
    ``response_ns`` (0: not known)."""
    return ns_to_s(service_timeout(response_ns))


class RecordWay(Struct, frozen=True):
    """The way to the records of the slave ``who``: MS1, or the class 2 ``connection`` with that token.

    ``longest``: octets of data in one service, ``limit_text`` says so; ``response_ns``: time of the slave for one
    service, 0: not known; ``im_call`` is held during an I&M call and the read of its answer: the slave handles one call
    at a time.
    """

    services: Services
    address: int
    who: str
    longest: int
    limit_text: str
    response_ns: int
    im_call: asyncio.Lock
    connection: int | None = None


class RecordAccess(abc.ABC):
    """Read and Write of one slave, and I&M and PROFIdrive parameters on top of them.

    A ``timeout`` in seconds counts from the call (None: 10, longer if the slave may take longer).
    """

    _pa_device: PaDevice | None = None

    @property
    @abc.abstractmethod
    def name(self) -> str:
        """the slave's name, for texts"""

    @property
    @abc.abstractmethod
    def address(self) -> int:
        """station address of the slave, 0..126"""

    @property
    @abc.abstractmethod
    def _way(self) -> RecordWay: ...

    @property
    @abc.abstractmethod
    def _slave_config(self) -> SlaveConfig | None:
        """the slave's table of the configuration, if it has one"""

    async def read(self, slot: int, index: int, length: int | None = None, *, timeout: float | None = None) -> bytes:
        """Read a record of DP-V1: ``slot`` 0..254, ``index`` 0..255; up to ``length`` octets (None: all there are).

        Services to a slave, or over a connection, go one after the other; the cycle goes on. The time
        limit of the slave is C1_Response_Timeout or C2_Response_Timeout.
        Raises AcyclicError (the slave refuses: class, code, text), ServiceRefused (it has no Read and Write),
        SlaveTimeout, SlaveFault (it left data exchange, or its answer is impossible), ConnectionEnded, UsageError,
        BusError.
        """
        from dpstack.dpv1.pdu.read_write import Function  # here, as programs without records need no PDU of DP-V1

        wanted = self._way.longest if length is None else whole_number("length", length)
        return await self._carry_out(Function.READ, slot, index, timeout, length=wanted)

    async def write(self, slot: int, index: int, data: bytes, *, timeout: float | None = None) -> None:
        """Write all of ``data`` (up to 240 octets) into a record of DP-V1; otherwise as :meth:`read`."""
        from dpstack.dpv1.pdu.read_write import Function

        await self._carry_out(Function.WRITE, slot, index, timeout, data=data)

    async def read_time_stamps(self, index: int, *, timeout: float | None = None) -> list[StampedEvent]:
        """The time-stamped events in record ``index`` (100..115) of slot 0, which a process alarm announces (DP-V2).

        Read it once the alarm is acknowledged: :attr:`dpstack.Alarm.time_stamps`. Raises as :meth:`read`, and
        PduError if the record has no entries of 14 octets.
        """
        from dpstack.dp.pdu.clock import RECORDS, parse_record  # here, as few devices stamp

        if whole_number("index", index) not in RECORDS:
            raise UsageError(f"index {index}: records of time stamps are {RECORDS.start} to {RECORDS.stop - 1}")
        return parse_record(await self.read(0, index, timeout=timeout))

    async def _carry_out(
        self,
        function: Function,
        slot: int,
        index: int,
        timeout: float | None,
        *,
        length: int = MAX_RECORD,
        data: bytes = b"",
        user: int = 0,
    ) -> bytes:
        from dpstack.dpv1.master.orders import RecordOrder

        way = self._way
        data = octets("data", data)
        if way.longest < len(data) <= MAX_RECORD:
            raise UsageError(f"{way.who}: {len(data)} octets, {way.limit_text}")
        order = RecordOrder(
            way.services.token(),
            function,
            whole_number("slot", slot),
            whole_number("index", index),
            length,
            data,
            time_of(usual_timeout(way.response_ns) if timeout is None else timeout),
            address=way.address if way.connection is None else None,
            connection=way.connection,
            user=user,
        )
        return (await self._order(order)).outcome.data

    async def _order(self, order: RecordOrder) -> RecordDone:
        from dpstack.dpv1.master.orders import RecordDone

        return await self._way.services.do(order, RecordDone)

    def parameters(self, slot: int = 1, *, object: int = 1, timeout: float | None = None) -> RecordParameters:
        """PROFIdrive's parameter access, record 47 of ``slot``: many parameters, arrays, the drive's own list.

        ``object``: axis or drive object; ``timeout`` in seconds for each Read and Write. Make one and keep it.
        """
        # here, as most programs read no parameters
        from dpstack.api.slave.record_parameters import RecordParameters
        from dpstack.dpv1.pdu.error_codes import Decode
        from dpstack.dpv1.pdu.read_write import ReadReq
        from dpstack.profile.record47 import Refused, Silent

        user = self._way.services.token()

        async def carry_out(request: ReadReq | WriteReq) -> bytes | Refused | Silent:
            length = request.length if isinstance(request, ReadReq) else MAX_RECORD
            try:
                return await self._carry_out(
                    request.function, request.slot, request.index, timeout, length=length, data=request.data, user=user
                )
            except AcyclicError as error:
                if error.error_decode != Decode.DPV1:
                    raise
                return Refused(error.code_1)
            except ServiceRefused as error:
                return Refused(0, str(error))
            except SlaveTimeout as error:
                return Silent(str(error))

        return RecordParameters(self.name, carry_out, slot, object=object, longest=self._way.longest)

    def hart(self, channel: int, *, slot: int = 1, compact: bool = False, timeout: float | None = None) -> HartDevice:
        """The HART transmitter at ``channel`` (from 0) of the module in ``slot``. Make one and keep it.

        ``compact``: requests in compact format, if the module supports it; ``timeout`` in seconds for each command
        (None: 20): the module asks the transmitter at 1200 bit/s.
        """
        from dpstack.api.slave.hart import HartDevice  # here, as most programs use no HART
        from dpstack.dpv1.pdu.read_write import ReadReq

        async def carry_out(request: ReadReq | WriteReq) -> bytes:
            if isinstance(request, ReadReq):
                return await self.read(request.slot, request.index, request.length)
            await self.write(request.slot, request.index, request.data)
            return b""

        longest = self._way.longest
        return HartDevice(
            self.name, self.address, carry_out, channel, slot=slot, compact=compact, longest=longest, timeout=timeout
        )

    @property
    def pa(self) -> PaDevice:
        """The process device of PROFIBUS PA behind these records: its blocks and their parameters by name."""
        if self._pa_device is None:
            self._pa_device = self._make_pa_device()
        return self._pa_device

    def _make_pa_device(self) -> PaDevice:
        # here, as most slaves are no PA devices
        from dpstack.api.pa.device import PaAccess, PaDevice

        async def read(slot: int, index: int, timeout: float | None) -> bytes:
            return await _until_ready(lambda: self.read(slot, index, timeout=timeout), timeout)

        async def write(slot: int, index: int, data: bytes, timeout: float | None) -> None:
            await _until_ready(lambda: self.write(slot, index, data, timeout=timeout), timeout)

        config = self._slave_config
        profile = None if config is None else config.device_profile
        makers, extension = ((), {}) if profile is None else (profile.pa_parameters, profile.pa_extension)
        who = f"slave {self.address} ({self.name})"
        return PaDevice(PaAccess(self.name, self.address, who, read, write, makers, extension))

    async def im(self, number: int = 0, *, slot: int = 0, timeout: float | None = None) -> Im:
        """Read I&M ``number`` 0..4 of ``slot``: Write of the call, then Read of its answer. Raises as :meth:`read`.

        If the slave is not ready (0xB5, 0xC0 to 0xC2: the codes of the parameter channel), the call repeats for up to
        2 s, or ``timeout`` if that is shorter.
        """
        from dpstack.dpv1.pdu.im import IM_ANSWER, IM_INDEX, build_call, parse_answer  # here, as few programs ask

        if not 0 <= whole_number("number of I&M", number) <= 4:
            raise UsageError(f"there is no I&M{number}: 0..4")
        what = f"I&M{number} of slot {slot}"
        async with self._calling(what, timeout):
            await _until_ready(lambda: self.write(slot, IM_INDEX, build_call(number), timeout=timeout), timeout)
            length = min(IM_ANSWER, self._way.longest)
            answer = await _until_ready(lambda: self.read(slot, IM_INDEX, length, timeout=timeout), timeout)
        try:
            return parse_answer(answer, number)
        except PduError as error:
            raise SlaveFault(self.address, f"{self._way.who} gives no I&M{number}: {error}") from None

    async def write_im(self, record: Im, *, slot: int = 0, timeout: float | None = None) -> None:
        """Write I&M1 to I&M4. Raises as :meth:`read`."""
        from dpstack.dpv1.pdu.im import IM_INDEX, RECORDS, Im0, build_call, number_of  # here, as few programs write it

        if not isinstance(record, RECORDS):
            raise UsageError(f"{brief(record)} is no I&M record: give Im1(tag_function=...), Im2(date=...), Im3 or Im4")
        if isinstance(record, Im0):
            raise UsageError("I&M0 is what the device is: it cannot be written")
        try:
            call = build_call(number_of(record), record)
        except PduError as error:
            raise UsageError(str(error)) from None
        async with self._calling(f"I&M{number_of(record)} of slot {slot}", timeout):
            await _until_ready(lambda: self.write(slot, IM_INDEX, call, timeout=timeout), timeout)

    @contextlib.asynccontextmanager
    async def _calling(self, what: str, given: float | None) -> AsyncIterator[None]:
        """Lock out other I&M calls to this slave; the error of a negative answer names ``what``."""
        way = self._way
        timeout = usual_timeout(way.response_ns) if given is None else given
        time_of(timeout)
        try:
            async with asyncio.timeout(timeout):
                await way.im_call.acquire()
        except TimeoutError:
            late = f"{way.who}: {what} had no turn within {timeout:g} s: another I&M call is under way"
            raise SlaveTimeout(self.address, f"{late}; give it a longer timeout") from None
        try:
            yield
        except AcyclicError as error:
            raise error.about(what) from None
        finally:
            way.im_call.release()


async def _until_ready(service: Callable[[], Awaitable[T]], timeout: float | None) -> T:
    """The result of ``service``, repeated while the slave is not ready and there is time."""
    from dpstack.dpv1.pdu.error_codes import AGAIN, Decode

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
