"""A simulated HART transmitter: its answers to universal commands. Two made-up devices of no real vendor.

It measures what the analogue input of its channel reads: ``percent`` of its range.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import Final

from dpstack.hart.status import BUSY, NOT_IMPLEMENTED
from dpstack.hart.tables import NOT_USED, pack_ascii
from dpstack.hart.telegram import FrameType, Telegram

#: no maker: "special" in the table of makers
MAKER: Final = 0xFD
_LOWEST_MA: Final = 4.0
_SPAN_MA: Final = 16.0
_MA_PER_PERCENT: Final = _SPAN_MA / 100
_TOO_LARGE: Final = 3
_TOO_SHORT: Final = 5
_CHANGED: Final = 0x40
_COLD_START: Final = 0x20
_PRIMARY_OUT: Final = 0x01
_SATURATED: Final = 0x04
_MORE: Final = 0x10
#: NE 43: the current follows the value from 3.8 to 20.5 mA
_SATURATION: Final = (-1.25, 103.125)
_LATIN_LEN: Final = 32
_MESSAGE_LEN: Final = 32
_PRIMARY: Final = 0x80
_IN_ADDRESS: Final = 0x3F
_NOT_A_NUMBER: Final = bytes.fromhex("7FA00000")


class Transmitter:
    """``revision``: of HART, 5 or 7 (its expanded type has MAKER in the first octet). ``unit`` of the primary variable,
    ``lower`` and ``upper``: its range.

    ``others``: unit and value of further variables.
    """

    def __init__(
        self,
        tag: str,
        *,
        revision: int,
        device_type: int,
        device_id: int,
        unit: int,
        lower: float,
        upper: float,
        others: tuple[tuple[int, float], ...] = (),
        descriptor: str = "",
    ) -> None:
        self.revision = revision
        self.device_type = device_type
        self.device_id = device_id
        self.unit = unit
        self.lower = lower
        self.upper = upper
        self.others = others
        self.damping = 0.5
        self.tag = pack_ascii(tag, 8) + pack_ascii(descriptor, 16) + bytes((31, 3, 126))
        self.long_tag = tag.encode("latin-1").ljust(_LATIN_LEN, b"\0")
        self.message = pack_ascii("", _MESSAGE_LEN)
        #: of the range; what the analogue input reads
        self.percent = 0.0
        #: bits of the device status octet from outside, and octets of command 48 by their place
        self.forced = 0
        self.additional: dict[int, int] = {}
        self._changes = 0
        self._status = _COLD_START

    @property
    def address(self) -> bytes:
        """Of long frames, without the bits of master and burst."""
        return bytes((MAKER & _IN_ADDRESS, self.device_type)) + self.device_id.to_bytes(3, "big")

    @property
    def value(self) -> float:
        """The primary variable."""
        return self.lower + self.percent / 100 * (self.upper - self.lower)

    @property
    def current(self) -> float:
        """The loop current in mA."""
        low, high = _SATURATION
        return _LOWEST_MA + min(max(self.percent, low), high) * _MA_PER_PERCENT

    def restart(self) -> None:
        """Switched off and on: the next answer says so."""
        self._status |= _COLD_START

    def answer_to(self, telegram: Telegram) -> Telegram | None:
        """The answer to a request; None to one for another device."""
        mine = telegram.device == self.address if telegram.is_long else telegram.device == b"\0"
        if telegram.type is not FrameType.REQUEST or not mine:
            return None
        data = self.reply(telegram.command, telegram.data)
        return Telegram(FrameType.ANSWER, telegram.address, telegram.command, data)

    def answer_compact(self, command: int, data: bytes) -> Telegram:
        """The answer to a request in compact format: its module makes the telegram of the primary master."""
        address = bytes((self.address[0] | _PRIMARY,)) + self.address[1:]
        return Telegram(FrameType.ANSWER, address if command else address[:1], command, self.reply(command, data))

    def busy(self, telegram: Telegram, code: int = BUSY) -> Telegram:
        """The answer of a device that is busy to ``telegram``: with this response code, without data."""
        return Telegram(FrameType.ANSWER, telegram.address, telegram.command, bytes((code, self.status)))

    @property
    def status(self) -> int:
        """The device status octet."""
        low, high = _SATURATION
        measured = (_SATURATED if not low <= self.percent <= high else 0) | _PRIMARY_OUT * (abs(self.percent) > 110)
        more = _MORE if any(self.additional.values()) else 0
        return self._status | self.forced | measured | more

    def reply(self, command: int, data: bytes) -> bytes:
        """Response code, device status and data."""
        write = self._writes.get(command)
        read = self._reads.get(command)
        code, found = 0, b""
        if write is not None:
            code, found = write(data)
        elif read is not None:
            found = read()
        else:
            code = NOT_IMPLEMENTED
        octets = bytes((code, self.status)) + found
        self._status &= ~_COLD_START  # it is said once
        return octets

    # --- commands that read ---

    @property
    def _reads(self) -> Mapping[int, Callable[[], bytes]]:
        commands = {
            0: self._identity,
            1: lambda: _float(self.value, self.unit),
            2: lambda: _float(self.current) + _float(self.percent),
            3: self._variables,
            12: lambda: self.message,
            13: lambda: self.tag,
            14: lambda: bytes(3) + _float(2 * self.upper, self.unit) + _float(2 * self.lower) + _float(1.0),
            15: self._range,
            16: lambda: bytes(3),
            48: self._additional,
        }
        return {**commands, 20: lambda: self.long_tag} if self.revision >= 6 else commands

    def _identity(self) -> bytes:
        first = bytes((254, MAKER, self.device_type, 5, self.revision, 1, 1, 1 << 3, 0))
        octets = first + self.device_id.to_bytes(3, "big")
        if self.revision < 7:
            return octets
        counter = self._changes.to_bytes(2, "big")
        extended = bytes((self.additional.get(6, 0),))
        return octets + bytes((5, 1 + len(self.others))) + counter + extended + MAKER.to_bytes(2, "big") * 2 + b"\1"

    def _variables(self) -> bytes:
        """HART 7 has always four, those that it does not have "not used"; older devices leave them out."""
        found = _float(self.current) + _float(self.value, self.unit)
        found += b"".join(_float(value, unit) for unit, value in self.others)
        missing = 3 - len(self.others) if self.revision >= 7 else 0
        return found + missing * (bytes((NOT_USED,)) + _NOT_A_NUMBER)

    def _range(self) -> bytes:
        limits = _float(self.upper, self.unit) + _float(self.lower) + _float(self.damping)
        return bytes(2) + limits + bytes((0, NOT_USED, 0))

    def _additional(self) -> bytes:
        return bytes(self.additional.get(at, 0) for at in range(9 if self.revision >= 7 else 6))

    # --- commands that write ---

    @property
    def _writes(self) -> Mapping[int, Callable[[bytes], tuple[int, bytes]]]:
        commands = {
            17: lambda data: self._keep("message", data, 24),
            18: lambda data: self._keep("tag", data, 21),
            34: self._write_damping,
            35: self._write_range,
            38: self._reset_changed,
        }
        return {**commands, 22: lambda data: self._keep("long_tag", data, 32)} if self.revision >= 6 else commands

    def _keep(self, name: str, data: bytes, length: int) -> tuple[int, bytes]:
        if len(data) < length:
            return _TOO_SHORT, b""
        setattr(self, name, data[:length])
        return self._written(data[:length])

    def _write_damping(self, data: bytes) -> tuple[int, bytes]:
        if len(data) < 4:
            return _TOO_SHORT, b""
        damping = _number(data, 0)
        if not 0 <= damping <= 60:
            return _TOO_LARGE, b""
        self.damping = damping
        return self._written(data[:4])

    def _write_range(self, data: bytes) -> tuple[int, bytes]:
        """Unit, upper and lower value; the measured value stays, its part of the range changes."""
        if len(data) < 9:
            return _TOO_SHORT, b""
        upper, lower = _number(data, 1), _number(data, 5)
        if data[0] != self.unit:
            return 18, b""
        if not upper - lower >= 1e-3:
            return 29, b""
        self.lower, self.upper = lower, upper
        return self._written(data[:9])

    def _reset_changed(self, data: bytes) -> tuple[int, bytes]:
        self._status &= ~_CHANGED
        return 0, b""

    def _written(self, data: bytes) -> tuple[int, bytes]:
        self._changes += 1
        self._status |= _CHANGED
        return 0, data


def pressure() -> Transmitter:
    """A pressure transmitter of HART 7, 0 to 10 bar, with the temperature of its sensor."""
    return Transmitter(
        "PT-101",
        revision=7,
        device_type=0x01,
        device_id=0x010203,
        unit=7,
        lower=0.0,
        upper=10.0,
        others=((32, 24.5),),
        descriptor="FEED PUMP",
    )


def temperature() -> Transmitter:
    """A temperature transmitter of HART 5, -50 to 150 °C."""
    return Transmitter(
        "TT-102",
        revision=5,
        device_type=0x02,
        device_id=0x010204,
        unit=32,
        lower=-50.0,
        upper=150.0,
        descriptor="REACTOR TOP",
    )


def _float(number: float, unit: int | None = None) -> bytes:
    octets = struct.pack(">f", number)
    return octets if unit is None else bytes((unit,)) + octets


def _number(data: bytes, at: int) -> float:
    (number,) = struct.unpack_from(">f", data, at)
    return float(number)
