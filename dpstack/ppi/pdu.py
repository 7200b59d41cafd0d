"""Requests and answers of the CPU: read, write, run, stop, clock, and its errors in words.

A PDU: 32h, kind, two reserved octets, sequence number, lengths of parameter and data, in answers two octets of error,
parameter, data. Sources: docs/reference/decisions/ppi.md.
"""

from __future__ import annotations

import datetime
import struct
from collections.abc import Mapping, Sequence
from typing import Final, Literal, NamedTuple

from msgspec import Struct

from dpstack.errors import PduError, UsageError
from dpstack.ppi.addresses import AREAS, BIT, PpiAddress, PpiValue

REQUEST, ACKNOWLEDGEMENT, ANSWER, USER_DATA = 1, 2, 3, 7
READ, WRITE, RUN, STOP, NEGOTIATE = 0x04, 0x05, 0x28, 0x29, 0xF0
#: items of one request
MOST_ITEMS: Final = 20
#: octets of a PDU that every CPU takes
PDU_LENGTH: Final = 240
_PROTOCOL: Final = 0x32
_HEADER: Final = struct.Struct(">BBHHHH")
_GOOD: Final = 0xFF
#: kinds of data in an answer whose length is in bits, and those in octets
_BITS, _OCTETS = (0x03, 0x04), (0x00, 0x09)
_DATA_BIT, _DATA_OCTETS = 0x03, 0x04
_PROGRAM: Final = b"\x09P_PROGRAM"
_SET_CLOCK: Final = bytes((0x00, 0x01, 0x12, 0x04, 0x11, ord("G"), 0x02, 0x00))
_READ_CLOCK: Final = bytes((0x00, 0x01, 0x12, 0x04, 0x11, ord("G"), 0x01, 0x00))
#: low half of the octet 5 in the parameter of user data about the clock; the high half tells request from answer
_CLOCK_GROUP: Final = ord("G") & 0x0F
_CLOCK_ORDERS: Final[Mapping[int, Literal["read", "set"]]] = {1: "read", 2: "set"}

#: return code of an item
_ITEM_ERRORS: Final = {
    0x01: "hardware fault",
    0x03: "access is not allowed",
    0x05: "the address is beyond this CPU's memory",
    0x06: "this area does not have that data type",
    0x07: "data type and length do not agree",
    0x0A: "there is no such object in this CPU",
}
#: error of a PDU: class and code
_PDU_ERRORS: Final = {
    0x8000: "the function is occupied already",
    0x8001: "not allowed in the present mode of the CPU",
    0x8101: "hardware fault",
    0x8103: "access is not allowed",
    0x8104: "the CPU does not have this function, or the request is damaged",
    0x8105: "invalid address",
    0x8106: "this area does not have that data type",
    0x8107: "data type and length do not agree",
    0x810A: "there is no such object in this CPU",
    0x8500: "the PDU has a wrong length",
    0xD201: "wrong name of a block",
    0xD401: "wrong requests for information",
}


class CpuPdu(NamedTuple):
    """A PDU. ``error``: class and code in an acknowledgement or answer, else 0."""

    kind: int
    sequence: int
    parameter: bytes
    data: bytes = b""
    error: int = 0

    @property
    def octets(self) -> bytes:
        """The octets of the PDU."""
        head = _HEADER.pack(_PROTOCOL, self.kind, 0, self.sequence, len(self.parameter), len(self.data))
        error = self.error.to_bytes(2, "big") if self.kind in (ACKNOWLEDGEMENT, ANSWER) else b""
        return head + error + self.parameter + self.data


def parse_pdu(octets: bytes) -> CpuPdu:
    """The PDU of ``octets``. Raises :class:`~dpstack.errors.PduError`."""
    if len(octets) < _HEADER.size or octets[0] != _PROTOCOL:
        raise PduError(f"no PDU of an S7 CPU: {octets[:12].hex(' ')}")
    _, kind, _, sequence, parameters, length = _HEADER.unpack_from(octets)
    begin = _HEADER.size + (2 if kind in (ACKNOWLEDGEMENT, ANSWER) else 0)
    if len(octets) != begin + parameters + length:
        raise PduError(f"a PDU of {len(octets)} octets, but its header says {begin + parameters + length}")
    error = int.from_bytes(octets[_HEADER.size : begin], "big")
    return CpuPdu(kind, sequence, octets[begin : begin + parameters], octets[begin + parameters :], error)


def pdu_error(error: int) -> str:
    """The error of an answer in words."""
    return f"{_PDU_ERRORS.get(error, 'unknown error')} (error {error:04X}h)"


