"""The module's end of HART records: channels with simulated transmitters, and their faults.

As a SIMATIC module has them (docs/reference/decisions/hart.md): a request record is refused while the channel works at
one; the response record says how far it is. A fault of a channel:

| fault | the next requests |
|---|---|
| slow | take ``value`` seconds |
| busy | are answered by the device with "busy" (response code 32), ``value`` times |
| delayed | "delayed response running" (34), ``value`` times |
| damaged | the module reports a checksum error of the answer, ``value`` times |
| garbled | the answer in the response record has a wrong check octet, ``value`` times |
| silent | the module reports that no answer came in time |
| denied | the response record is refused (0xB5) ``value`` times instead of saying how far the request is |
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from msgspec import Struct

from dpstack.dpv1.pdu.error_codes import Code
from dpstack.errors import PduError
from dpstack.hart.records import (
    DIRECTORY,
    FEATURES,
    Fault,
    Features,
    Request,
    Result,
    build_response,
    usual_directory,
)
from dpstack.hart.status import BUSY, COMMUNICATION_ERROR, DELAYED_RUNNING, MALFUNCTION, MORE_STATUS
from dpstack.hart.telegram import Telegram
from dpstack.hart.transmitter import Transmitter
from dpstack.text import did_you_mean
from dpstack.units import NS_PER_MS, NS_PER_S

#: duration of a request: 1200 bit/s
_DURATION_NS: Final = 300 * NS_PER_MS
#: until the module gives up a device that does not answer
_PATIENCE_NS: Final = 900 * NS_PER_MS
_SILENT: Final = 0x04
_CHECKSUM: Final = 0x08
_OPEN_LINE: Final = 3
FAULTS: Final = ("well", "slow", "busy", "delayed", "damaged", "garbled", "silent", "denied")
#: without a number, ``slow`` in seconds, the others in requests (0: until it is well)
_USUAL: Final = {"slow": 2.0, "delayed": 3.0}
_LONGEST_S: Final = 3600.0


class _Channel(Struct):
    transmitter: Transmitter
    response: bytes = build_response(Result.INACTIVE)
    ready_at: int = 0
    started_at: int = 0
    #: Reads that are refused instead of saying how far the request is
    denials: int = 0
    #: response control of the record while the request is under way
    under_way: bool = False
    fault: str = "well"
    value: float = 0.0
    #: requests that the fault still has; None: without end
    left: int | None = None


class HartModule:
    """The HART records of one module, a channel for each of ``transmitters``. Times (``now``) in ns."""

    def __init__(self, transmitters: Sequence[Transmitter]) -> None:
        self._directory = usual_directory(len(transmitters))
        self._features = Features(compact=True)
        self._channels = [_Channel(transmitter) for transmitter in transmitters]
        self._parameters = {index: bytes((0, 5, 3, 5, 0, 60, 3, 0)) for index in self._directory.channel_parameters}
        #: channels whose wire is broken
        self.broken: frozenset[int] = frozenset()

    @property
    def transmitters(self) -> tuple[Transmitter, ...]:
        return tuple(channel.transmitter for channel in self._channels)

    def has(self, index: int) -> bool:
        """Whether the record is one of HART."""
        return self._channel_of(index) is not None or index in (DIRECTORY, FEATURES, *self._parameters)

    def restart(self) -> None:
        """Switched off and on: no request is under way, and the transmitters start cold."""
        for channel in self._channels:
            channel.response, channel.under_way = build_response(Result.INACTIVE), False
            channel.transmitter.restart()

    def set_fault(self, number: int, fault: str, value: float | None = None) -> None:
        """A fault of a channel from now on, see the table above. Raises ValueError."""
        self._check(number)
        if fault not in FAULTS:
            hint = did_you_mean(fault, FAULTS, f"there are {', '.join(FAULTS)}")
            raise ValueError(f"there is no fault {fault!r} of a HART channel; {hint}")
        number_of = _USUAL.get(fault, 0.0) if value is None else value
        if not 0 <= number_of <= _LONGEST_S or (fault != "slow" and number_of != math.floor(number_of)):
            raise ValueError(
                f"{fault} {number_of:g}: a whole number of requests, or seconds of slow, up to {_LONGEST_S:g}"
            )
        channel = self._channels[number]
        channel.fault, channel.value = fault, number_of
        channel.left = int(number_of) if fault != "slow" and number_of else None

    def set_status(self, number: int, status: int) -> None:
        """The device status octet of the transmitter at a channel; a malfunction is an electronic defect in command
        48. Raises ValueError."""
        self._check(number)
        if not 0 <= status <= 0xFF:
            raise ValueError(f"{status} is no device status octet")
        transmitter = self._channels[number].transmitter
        transmitter.forced = status & ~MORE_STATUS
        transmitter.additional = {}
        if status & (MALFUNCTION | MORE_STATUS):
            transmitter.additional = {0: 0x01} if transmitter.revision < 7 else {6: 0x01, 8: 0x40}

    def _check(self, number: int) -> None:
        if not 0 <= number < len(self._channels):
            raise ValueError(f"there is no HART channel {number}; there are 0 to {len(self._channels) - 1}")

    @property
    def faults(self) -> dict[int, str]:
        """The faults that act, by channel."""
        return {
            number: f"{channel.fault} {channel.value:g}" if channel.fault == "slow" else channel.fault
            for number, channel in enumerate(self._channels)
            if channel.fault != "well"
        }

    # --- records ---

    def read(self, index: int, now: int) -> bytes | Code:
        """The record, or why it is refused."""
        if index == DIRECTORY:
            return self._directory.build()
        if index == FEATURES:
            return self._features.build()
        if index in self._parameters:
            return self._parameters[index]
        found = self._channel_of(index)
        if found is None:
            return Code.INVALID_INDEX
        channel, is_request = found
        if is_request:
            return Code.ACCESS_DENIED
        if channel.under_way and channel.denials:
            channel.denials -= 1
            return Code.STATE_CONFLICT
        if channel.under_way and now < channel.ready_at:
            begun = now >= channel.started_at + _DURATION_NS // 4
            return build_response(Result.EXECUTING if begun else Result.WAITING)
        channel.under_way = False
        return channel.response

    def write(self, index: int, data: bytes, now: int) -> Code | None:
        """Take a request, or parameters of a channel; why it is refused, or None."""
        if index in self._parameters:
            if len(data) != len(self._parameters[index]):
                return Code.WRITE_LENGTH_ERROR
            self._parameters[index] = data
            return None
        found = self._channel_of(index)
        if found is None or not found[1]:
            return Code.ACCESS_DENIED
        channel, _ = found
        if channel.under_way and now < channel.ready_at:
            return Code.RESOURCE_BUSY
        try:
            command, octets, request = Request.parse(data)
        except PduError:
            return Code.INVALID_PARAMETER
        channel.under_way, channel.started_at = True, now
        channel.denials = 0
        duration, channel.response = self._carried_out(channel, command, octets, request)
        channel.ready_at = now + duration
        return None

    def _channel_of(self, index: int) -> tuple[_Channel, bool] | None:
        """The channel of a record, and whether it is the request; None for another record."""
        for channel, request in zip(self._channels, self._directory.requests, strict=True):
            if index in (request, request + self._directory.offset):
                return channel, index == request
        return None

    def _carried_out(
        self, channel: _Channel, command: int, octets: bytes, request: Request | None
    ) -> tuple[int, bytes]:
        """How long the request takes, and the response record afterwards."""
        if self._channels.index(channel) in self.broken:
            return _DURATION_NS, _error(Fault.CHANNEL, _OPEN_LINE)
        fault = _next_fault(channel)
        transmitter = channel.transmitter
        if fault == "silent":
            return _PATIENCE_NS, _error(Fault.RESPONSE, _SILENT)
        if fault in ("busy", "delayed"):
            sent = transmitter.answer_compact(command, octets) if request is None else request.telegram
            return _DURATION_NS, _success(transmitter.busy(sent, BUSY if fault == "busy" else DELAYED_RUNNING))
        telegram = (
            transmitter.answer_compact(command, octets) if request is None else transmitter.answer_to(request.telegram)
        )
        if telegram is None:  # the address of another device
            return _PATIENCE_NS, _error(Fault.RESPONSE, _SILENT)
        if fault == "damaged":
            return _DURATION_NS, _error(Fault.RESPONSE, _CHECKSUM)
        if fault == "denied":
            channel.denials = int(channel.value) or 5
        response = _success(telegram)
        if fault == "garbled":
            response = response[:-1] + bytes((response[-1] ^ 0x01,))
        return round(channel.value * NS_PER_S) if fault == "slow" else _DURATION_NS, response


def _next_fault(channel: _Channel) -> str:
    """The fault of this request. One with a number of requests ends with the last of them."""
    fault = channel.fault
    if channel.left is not None and fault != "denied":
        channel.left -= 1
        if not channel.left:
            channel.fault, channel.left = "well", None
    return fault


def _success(telegram: Telegram) -> bytes:
    code, status = telegram.data[0], telegram.data[1]
    group = bool(status & MORE_STATUS) | 2 * bool(code & COMMUNICATION_ERROR)
    return build_response(Result.SUCCESS, group, telegram=telegram.build())


def _error(fault: int, code: int) -> bytes:
    return build_response(Result.ERROR, fault << 4, code)
