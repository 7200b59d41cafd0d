"""``slave.hart(channel, slot=...)``: a HART transmitter behind a module of the slave, for asyncio programs."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Final, NamedTuple, TypeVar

from dpstack.argcheck import Sealed, octets, seconds, whole_number
from dpstack.dpv1.pdu.error_codes import Decode
from dpstack.dpv1.pdu.read_write import ReadReq, WriteReq
from dpstack.errors import AcyclicError, HartError, UsageError
from dpstack.hart.client import Counters, HartClient, HartClientError, Pause, Refused, Transport
from dpstack.hart.commands import Identity
from dpstack.hart.reading import HartReading as HartReading
from dpstack.hart.reading import read_out
from dpstack.hart.records import Directory, Features
from dpstack.hart.telegram import MAX_DATA, Answer
from dpstack.units import NS_PER_S, s_to_ns

T = TypeVar("T")
#: carries out one Read or Write: the data read, b"" after a Write
CarryOut = Callable[[ReadReq | WriteReq], Awaitable[bytes]]
#: seconds for one command
_PATIENCE: Final = 20.0
#: extended commands are data of command 31
_LAST_COMMAND: Final = 0xFF


class HartModuleInfo(NamedTuple):
    """Directory and features of a module with HART channels."""

    #: record indexes, number of channels, revision of the profile
    directory: Directory
    #: formats that it supports, octets of a record
    features: Features


class HartDevice(Sealed):
    """A HART transmitter: commands through the records of its module, one at a time.

    All calls raise HartError (``reason``: no HART there, no answer in time, an error of the module, a damaged answer,
    refused by the device), otherwise the errors of :meth:`Slave.read`.
    """

    def __init__(
        self,
        name: str,
        address: int,
        carry_out: CarryOut,
        channel: int,
        *,
        slot: int,
        compact: bool,
        longest: int,
        timeout: float | None,
    ) -> None:
        if whole_number("channel", channel) < 0:
            raise UsageError(f"channel = {channel}: HART channels count from 0")
        if timeout is not None:
            seconds("timeout", timeout)
        self._name = name
        self._address = address
        self._carry_out = carry_out
        self._client = HartClient(whole_number("slot", slot), channel, compact=bool(compact), longest=longest)
        self._timeout = timeout
        self._one_by_one = asyncio.Lock()
        self._seal(HartDevice)

    def _sealed_name(self) -> str:
        return f"HART device at slot {self.slot}, channel {self.channel}"

    @property
    def slot(self) -> int:
        """Slot of the module, 0..254."""
        return self._client.slot

    @property
    def channel(self) -> int:
        """Channel of the module, from 0."""
        return self._client.channel

    @property
    def counters(self) -> Counters:
        """Requests, polls, answers that were not ready, busy, damaged or of others."""
        return self._client.counters

    async def module(self, *, timeout: float | None = None) -> HartModuleInfo:
        """Directory and features of the module, read once."""
        directory = await self._run(lambda deadline: self._client.open(), timeout)
        return HartModuleInfo(directory, self._client.features)

    async def identity(self, *, timeout: float | None = None) -> Identity:
        """Maker, type, revisions and address (command 0), read once."""
        return await self._run(lambda deadline: self._client.read_identity(deadline=deadline()), timeout)

    async def command(self, number: int, data: bytes = b"", *, timeout: float | None = None) -> Answer:
        """Send a command 0..255 with ``data``. Returns the answer of the device; a refusal raises HartError.

        A device that is busy or delays its response is asked again. After a damaged answer a command that only reads is
        sent again, three times at most.
        """
        if not 0 <= whole_number("command", number) <= _LAST_COMMAND:
            raise UsageError(f"HART command {number}: 0..{_LAST_COMMAND}; extended commands are data of command 31")
        sent = octets("data", data)
        if len(sent) > MAX_DATA:
            raise UsageError(f"{len(sent)} octets of data, {MAX_DATA} are possible in a HART command")
        return await self._run(lambda deadline: self._client.command(number, sent, deadline=deadline()), timeout)

    async def read(self, *, timeout: float | None = None) -> HartReading:
        """Identity, variables, tag, range and status: commands 0, 3, 13, 15, 20 and 48. One that the device refuses is
        in ``refused`` of the result. ``timeout`` in seconds for each command."""
        return await self._run(lambda deadline: read_out(self._client, deadline), timeout)

    async def _run(self, begin: Callable[[Callable[[], int]], Transport[T]], timeout: float | None) -> T:
        loop = asyncio.get_running_loop()
        given = self._timeout if timeout is None else timeout
        if given is not None:
            seconds("timeout", given)
        patience = s_to_ns(_PATIENCE if given is None else given)
        async with self._one_by_one:
            transport = begin(lambda: s_to_ns(loop.time()) + patience)
            try:
                service = next(transport)
                while True:
                    found: bytes | Refused = b""
                    if isinstance(service, Pause):
                        await asyncio.sleep(service.ns / NS_PER_S)
                    else:
                        found = await self._service(service)
                    service = transport.send((s_to_ns(loop.time()), found))
            except StopIteration as end:
                result: T = end.value
                return result
            except HartClientError as error:
                text = f"slave {self._address} ({self._name}): {error.text}"
                raise HartError(self._address, text, reason=error.reason, response_code=error.response_code) from None
            finally:
                transport.close()

    async def _service(self, service: ReadReq | WriteReq) -> bytes | Refused:
        try:
            return await self._carry_out(service)
        except AcyclicError as error:
            if error.error_decode != Decode.DPV1:
                raise
            return Refused(error.code_1, str(error).partition(": ")[2])
