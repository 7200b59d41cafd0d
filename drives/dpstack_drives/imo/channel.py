"""The PKW zone of the HD2 (docs/reference/drives/imo-hd2.md#pkw-zone): PKW1 request or response, PKW2 address, PKW3 and
PKW4 the value; both ends.

Source: tables 2-9 to 2-11. Readings: the response repeats the address, as in the manual's example; a request acts when
it changes, and a read gives the momentary value; response 4, which stands in the table of acceptance only, is
that the master has no rights (CW bit 8 is 0).
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from enum import IntEnum
from typing import Final

from msgspec import structs

from dpstack.profile import (
    CommandError,
    CycleTimes,
    ParameterChannel,
    ParamKey,
    ParamSpec,
    ParamTable,
    Pkw,
    PkwChannel,
    PkwDialect,
    Steps,
    StoredWrites,
    signed16,
)
from dpstack_drives.imo import table as t

_LAYOUT: Final = struct.Struct(">HHI")


class Request(IntEnum):
    """PKW1 of the master (table 2-10); 2, 3 and 5 are not supported by the card today."""

    NONE = 0
    READ = 1
    WORD_TO_RAM = 2
    LONG_TO_RAM = 3
    WORD = 4
    LONG = 5


class Response(IntEnum):
    """PKW1 of the drive (tables 2-10 and 2-11)."""

    NONE = 0
    WORD = 1
    LONG = 2
    ERROR = 3
    NO_RIGHTS = 4


class ImoPkw(Pkw):
    """The eight octets as four words: ``id`` PKW1, ``pnu`` PKW2, ``pwe`` PKW3 and PKW4."""

    __slots__ = ()

    def build(self) -> bytes:
        return _LAYOUT.pack(self.id, self.pnu, self.pwe)

    @classmethod
    def parse(cls, octets: bytes) -> ImoPkw:
        """From (at least) eight octets."""
        number, address, value = _LAYOUT.unpack_from(octets)
        return cls(number, address, 0, value)


_NO_RAM: Final = (
    "the card does not support writes to RAM only (request 2): leave ram out, it then writes RAM and EEPROM (request 4)"
)
_EEPROM: Final = (
    "each write goes to RAM and EEPROM (request 4; the card has no other): an EEPROM takes a limited number of them"
)


class ImoAccess(PkwChannel, ParameterChannel):
    """The master's end. ``plain``: answers and errors; ``table``: the parameters; those that are made up are the
    simulated drive's. ``notice`` shows a line to the user."""

    def __init__(self, plain: PkwDialect, table: ParamTable, times: CycleTimes, notice: Callable[[str], None]) -> None:
        super().__init__(structs.replace(plain, layout=ImoPkw), times)
        self._plain = plain
        self._table = table
        self._notice = notice
        self._warned = False
        self._stored_writes = StoredWrites()

    orders = Request
    replies = Response
    error_reply = Response.ERROR

    def error_number(self, reply: Pkw) -> int:
        """It stands in the high word."""
        return reply.pwe >> 16

    def describe_stray(self, reply: Pkw) -> str:
        return f"{t.name_of(reply.pnu)} (response {reply.id})"

    @property
    def writing(self) -> bool:
        """The request needs CW bit 8."""
        return self.octets[1] == Request.WORD

    def read(self, key: ParamKey, deadline: int) -> Steps[dict[str, object]]:
        number = address_of(key)
        reply = yield from self._exchange(ImoPkw(Request.READ, number), deadline)
        return self._outcome(number, reply)

    def write(self, key: ParamKey, value: float, deadline: int) -> Steps[dict[str, object]]:
        """Write one parameter of one word to RAM and EEPROM."""
        number = address_of(key)
        if key.ram:
            raise CommandError("usage", _NO_RAM)
        raw = self._raw(number, value)
        reply = yield from self.put(number, raw, deadline)
        return self._outcome(number, reply, value)

    def get(self, number: int, deadline: int) -> Steps[int]:
        """The value at an address."""
        reply = yield from self._exchange(ImoPkw(Request.READ, number), deadline)
        return reply.pwe

    def put(self, number: int, raw: int, deadline: int) -> Steps[Pkw]:
        """Write a word at an address."""
        self._stored_writes.admit(number, f"parameter {self._label(number)}", self.times.now, self._known(number))
        if not self._warned:
            self._warned = True
            self._notice(_EEPROM)
        reply = yield from self._exchange(ImoPkw(Request.WORD, number, 0, raw), deadline)
        return reply

    def _exchange(self, request: ImoPkw, deadline: int) -> Steps[Pkw]:
        label = self._label(request.pnu)
        reply = yield from self.replied(request, label, deadline)
        if reply.id == Response.ERROR:
            number = self.error_number(reply)
            raise CommandError("parameter", f"{label}: error {number}, {self._plain.error_text(number)}", number)
        if reply.id == Response.NO_RIGHTS:
            raise CommandError("parameter", f"{label}: the bus has no right to change parameters (response 4)")
        if reply.id not in self._plain.answers[request.id]:
            raise CommandError("parameter", f"{label}: response {reply.id} does not answer request {request.id}")
        return reply

    def _known(self, number: int) -> ParamSpec | None:
        """The parameter at an address, if the manual of the card has it."""
        spec = self._table.get(number)
        return None if spec is None or spec.made_up else spec

    def _label(self, number: int) -> str:
        spec = self._known(number)
        return t.name_of(number) if spec is None else spec.label

    def _raw(self, number: int, value: float) -> int:
        """The word to write. Raises CommandError."""
        spec = self._known(number)
        if spec is None:
            if value != int(value) or not -0x8000 <= value <= 0xFFFF:
                raise CommandError(
                    "usage",
                    f"{self._label(number)}: its scale is in the inverter's manual: give the 16-bit integer on the "
                    "wire (the card does not write parameters of two words, request 5)",
                )
            return int(value) & 0xFFFF
        if spec.read_only:
            raise CommandError("usage", f"{spec.label} is read only")
        try:
            return spec.to_raw(value) & 0xFFFF
        except ValueError as error:
            raise CommandError("usage", str(error)) from None

    def _outcome(self, number: int, reply: Pkw, written: float = 0) -> dict[str, object]:
        """``written``: the value of a write; a negative one says that a parameter of unknown type has a sign."""
        spec = self._known(number)
        raw = reply.pwe if reply.id == Response.LONG else reply.pwe & 0xFFFF
        if written < 0:
            raw = signed16(raw)
        return {
            "value": raw if spec is None else spec.to_value(raw),
            "raw": raw,
            "number": number,
            "name": t.name_of(number),
            "unit": spec.unit if spec else "",
            "data_set": None,
        }


def address_of(key: ParamKey) -> int:
    """PKW2 of what a user named. Raises CommandError."""
    name = key.name
    number = t.address(name) if isinstance(name, str) else name
    if isinstance(name, str) and number is None and name.isascii() and name.strip().isdecimal():
        number = int(name)
    if number is None:
        raise CommandError("usage", f"{name!r} is neither a function code such as P15.02 nor an address")
    if number > 0xFFFF:
        raise CommandError("usage", f"parameter {number}: addresses are 0..65535 (group x 256 + number)")
    if key.data_set is not None or key.index is not None:
        raise CommandError("usage", f"{t.name_of(number)}: imo-hd2 has neither data sets nor indexes")
    return number
