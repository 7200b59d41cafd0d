"""HART telegrams: delimiter, short and long address, command, data, check octet.

Sources: docs/reference/decisions/hart.md. A telegram in a record has no preambles, or some: :meth:`Telegram.parse`
skips them. The check octet is the exclusive or of all octets from the delimiter on.
"""

from __future__ import annotations

from enum import IntEnum
from functools import reduce
from operator import xor
from typing import Final

from msgspec import Struct

from dpstack.errors import PduError
from dpstack.hart.status import device_status_texts, response_text
from dpstack.text import octets_text

PREAMBLE: Final = 0xFF
#: octets of data in one telegram
MAX_DATA: Final = 255
#: length of an address of a short and of a long frame
SHORT: Final = 1
LONG: Final = 5
#: response code and device status, in front of the data of an answer
STATUS_LEN: Final = 2
_LONG_FRAME: Final = 0x80
_EXPANSION: Final = 0x60
_TYPE: Final = 0x07
_PRIMARY: Final = 0x80
_BURST: Final = 0x40
_IN_ADDRESS: Final = 0x3F


class FrameType(IntEnum):
    """Bits 2 to 0 of the delimiter."""

    BURST = 1
    REQUEST = 2
    ANSWER = 6


_NAMES: Final = {FrameType.BURST: "burst", FrameType.REQUEST: "request", FrameType.ANSWER: "answer"}


def check_octet(octets: bytes) -> int:
    """The exclusive or of ``octets``, which begin with the delimiter."""
    return reduce(xor, octets, 0)


class Telegram(Struct, frozen=True):
    """One telegram. ``address``: 1 octet of a short frame or 5 of a long one, with the bits of master and burst.

    ``data`` of an answer begins with response code and device status. ``checked``: whether it came with a check octet
    (some modules leave it out).
    """

    type: FrameType
    address: bytes
    command: int
    data: bytes = b""
    checked: bool = True

    @property
    def is_long(self) -> bool:
        return len(self.address) == LONG

    @property
    def primary(self) -> bool:
        """From or to the primary master."""
        return bool(self.address[0] & _PRIMARY)

    @property
    def burst(self) -> bool:
        """The device is in burst mode."""
        return bool(self.address[0] & _BURST)

    @property
    def device(self) -> bytes:
        """The address without the bits of master and burst."""
        return bytes((self.address[0] & _IN_ADDRESS,)) + self.address[1:]

    @property
    def text(self) -> str:
        """One line: kind, frame, address, command, data."""
        frame = "long" if self.is_long else "short"
        what = f"{_NAMES[self.type]}, {frame} frame, address {self.device.hex(' ').upper()}, command {self.command}"
        return f"{what}, {octets_text(len(self.data))} of data"

    def build(self) -> bytes:
        """The octets from the delimiter on, with the check octet. Raises PduError."""
        if len(self.address) not in (SHORT, LONG):
            raise PduError(f"a HART address has {SHORT} or {LONG} octets, not {len(self.address)}")
        if not 0 <= self.command <= 0xFF:
            raise PduError(f"HART command {self.command}: 0..255 are possible; extended ones are data of command 31")
        if len(self.data) > MAX_DATA:
            raise PduError(f"{len(self.data)} octets of data, {MAX_DATA} are possible in a HART telegram")
        delimiter = self.type | (_LONG_FRAME if self.is_long else 0)
        octets = bytes((delimiter,)) + self.address + bytes((self.command, len(self.data))) + self.data
        return octets + bytes((check_octet(octets),))

    @classmethod
    def parse(cls, octets: bytes) -> Telegram:
        """The telegram at the beginning of ``octets``, behind any preambles; octets behind it do not count. Raises
        PduError."""
        rest = octets.lstrip(bytes((PREAMBLE,)))
        if not rest:
            raise PduError("no HART telegram: " + ("nothing but preambles" if octets else "no octets"))
        delimiter = rest[0]
        kind = delimiter & _TYPE
        if kind not in _NAMES:
            raise PduError(f"no HART telegram: delimiter 0x{delimiter:02X} is neither request, answer nor burst")
        length = LONG if delimiter & _LONG_FRAME else SHORT
        at = 1 + length + (delimiter & _EXPANSION) // 0x20  # expansion octets have no meaning yet
        if len(rest) < at + 2:
            raise PduError(f"a HART telegram of {octets_text(len(rest))} ends before its byte count")
        command, count = rest[at], rest[at + 1]
        end = at + 2 + count
        if len(rest) < end:
            raise PduError(f"a HART telegram with {count} octets of data by its byte count has {len(rest) - at - 2}")
        checked = len(rest) > end
        if checked and rest[end] != check_octet(rest[:end]):
            raise PduError(
                f"a damaged HART telegram: check octet 0x{rest[end]:02X}, 0x{check_octet(rest[:end]):02X} is expected"
            )
        return cls(FrameType(kind), rest[1 : 1 + length], command, rest[at + 2 : end], checked)


class Answer(Struct, frozen=True):
    """The answer of a device: ``command``, ``response_code`` and ``device_status`` (octets), ``data`` behind them.

    ``address``: of a transparent answer, without the bits of master and burst; empty in compact format.
    """

    #: number of the command
    command: int
    #: 0: success; from 0x80 on errors that the device saw in the request
    response_code: int
    #: device status octet
    device_status: int
    #: data behind the two status octets
    data: bytes = b""
    #: address of the device, 5 octets of a long frame or 1 of a short one
    address: bytes = b""

    @property
    def response_text(self) -> str:
        """The response code in words."""
        return response_text(self.response_code)

    @property
    def device_status_texts(self) -> tuple[str, ...]:
        """The bits of the device status in words."""
        return device_status_texts(self.device_status)

    @classmethod
    def of(cls, telegram: Telegram) -> Answer:
        """The content of an answer or a burst. Raises PduError for a request, or without status octets."""
        if telegram.type is FrameType.REQUEST:
            raise PduError(f"a HART request (command {telegram.command}) stands where the answer is expected")
        return cls.of_data(telegram.command, telegram.data, telegram.device)

    @classmethod
    def of_data(cls, command: int, data: bytes, address: bytes = b"") -> Answer:
        """``data`` with the status octets in front. Raises PduError without them."""
        if len(data) < STATUS_LEN:
            raise PduError(f"a HART answer with {octets_text(len(data))} of data: it begins with two status octets")
        return cls(command, data[0], data[1], data[STATUS_LEN:], address)


def request(command: int, data: bytes = b"", address: bytes | None = None, *, poll_address: int = 0) -> Telegram:
    """A request of the primary master: long frame with ``address`` (5 octets), else short frame to ``poll_address``
    (0..63). Raises PduError."""
    if address is None:
        if not 0 <= poll_address <= _IN_ADDRESS:
            raise PduError(f"polling address {poll_address}: 0..{_IN_ADDRESS} are possible")
        return Telegram(FrameType.REQUEST, bytes((_PRIMARY | poll_address,)), command, data)
    if len(address) != LONG:
        raise PduError(f"a long HART address has {LONG} octets, not {len(address)}")
    return Telegram(FrameType.REQUEST, bytes((_PRIMARY | address[0],)) + address[1:], command, data)