def item_error(code: int) -> str:
    """The return code of an item in words."""
    return f"{_ITEM_ERRORS.get(code, 'unknown return code')} (code {code:02X}h)"


# --- requests ---------------------------------------------------------------------------------------------------------
def negotiate_request(sequence: int) -> CpuPdu:
    """The request to agree on the length of PDUs; the CPU answers with the one that it takes."""
    return CpuPdu(REQUEST, sequence, struct.pack(">BBHHH", NEGOTIATE, 0, 1, 1, 0x03C0))


def negotiated(answer: CpuPdu) -> int:
    """The length of PDUs that the CPU takes. Raises :class:`~dpstack.errors.PduError`."""
    if len(answer.parameter) != 8 or answer.parameter[0] != NEGOTIATE:
        raise PduError("the answer is none to the request for the length of PDUs")
    return int.from_bytes(answer.parameter[6:], "big")


def read_request(sequence: int, addresses: Sequence[PpiAddress]) -> CpuPdu:
    """A request to read up to :data:`MOST_ITEMS` addresses whose values fit one PDU, see :func:`fit`."""
    return CpuPdu(REQUEST, sequence, bytes((READ, len(addresses))) + b"".join(each.item for each in addresses))


def write_request(sequence: int, address: PpiAddress, value: PpiValue) -> CpuPdu:
    """A request to write one value. Raises :class:`~dpstack.errors.UsageError` if the value does not fit."""
    octets = address.octets(value)
    if address.size == BIT:
        data = struct.pack(">BBH", 0, _DATA_BIT, 1) + octets
    else:
        data = struct.pack(">BBH", 0, _DATA_OCTETS, 8 * len(octets)) + octets
    return CpuPdu(REQUEST, sequence, bytes((WRITE, 1)) + address.item, data)


def run_request(sequence: int) -> CpuPdu:
    """A request to go to RUN."""
    return CpuPdu(REQUEST, sequence, bytes((RUN, 0, 0, 0, 0, 0, 0, 0xFD, 0, 0)) + _PROGRAM)


def stop_request(sequence: int) -> CpuPdu:
    """A request to go to STOP."""
    return CpuPdu(REQUEST, sequence, bytes((STOP, 0, 0, 0, 0, 0)) + _PROGRAM)


def clock_request(sequence: int) -> CpuPdu:
    """A request for the CPU's clock."""
    return CpuPdu(USER_DATA, sequence, _READ_CLOCK, b"\x0a\x00\x00\x00")


def set_clock_request(sequence: int, time: datetime.datetime) -> CpuPdu:
    """A request to set the CPU's clock; its years are 1990 to 2089, as BCD has two digits."""
    if not 1990 <= time.year <= 2089:
        raise UsageError(f"the clock of the CPU has the years 1990 to 2089, not {time.year}")
    return CpuPdu(USER_DATA, sequence, _SET_CLOCK, b"\xff\x09\x00\x0a" + clock_octets(time))


