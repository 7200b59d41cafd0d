"""Transmissions of a bus in columns, without loss: each Data_Exchange with its answer is a row, every other one too.

A bus repeats itself, so that octets stand in the table once. One process can make the columns, another one count them.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

from msgspec import Struct

from dpstack.capture.transmission import Columns, Transmission
from dpstack.fdl.codec import decode
from dpstack.fdl.telegram import FC_FCV, FC_FUNCTION, FC_REQUEST, Kind, Req, Resp, Telegram
from dpstack.params import BROADCAST

#: telegrams that are kept with what their octets say
_KEPT_TELEGRAMS: Final = 4096
#: entries that are made before it counts whether most transmissions differ
_FEW: Final = 256
_SC: Final = Kind.SC
#: of Data_Exchange
_IS_SRD: Final = tuple(number in (Req.SRD_LOW, Req.SRD_HIGH) for number in range(16))
#: answers of a slave in data exchange that announce no diagnosis; OK and NR come from slaves without inputs
_IS_USUAL: Final = tuple(number in (Resp.OK, Resp.DL, Resp.NR, Resp.RDL) for number in range(16))
#: octets of the shortest PDU of an S7-200, and the first one of all
_LEAST_PDU: Final = 10
_PDU: Final = 0x32
_NEW = tuple.__new__  # the constructor of a NamedTuple takes twice as long

#: roles: a Data_Exchange with a frame count, an answer to one, any other transmission
ASKS, ANSWERS, OTHER = 1, 2, 0


class Judged(NamedTuple):
    """What octets say, whatever came before them. ``key``: of master and station (master * 128 + station), -1 without
    addresses."""

    role: int
    telegram: Telegram | None
    fc: int
    key: int


_NO_TELEGRAM: Final = Judged(OTHER, None, -1, -1)


def is_pdu(data: bytes) -> bool:
    """Whether a data unit without SAPs is a PDU of an S7-200 (PPI), and not process data, unless its station has shown
    that it is a DP slave."""
    if len(data) < _LEAST_PDU or data[0] != _PDU or data[2] or data[3]:
        return False
    from dpstack.decode.ppi import pdu_of  # here, as most buses have no such CPU

    return pdu_of(data) is not None


class Telegrams(dict[bytes, Judged]):
    """Judges octets, and keeps the last ones."""

    def __missing__(self, octets: bytes) -> Judged:
        telegram = decode(octets)
        if telegram is None:
            return _NO_TELEGRAM
        role, key, fc = OTHER, -1, telegram.fc
        if fc < 0:
            role = ANSWERS if telegram.kind is _SC else OTHER
        elif telegram.dsap is None and not is_pdu(telegram.data):
            function = fc & FC_FUNCTION
            if fc & FC_REQUEST:
                if _IS_SRD[function] and fc & FC_FCV and telegram.da != BROADCAST:
                    role, key = ASKS, telegram.sa << 7 | telegram.da
            elif telegram.ssap is None and _IS_USUAL[function]:
                role, key = ANSWERS, telegram.da << 7 | telegram.sa
        if len(self) >= _KEPT_TELEGRAMS:
            self.clear()
        self[octets] = found = _NEW(Judged, (role, telegram, fc, key))
        return found


#: the octets of a row: a request and its answer, or one transmission
Entry = tuple[bytes, bytes | None]


class Exchanges(Struct, frozen=True):
    """Transmissions at one rate. ``rows``: numbers of entries; ``starts``: time of the first bit of each row, in ns
    since 1970, ``answers``: of its answer. Iterating over it makes the transmissions one by one."""

    baud: int
    table: list[Entry]
    rows: Sequence[int]
    starts: Sequence[int]
    answers: Sequence[int]

    def packed(self) -> Exchanges:
        """The same for another process, in fewer octets. Raises OverflowError for times of more than 64 bits."""
        rows, starts, answers = array("I", self.rows), array("q", self.starts), array("q", self.answers)
        return Exchanges(self.baud, self.table, rows, starts, answers)

    def __iter__(self) -> Iterator[Transmission]:
        baud = self.baud
        for row, start, answered in zip(self.rows, self.starts, self.answers, strict=True):
            octets, answer = self.table[row]
            yield Transmission(octets, start, baud)
            if answer is not None:
                yield Transmission(answer, answered, baud)


#: some transmissions
Batch = Sequence[Transmission] | Columns | Exchanges


def condense(heard: Columns, known: Telegrams) -> Exchanges | None:
    """``heard`` by exchanges. None if most transmissions differ, so that it is not worth while."""
    numbers: dict[object, int] = {}  # of entries
    table: list[Entry] = []
    rows: list[int] = []
    starts: list[int] = []
    answers: list[int] = []
    asked: bytes | None = None
    asked_at = asked_key = 0
    for octets, start in zip(heard.octets, heard.times, strict=True):
        role, _, _, key = known[octets]
        if asked is not None:
            answer = octets if role == ANSWERS and (key == asked_key or key < 0) and start >= asked_at else None
            number = numbers.get((asked, answer))
            if number is None:
                number = numbers[asked, answer] = len(table)
                table.append((asked, answer))
            rows.append(number)
            starts.append(asked_at)
            answers.append(start)
            asked = None
            if answer is not None:
                continue
        if role == ASKS:
            asked, asked_at, asked_key = octets, start, key
            continue
        number = numbers.get(octets)
        if number is None:
            number = numbers[octets] = len(table)
            table.append((octets, None))
            if number > _FEW and number > len(rows) // 2:
                return None
        rows.append(number)
        starts.append(start)
        answers.append(start)
    if asked is not None:
        rows.append(len(table))
        table.append((asked, None))
        starts.append(asked_at)
        answers.append(asked_at)
    return Exchanges(heard.baud, table, rows, starts, answers)
