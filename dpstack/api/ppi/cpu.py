"""``Cpu``: values, mode and clock of one S7-200, asked by SRD services of FDL."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from datetime import datetime
from typing import Final

from dpstack.api.fdl.fdl import Fdl, FdlAnswer
from dpstack.api.slave.services import time_of
from dpstack.argcheck import Sealed, whole_number
from dpstack.errors import CpuRefused, FdlError, PduError, SlaveTimeout, UsageError
from dpstack.params import UNADDRESSED
from dpstack.ppi.addresses import PpiAddress, PpiValue, parse_address
from dpstack.ppi.pdu import (
    PDU_LENGTH,
    CpuPdu,
    ReturnCode,
    answer_length,
    clock_request,
    fit,
    is_good,
    item_error,
    negotiate_request,
    negotiated,
    parse_clock,
    parse_pdu,
    pdu_error,
    read_items,
    read_request,
    run_request,
    set_clock_request,
    stop_request,
    user_data,
    write_request,
    written,
)
from dpstack.text import brief
from dpstack.units import ns_to_s

#: a CPU answers at the end of its scan: 300 ms at most, unless its watchdog is stretched
USUAL_S: Final = 3.0
#: between two polls of a CPU that has no answer yet
_PAUSE_S: Final = 0.01
#: times that a request is sent whose answer does not come
_TRIES: Final = 3
#: part of the time for an answer that a request may wait for its turn
_TURN: Final = 0.8
#: octets of the shortest limit of PDUs, and of an answer without data
LEAST_PDU: Final = 32
_SHORT: Final = 24


class Cpu(Sealed):
    """One S7-200 at ``address`` (2 as delivered), asked over ``fdl``: that of :func:`open_ppi`, or ``bus.fdl``.

    ``timeout``: how long the CPU may take for an answer, in seconds; it is polled until then. Calls may overlap: they
    are carried out one after another. All raise CpuRefused if the CPU says no, SlaveTimeout if it does not answer in
    time, UsageError for impossible arguments, BusError when the bus fails.

    ``pdu_length``: the longest PDU in octets, 32..240. Beside a master with a fixed cycle shorter ones find their time.
    """

    def __init__(self, fdl: Fdl, address: int = 2, *, timeout: float = USUAL_S, pdu_length: int = PDU_LENGTH) -> None:
        if not 0 <= whole_number("address", address) < UNADDRESSED:
            raise UsageError(f"address {address}: an S7-200 has 0..125")
        self._fdl = fdl
        #: station address of the CPU, 0..125
        self.address = address
        self._timeout = ns_to_s(time_of(timeout))
        # a request that gets no turn says why before the time is over
        self._turn_s = max(0.001, _TURN * self._timeout)
        self._lock = asyncio.Lock()
        self._sequence = 0
        if not LEAST_PDU <= whole_number("pdu_length", pdu_length) <= PDU_LENGTH:
            raise UsageError(f"pdu_length = {pdu_length}: {LEAST_PDU}..{PDU_LENGTH} octets")
        self._most = self._pdu_length = pdu_length
        self._seal(Cpu)

    def __repr__(self) -> str:
        return f"<Cpu {self.address}>"

    async def connect(self) -> int:
        """Agree on the length of PDUs, which shows that the CPU is there. Returns the octets of a PDU.

        The other calls do not need it.
        """
        self._pdu_length = min(negotiated(await self._ask(negotiate_request)), self._most)
        return self._pdu_length

    async def read(self, address: str) -> PpiValue:
        """The value at ``address``, for instance ``VW100``, ``M0.3``, ``VD8:real``, ``VB0[16]``, ``T37``."""
        (value,) = await self.read_all([address])
        return value

    async def read_all(self, addresses: Iterable[str]) -> list[PpiValue]:
        """The values at ``addresses`` in their order: as few requests as they fit into.

        Raises CpuRefused naming the first address that the CPU does not have.
        """
        if isinstance(addresses, str):
            raise UsageError(f"read_all takes a list of addresses, not {brief(addresses)}")
        values = []
        for value in await self.read_each(addresses):
            if isinstance(value, CpuRefused):
                raise value
            values.append(value)
        return values

    async def read_each(self, addresses: Iterable[str]) -> list[PpiValue | CpuRefused]:
        """As :meth:`read_all`, but a value that the CPU refuses is its CpuRefused, and the others are read."""
        wanted = [parse_address(text) for text in addresses]
        found: list[PpiValue | CpuRefused] = []
        while wanted:
            count = fit(wanted, self._pdu_length)
            found += await self._read(wanted[:count])
            wanted = wanted[count:]
        return found

    async def _read(self, wanted: list[PpiAddress]) -> list[PpiValue | CpuRefused]:
        answer = await self._ask(lambda sequence: read_request(sequence, wanted), longest=answer_length(wanted))
        return [
            self._refused(f"read {address.text}", item_error(value), value) if isinstance(value, ReturnCode) else value
            for address, value in zip(wanted, read_items(answer, wanted), strict=True)
        ]

    async def write(self, address: str, value: PpiValue) -> None:
        """Write ``value`` to ``address``. Analogue inputs, timers and counters cannot be written: the CPU says so."""
        place = parse_address(address)
        code = written(await self._ask(lambda sequence: write_request(sequence, place, value), longest=_SHORT))
        if not is_good(code):
            raise self._refused(f"write {place.text}", item_error(code), code)

    async def run(self) -> None:
        """Put the CPU into RUN: its program controls its outputs. Its mode switch must be in TERM or RUN."""
        await self._ask(run_request, "RUN", longest=_SHORT)

    async def stop(self) -> None:
        """Put the CPU into STOP: its outputs go to the values that its system block has for STOP."""
        await self._ask(stop_request, "STOP", longest=_SHORT)

    async def clock(self) -> datetime:
        """The time of the CPU's clock, which has no time zone."""
        return parse_clock(user_data(await self._ask(clock_request, "clock")))

    async def set_clock(self, time: datetime) -> None:
        """Set the CPU's clock to ``time`` as it is, without regard to its time zone; years 1990 to 2089."""
        user_data(await self._ask(lambda sequence: set_clock_request(sequence, time), "set clock"))

    # --- inside -----------------------------------------------------------------------------------------------------
    def _refused(self, service: str, why: str, code: int) -> CpuRefused:
        return CpuRefused(self.address, f"CPU {self.address} refuses {service}: {why}", service=service, code=code)

    async def _ask(
        self, make: Callable[[int], CpuPdu], service: str = "the request", *, longest: int = PDU_LENGTH
    ) -> CpuPdu:
        """Send the request that ``make(sequence number)`` builds; wait for its answer of up to ``longest`` octets."""
        async with self._lock:
            self._sequence = (self._sequence + 1) & 0xFFFF
            request = make(self._sequence)
            try:
                async with asyncio.timeout(self._timeout):
                    answer = await self._exchange(request, longest)
            except SlaveTimeout:
                raise
            except TimeoutError:
                text = f"CPU {self.address}: no answer to {service} within {self._timeout:g} s: is it in use elsewhere?"
                raise SlaveTimeout(self.address, text) from None
        if answer.error:
            raise self._refused(service, pdu_error(answer.error), answer.error)
        return answer

    async def _exchange(self, request: CpuPdu, longest: int) -> CpuPdu:
        for _ in range(_TRIES):
            try:
                reply = await self._fdl.srd(self.address, request.octets, reply_max=0, timeout=self._turn_s)
                while (answer := self._answer_of(reply, request)) is None:
                    reply = await self._poll(longest)
            except FdlError as error:
                if error.status != "NA":
                    raise
                continue
            return answer
        raise SlaveTimeout(self.address, f"CPU {self.address} does not answer: check address, rate, cable and supply")

    def _answer_of(self, reply: FdlAnswer, request: CpuPdu) -> CpuPdu | None:
        """The PDU of a reply; None if it has none yet, or is the answer to an earlier request."""
        if not reply.data:
            return None
        try:
            answer = parse_pdu(reply.data)
        except PduError:
            return None
        return answer if answer.sequence == request.sequence else None

    async def _poll(self, longest: int) -> FdlAnswer:
        """Ask for the answer until the CPU has one: RR and NR mean not yet."""
        while True:
            try:
                reply = await self._fdl.srd(self.address, reply_max=longest, timeout=self._turn_s)
            except FdlError as error:
                if error.status != "RR":
                    raise
            else:
                if reply.data:
                    return reply
            await asyncio.sleep(_PAUSE_S)
