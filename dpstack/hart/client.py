"""The master's end of a module's HART records: directory, features, a request by Write, its answer by Read.

A :data:`Transport` yields DP-V1 services and pauses, and is sent the time and the result of each; it owns no clock and
no bus. :mod:`dpstack.api.slave.hart` runs one in an asyncio program.

Sources and readings: docs/reference/decisions/hart.md. A module says "not yet" by the result in its response record, or
by a negative answer (0xB5, 0xC0 to 0xC2): both are asked again until the deadline.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import Final, NamedTuple, TypeVar

from msgspec import Struct

from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.dpv1.pdu.error_codes import AGAIN as NOT_NOW
from dpstack.dpv1.pdu.error_codes import Code, code_text
from dpstack.dpv1.pdu.read_write import ReadReq, WriteReq
from dpstack.errors import PduError
from dpstack.hart.commands import READ_IDENTITY, READS, Identity
from dpstack.hart.records import DIRECTORY, Directory, Features, Request, Response, Result
from dpstack.hart.status import AGAIN, COMMUNICATION_ERROR, is_warning, response_text
from dpstack.hart.telegram import Answer, request
from dpstack.text import octets_text, times_text
from dpstack.units import NS_PER_MS, NS_PER_S

T = TypeVar("T")
#: between two Reads of a response, and between two requests to a device that is busy: short first, then twice as long
_FIRST_PAUSE: Final = 20 * NS_PER_MS
_LONGEST_PAUSE: Final = 500 * NS_PER_MS
#: attempts at a request whose answer was damaged, if it changes nothing in the device
_ATTEMPTS: Final = 3
#: a module that has had no request for so long has lost ours, or another program has read the answer
_LOST_NS: Final = 3 * NS_PER_S
#: negative answers that mean that there are no HART records
_ABSENT: Final = frozenset({Code.INVALID_INDEX, Code.INVALID_SLOT, Code.FEATURE_NOT_SUPPORTED, Code.INVALID_AREA})


class Pause(NamedTuple):
    """Wait for ``ns``; the result of a pause is empty."""

    ns: int


class Refused(NamedTuple):
    """A negative answer: Error_Code_1, and its text."""

    code: int
    text: str


#: yields services and pauses, gets time (ns) and result of each
Transport = Generator[ReadReq | WriteReq | Pause, tuple[int, bytes | Refused], T]


class HartClientError(Exception):
    """A request without a usable answer. ``reason``: "absent" (no HART module), "channel" (no such channel), "timeout",
    "module" (it reports an error), "damaged" (an impossible answer), "refused" (the device: ``response_code``)."""

    def __init__(self, reason: str, text: str, response_code: int | None = None) -> None:
        super().__init__(text)
        self.reason = reason
        self.text = text
        self.response_code = response_code


class Counters(Struct):
    """``requests`` written; ``polls`` of their responses; ``not_yet``: answers that were asked again; ``busy``: answers
    of a device that was busy; ``damaged`` answers; ``strays``: answers to another request."""

    requests: int = 0
    polls: int = 0
    not_yet: int = 0
    busy: int = 0
    damaged: int = 0
    strays: int = 0


class HartClient:
    """HART through channel ``channel`` (from 0) of the module in ``slot``. ``compact``: requests in compact format."""

    __slots__ = ("channel", "compact", "counters", "directory", "features", "identity", "longest", "seen", "slot")

    def __init__(self, slot: int, channel: int, *, compact: bool = False, longest: int = MAX_RECORD) -> None:
        self.slot = slot
        self.channel = channel
        self.compact = compact
        self.longest = longest
        self.counters = Counters()
        #: known after the first request
        self.directory: Directory | None = None
        self.features = Features()
        self.identity: Identity | None = None
        #: bits of the device status in all answers
        self.seen = 0

    # --- the module ---

    def open(self) -> Transport[Directory]:
        """Read directory and features, if they are not known. Raises HartClientError."""
        if self.directory is not None:
            return self.directory
        try:
            found = Directory.parse((yield from self._record(DIRECTORY)))
            if found.features is not None:
                self.features = Features.parse((yield from self._record(found.features)))
        except PduError as error:
            raise HartClientError("damaged", f"slot {self.slot}: {error}") from None
        if not 0 <= self.channel < found.channels:
            last = found.channels - 1
            raise HartClientError(
                "channel", f"slot {self.slot} has the HART channels 0 to {last}, no channel {self.channel}"
            )
        if self.compact and not self.features.compact:
            raise HartClientError("module", f"slot {self.slot} does not support the compact format: leave it out")
        self.directory = found
        return found

    def _record(self, index: int) -> Transport[bytes]:
        _, data = yield ReadReq(self.slot, index, self.longest)
        if isinstance(data, Refused):
            if data.code in _ABSENT:
                why = f"record {index}: {code_text(data.code)}"
                raise HartClientError("absent", f"slot {self.slot} has no HART module ({why})")
            raise HartClientError("module", f"slot {self.slot}: record {index}: {data.text}")
        return data

    # --- one command ---

    def command(self, number: int, data: bytes = b"", *, deadline: int) -> Transport[Answer]:
        """The device's answer to a command; ``deadline`` in ns. Raises HartClientError.

        A device that is busy is asked again, one whose answer was damaged too if the command changes nothing.
        """
        directory = yield from self.open()
        address = None
        if number != READ_IDENTITY and not self.compact:
            address = (yield from self.read_identity(deadline=deadline)).address
        try:
            octets = Request(request(number, data, address), self.compact).build()
        except PduError as error:
            raise HartClientError("refused", str(error)) from None
        longest = min(self.features.longest, self.longest)
        if len(octets) > longest:
            raise HartClientError("refused", f"a request of {octets_text(len(octets))}, the module takes {longest}")
        index = directory.requests[self.channel]
        ask = _Ask(number, octets, address or b"", index, index + directory.offset, deadline)
        try:
            answer = yield from self._answered(ask)
        except HartClientError:
            self.identity = None  # the transmitter may have been exchanged: its address is read anew
            raise
        self._check_address(number, answer)
        if answer.response_code and not is_warning(answer.response_code):
            text = response_text(answer.response_code)
            raise HartClientError(
                "refused",
                f"{self._who}: the device refuses command {number}: {text} (response code {answer.response_code})",
                answer.response_code,
            )
        return answer

    def read_identity(self, *, deadline: int) -> Transport[Identity]:
        """Command 0, if the identity is not known yet. Raises HartClientError."""
        if self.identity is None:
            answer = yield from self.command(READ_IDENTITY, deadline=deadline)
            try:
                self.identity = Identity.parse(answer.data)
            except PduError as error:
                raise HartClientError("damaged", f"{self._who}: {error}") from None
        return self.identity

    def _check_address(self, number: int, answer: Answer) -> None:
        """In compact format the module asks whichever device is there. Raises HartClientError for another one."""
        known = self.identity
        if number == READ_IDENTITY or known is None or len(answer.address) < len(known.address):
            return
        if answer.address != known.address:
            self.identity = None
            was, now = (one.hex(" ").upper() for one in (known.address, answer.address))
            raise HartClientError("damaged", f"{self._who}: another device answers: {now}, before it was {was}")

    @property
    def _who(self) -> str:
        return f"slot {self.slot}, channel {self.channel}"

    def _answered(self, ask: _Ask) -> Transport[Answer]:
        """The answer of a device that is not busy; damaged ones are asked again."""
        pause, damaged, busy = _FIRST_PAUSE, 0, 0
        while True:
            try:
                now, answer = yield from self._exchange(ask)
            except _DamagedError as error:
                damaged += 1
                self.counters.damaged += 1
                tried = f", tried {times_text(damaged)}" if damaged > 1 else ""
                if damaged >= (_ATTEMPTS if ask.number in READS else 1):
                    raise HartClientError(error.reason, f"{self._who}: {error.text}{tried}{_maybe_done(ask)}") from None
                continue
            except HartClientError as error:
                if error.reason == "timeout" and busy:
                    raise self._still_busy(busy) from None
                raise
            code = answer.response_code
            self.seen |= 0 if code & COMMUNICATION_ERROR else answer.device_status
            if code & COMMUNICATION_ERROR and damaged + 1 < _ATTEMPTS:  # the device has not carried it out
                damaged += 1
                self.counters.damaged += 1
                continue
            if code not in AGAIN:
                return answer
            self.counters.busy += 1
            busy = code
            if now >= ask.deadline:
                raise self._still_busy(code)
            yield Pause(min(pause, ask.deadline - now))
            pause = min(2 * pause, _LONGEST_PAUSE)

    def _still_busy(self, code: int) -> HartClientError:
        return HartClientError("timeout", f"{self._who}: the device is still busy ({response_text(code)})", code)

    def _exchange(self, ask: _Ask) -> Transport[tuple[int, Answer]]:
        """Write the request, read its response until it is there. Raises HartClientError, _DamagedError."""
        now = yield from self._written(ask)
        pause, idle_since, last = _FIRST_PAUSE, now, "it has given no response"
        while True:
            self.counters.polls += 1
            now, data = yield ReadReq(self.slot, ask.response_index, self.longest)
            if isinstance(data, Refused):
                if data.code not in NOT_NOW:
                    raise HartClientError("module", f"{self._who}: record {ask.response_index}: {data.text}")
                last, idle_since = f"it refuses the response ({data.text})", now
            else:
                response = self._parsed(data)
                if response.result.is_over:
                    answer = self._fitting(ask, response)
                    if answer is not None:
                        return now, answer
                    last, idle_since = "it has answers to other requests only", now
                elif response.result in (Result.WAITING, Result.EXECUTING):
                    last, idle_since = f"the request is {response.result.words}", now
                else:
                    last = response.result.words
                    if now - idle_since >= _LOST_NS:
                        raise _DamagedError(
                            "module", "the module has lost the request, or another program has its answer"
                        )
            self.counters.not_yet += 1
            if now >= ask.deadline:
                raise HartClientError("timeout", f"{self._who}: the module has no answer yet: {last}{_maybe_done(ask)}")
            yield Pause(min(pause, ask.deadline - now))
            pause = min(2 * pause, _LONGEST_PAUSE)

    def _written(self, ask: _Ask) -> Transport[int]:
        """Write the request; a module that still works at another one is asked again."""
        pause = _FIRST_PAUSE
        while True:
            now, data = yield WriteReq(self.slot, ask.request_index, ask.octets)
            if not isinstance(data, Refused):
                self.counters.requests += 1
                return now
            if data.code not in NOT_NOW:
                raise HartClientError("module", f"{self._who}: the module refuses the request: {data.text}")
            self.counters.not_yet += 1
            if now >= ask.deadline:
                raise HartClientError(
                    "timeout", f"{self._who}: the module is still busy with another request: {data.text}"
                )
            yield Pause(min(pause, ask.deadline - now))
            pause = min(2 * pause, _LONGEST_PAUSE)

    @staticmethod
    def _parsed(data: bytes) -> Response:
        try:
            return Response.parse(data)
        except PduError as error:
            raise _DamagedError("damaged", str(error)) from None

    def _fitting(self, ask: _Ask, response: Response) -> Answer | None:
        """The answer to ``ask``; None if it is one to another request. Raises HartClientError, _DamagedError."""
        answer = response.answer
        stray = answer is not None and (
            answer.command != ask.number or (ask.address and answer.address and answer.address != ask.address)
        )
        if stray:
            self.counters.strays += 1
            return None
        if response.is_damage:
            raise _DamagedError("module", response.fault_text)
        if response.result.is_error and (answer is None or not answer.response_code):
            raise HartClientError("module", f"{self._who}: {response.fault_text}")
        if answer is None:
            raise _DamagedError("damaged", "the module reports success, without an answer of the device")
        return answer


class _Ask(NamedTuple):
    number: int
    octets: bytes
    #: of the long frame, without the bits of master and burst; empty without one
    address: bytes
    request_index: int
    response_index: int
    deadline: int


class _DamagedError(Exception):
    """An answer that was damaged, or got lost."""

    def __init__(self, reason: str, text: str) -> None:
        super().__init__(text)
        self.reason = reason
        self.text = text


def _maybe_done(ask: _Ask) -> str:
    return "" if ask.number in READS else "; the device may have carried it out: read it back"