def clock_octets(time: datetime.datetime) -> bytes:
    """A time as the clock has it: reserved, century, BCD year to second, milliseconds with day of week (1: Sunday)."""
    thousandths = time.microsecond // 1000
    parts = (time.year // 100, time.year % 100, time.month, time.day, time.hour, time.minute, time.second)
    weekday = time.isoweekday() % 7 + 1
    return bytes((0, *map(_bcd, parts), _bcd(thousandths // 10), thousandths % 10 << 4 | weekday))


def parse_clock(octets: bytes) -> datetime.datetime:
    """The time of the clock. Raises :class:`~dpstack.errors.PduError`."""
    if len(octets) != 10:
        raise PduError(f"a clock of {len(octets)} octets, not 10")
    numbers = [10 * (octet >> 4) + (octet & 0x0F) for octet in octets]
    year = numbers[2] + (1900 if numbers[2] >= 90 else 2000)
    thousandths = numbers[8] * 10 + (octets[9] >> 4)
    try:
        month, day, hour, minute, second = numbers[3:8]
        return datetime.datetime(year, month, day, hour, minute, second, thousandths * 1000)
    except ValueError:
        raise PduError(f"no time of a clock: {octets.hex(' ')}") from None


def _bcd(number: int) -> int:
    return number // 10 << 4 | number % 10


# --- answers ----------------------------------------------------------------------------------------------------------
def answer_length(addresses: Sequence[PpiAddress]) -> int:
    """Octets of the answer to a read of ``addresses``."""
    return _HEADER.size + 4 + sum(4 + address.length + address.length % 2 for address in addresses)


def fit(addresses: Sequence[PpiAddress], pdu_length: int = PDU_LENGTH) -> int:
    """How many of ``addresses``, from the first on, one request can read: items, request and answer are limited."""
    for number in range(len(addresses)):
        answer = answer_length(addresses[: number + 1])
        if number == MOST_ITEMS or answer > pdu_length or _HEADER.size + 2 + 12 * (number + 1) > pdu_length:
            return max(1, number)
    return len(addresses)


def read_items(answer: CpuPdu, addresses: Sequence[PpiAddress]) -> list[PpiValue | int]:
    """The value of each address, or the return code (``ReturnCode``) if the CPU has none.

    Raises :class:`~dpstack.errors.PduError` if the answer is damaged or none to a read of these addresses.
    """
    if answer.parameter != bytes((READ, len(addresses))):
        raise PduError("the answer is none to this read")
    items = items_of_data(answer.data, len(addresses))
    return [
        address.value(octets) if code == _GOOD else ReturnCode(code)
        for address, (code, octets) in zip(addresses, items, strict=True)
    ]


def items_of_data(data: bytes, count: int) -> list[tuple[int, bytes]]:
    """The return code and the octets of each of ``count`` items in the data of an answer to a read, or of a write,
    whose codes are 0. Raises :class:`~dpstack.errors.PduError` if the data end before."""
    found = []
    at = 0
    for number in range(1, count + 1):
        head = data[at : at + 4]
        if len(head) < 4:
            raise PduError(f"the data end before item {number} of {count}")
        code, kind, length = struct.unpack(">BBH", head)
        octets = _octets_of(kind, length) if code in (0, _GOOD) else 0
        found.append((code, data[at + 4 : at + 4 + octets]))
        at += 4 + octets + octets % 2
    return found


def _octets_of(kind: int, length: int) -> int:
    if kind in _BITS:
        return (length + 7) // 8
    if kind in _OCTETS:
        return length
    raise PduError(f"data of unknown kind {kind:02X}h in the answer")


class ReturnCode(int):
    """The return code of an item that has no value."""


def written(answer: CpuPdu) -> int:
    """The return code of a write of one value: FFh is good. Raises :class:`~dpstack.errors.PduError`."""
    if answer.parameter != bytes((WRITE, 1)) or len(answer.data) != 1:
        raise PduError("the answer is none to this write")
    return answer.data[0]


def is_good(code: int) -> bool:
    """Whether a return code is good."""
    return code == _GOOD


def user_data(answer: CpuPdu) -> bytes:
    """The data of an answer to user data. Raises :class:`~dpstack.errors.PduError` for an error or other octets."""
    if answer.kind != USER_DATA or len(answer.parameter) != 12:
        raise PduError("the answer is none to this request")
    if error := int.from_bytes(answer.parameter[10:], "big"):
        raise PduError(f"the CPU refuses: {pdu_error(error)}")
    return answer.data[4:] if answer.data[:1] == b"\xff" else b""


def is_clock_order(pdu: CpuPdu) -> Literal["read", "set"] | None:
    """Whether user data, of a request or an answer, are about the clock."""
    asks = pdu.parameter[5:7]
    if pdu.kind != USER_DATA or len(asks) < 2 or asks[0] & 0x0F != _CLOCK_GROUP:
        return None
    return _CLOCK_ORDERS.get(asks[1])


# --- requests as a CPU reads them -------------------------------------------------------------------------------------
class Item(Struct, frozen=True):
    """The address of a request as octets say it."""

    size: int
    count: int
    block: int
    area: int
    start: int


def parse_items(parameter: bytes) -> list[Item]:
    """The items of a read or write. Raises :class:`~dpstack.errors.PduError`."""
    count = parameter[1] if len(parameter) > 1 else 0
    items = [parameter[at : at + 12] for at in range(2, len(parameter), 12)]
    if len(items) != count or any(len(item) != 12 or item[:3] != b"\x12\x0a\x10" for item in items):
        raise PduError("the addresses of the request are damaged")
    found = []
    for item in items:
        size, number, block, area = struct.unpack(">BHHB", item[3:9])
        found.append(Item(size, number, block, area, int.from_bytes(item[9:], "big")))
    return found


def item_data(code: int, size: int, octets: bytes) -> bytes:
    """The data of one item of an answer, without the filling octet behind it."""
    if not is_good(code):
        return struct.pack(">BBH", code, 0, 0)
    if size == BIT:
        return struct.pack(">BBH", code, _DATA_BIT, 1) + octets
    if size in (AREAS["T"].code, AREAS["C"].code):
        return struct.pack(">BBH", code, 0x09, len(octets)) + octets
    return struct.pack(">BBH", code, _DATA_OCTETS, 8 * len(octets)) + octets
