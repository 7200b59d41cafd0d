"""Codec between telegrams and octets: SD1, SD2, SD3, SD4 and SC, the FC octet, address extension octets, FCS.

Layouts: docs/reference/protocol.md#telegrams, docs/reference/protocol.md#addresses (extension octets: those of DA come
first, then SA's), docs/reference/protocol.md#function-code.

:func:`parse` judges octets. It recognises a frame that cannot become a telegram by the first octet that shows it
(an impossible LE by its repetition), not at the end of the frame. :func:`decode` accepts the same telegrams, whole.
"""

from __future__ import annotations

from enum import Enum
from functools import lru_cache
from typing import Final
from zlib import adler32

from dpstack.fdl.telegram import ED, MAX_LE, MIN_LE, SHORT_ACK, Kind, Telegram
from dpstack.params import BROADCAST, UNADDRESSED

SC_OCTETS: Final = b"\xe5"

#: LE of an SD2 telegram without a data unit: DA, SA, FC. Two known slaves send it; dpstack accepts and never sends it.
EMPTY_LE: Final = 3

_EXTENDED: Final = 0x80  # bit 7 of DA or SA: address extension octets follow
_MORE: Final = 0x80  # bit 7 of an extension octet: another one follows
_SEGMENT: Final = 0x40  # bit 6: region/segment address, else SAP
_VALUE: Final = 0x3F

_SD1: Final = int(Kind.SD1)
_SD2: Final = int(Kind.SD2)
_SD3: Final = int(Kind.SD3)
_SD4: Final = int(Kind.SD4)
_SC: Final = int(Kind.SC)
# names of the module, because the look-up of an enum's member takes ten times as long
_KIND_SD1: Final = Kind.SD1
_KIND_SD2: Final = Kind.SD2
_KIND_SD3: Final = Kind.SD3
_KIND_SD4: Final = Kind.SD4

#: FCS and ED, by the low octet of adler32(data) + the FCS of the octets before the data, which :func:`_head` caches.
#: The low 16 bits of Adler-32 are 1 + a sum modulo 65521, which 246 octets do not reach. It is faster than sum().
_TAILS: Final = tuple(bytes(((index - 1) & 0xFF, ED)) for index in range(256))
#: octets of the longest telegram
_LONGEST: Final = MAX_LE + 6
#: number of cached heads: 126 stations with both FCB and both directions have 504
_KEPT_HEADS: Final = 1_024


class Flaw(Enum):
    """The reasons why octets are no telegram. The value is the counter's name in ``DecoderStats``."""

    BAD_START = "bad_start"  # no start octet
    LE_MISMATCH = "le_mismatch"  # LE and its repetition differ
    LE_RANGE = "le_range"  # LE outside 4..249 (3 is accepted as an empty data unit)
    BAD_SECOND_SD = "bad_second_sd"  # no second SD2 behind LEr
    BAD_ED = "bad_ed"
    BAD_FCS = "bad_fcs"
    BAD_ADDRESS = "bad_address"  # SA 127, token to or from 127, extension bit where no extension can be
    BAD_EXTENSION = "bad_extension"  # extension octets missing, too many, or two of a kind
    BAD_FC = "bad_fc"  # bit 7 set in anything but a clock value request


def fcs(octets: bytes | bytearray) -> int:
    """Frame check sequence: the sum of ``octets`` (DA to the last data octet) without carry, 0..255."""
    return sum(octets) & 0xFF


# --- encoding --------------------------------------------------------------------------------------------------------
@lru_cache(_KEPT_HEADS)
def encode_sd1(da: int, sa: int, fc: int) -> bytes:
    """A telegram without data: DA 0..127, SA 0..126, FC 0..255. Raises ValueError."""
    if not (0 <= da <= BROADCAST and 0 <= sa <= UNADDRESSED and 0 <= fc <= 0xFF):
        raise _misuse(da, sa, fc)
    return bytes((_SD1, da, sa, fc, (da + sa + fc) & 0xFF, ED))


def encode_sd2(da: int, sa: int, fc: int, data: bytes = b"", dsap: int | None = None, ssap: int | None = None) -> bytes:
    """A telegram with data: ``data`` 0..246 octets less one for each SAP, which are 0..63 or None for absent.

    Raises ValueError; also without data and SAPs, because that telegram is an SD1.
    """
    head, check = _head(da, sa, fc, len(data), dsap, ssap)
    return head + data + _TAILS[(check + adler32(data)) & 0xFF]


@lru_cache(_KEPT_HEADS)
def _head(
    da: int, sa: int, fc: int, size: int, dsap: int | None, ssap: int | None, *segments: int | None
) -> tuple[bytes, int]:
    """The octets before the ``size`` octets of data, and their part of the FCS; cached.

    In data exchange only FCB, data and FCS change from one request to the next. ``segments``: DSEG and SSEG.
    """
    if not (0 <= da <= BROADCAST and 0 <= sa <= UNADDRESSED and 0 <= fc <= 0xFF):
        raise _misuse(da, sa, fc)
    dseg, sseg = segments or (None, None)
    destination, source = _extension(dsap, dseg), _extension(ssap, sseg)
    da |= _EXTENDED if destination else 0
    sa |= _EXTENDED if source else 0
    body = bytes((da, sa, fc)) + destination + source
    le = len(body) + size
    if le < MIN_LE:
        raise ValueError("an SD2 telegram without a data unit (LE = 3) is never sent: use SD1")
    if le > MAX_LE:
        raise ValueError(f"LE = {le}: the data unit has {le - 3} octets, {MAX_LE - 3} fit")
    return bytes((_SD2, le, le, _SD2)) + body, sum(body)


def _extension(sap: int | None, segment: int | None) -> bytes:
    """The extension octets of one address; the region/segment address stands before the SAP."""
    for name, value in (("SAP", sap), ("region/segment address", segment)):
        if value is not None and not 0 <= value <= _VALUE:
            raise ValueError(f"{name} {value}: must be 0..63")
    if segment is None:
        return b"" if sap is None else bytes((sap,))
    return bytes((_SEGMENT | segment,)) if sap is None else bytes((_MORE | _SEGMENT | segment, sap))


@lru_cache(_KEPT_HEADS)
def encode_token(da: int, sa: int) -> bytes:
    """The token from ``sa`` to ``da``, both 0..126. Raises ValueError."""
    if not (0 <= da <= UNADDRESSED and 0 <= sa <= UNADDRESSED):
        raise ValueError(f"token from {sa} to {da}: both addresses must be 0..{UNADDRESSED}")
    return bytes((_SD4, da, sa))


def request_octets(da: int, sa: int, fc: int, data: bytes, dsap: int | None, ssap: int | None) -> bytes:
    """The shortest telegram for a request or a response: SD1 without data and SAPs, else SD2."""
    if data or dsap is not None or ssap is not None:
        head, check = _head(da, sa, fc, len(data), dsap, ssap)
        return head + data + _TAILS[(check + adler32(data)) & 0xFF]
    return encode_sd1(da, sa, fc)


class KeptFrame:
    """A telegram with ``size`` octets of data and without SAPs that is sent again: only data and FCS change."""

    __slots__ = ("_check", "_head", "data", "octets", "size")

    def __init__(self, da: int, sa: int, fc: int, size: int) -> None:
        self.size = size
        self.data = bytes(size)
        self.octets = request_octets(da, sa, fc, self.data, None, None)
        self._head, self._check = _head(da, sa, fc, size, None, None) if size else (b"", 0)

    def encode(self, data: bytes) -> bytes:
        """The octets with ``data``, of which there are :attr:`size`, at least one."""
        self.data = data
        self.octets = octets = self._head + data + _TAILS[(self._check + adler32(data)) & 0xFF]
        return octets


def encode(telegram: Telegram) -> bytes:
    """Any telegram in octets. Raises ValueError on impossible values, SD3, and SD2 without a data unit."""
    da, sa, fc, data = telegram.da, telegram.sa, telegram.fc, telegram.data
    match telegram.kind:
        case Kind.SD1:
            if data or not telegram.dsap is telegram.ssap is telegram.dseg is telegram.sseg is None:
                raise ValueError("an SD1 telegram carries no data unit: use SD2")
            return encode_sd1(da, sa, fc)
        case Kind.SD2:
            head, check = _head(da, sa, fc, len(data), telegram.dsap, telegram.ssap, telegram.dseg, telegram.sseg)
            return head + data + _TAILS[(check + adler32(data)) & 0xFF]
        case Kind.SD4:
            return encode_token(da, sa)
        case Kind.SC:
            return SC_OCTETS
        case _:
            raise ValueError("SD3 telegrams are accepted but never sent: use SD2")


def _misuse(da: int, sa: int, fc: int) -> ValueError:
    return ValueError(f"DA {da}, SA {sa}, FC {fc}: must be 0..{BROADCAST}, 0..{UNADDRESSED} and 0..255")


# --- decoding --------------------------------------------------------------------------------------------------------
def decode(octets: bytes | bytearray, likely: PlainFrame | None = None) -> Telegram | None:
    """The one telegram that ``octets`` are from the first to the last, or None.

    ``likely``: probably its frame; the caller has compared the octets of its last telegram.
    """
    if type(octets) is not bytes:
        octets = bytes(octets)
    head = octets[:7]
    if likely is not None and head == likely.head:
        frame = likely
    else:
        known = _plain_frame(head)
        if known is None:
            return _decode_other(octets)
        last = known.last
        if octets == last[0]:  # inputs are often those of the last exchange
            return last[1]
        frame = known
    # as in _parse_sd2, but one comparison finds length, FCS and ED right, because the reason of a flaw is not wanted
    stop = frame.stop
    data = octets[7:stop]
    if octets[stop:] != _TAILS[(frame.check + adler32(data)) & 0xFF]:
        return None
    telegram = Telegram(_KIND_SD2, frame.da, frame.sa, frame.fc, None, None, data)
    frame.last = octets, telegram
    return telegram


def _decode_other(octets: bytes) -> Telegram | None:
    """:func:`decode` for all but the SD2 frames of :func:`_plain_frame`."""
    size = len(octets)
    telegram = parse(octets, 0, size) if size and claimed(octets, 0, size) == size else None
    return telegram if type(telegram) is Telegram else None


def claimed(octets: bytes | bytearray, at: int, end: int) -> int:
    """The number of octets that the frame at ``at`` claims to have; 1 when its first octet is no start octet.

    If LE and LEr differ, the longer one counts, as the farthest end of a damaged frame.
    """
    start = octets[at]
    if start == _SD2:
        if end - at < 2:
            return 2
        le = octets[at + 1]
        if end - at > 2 and octets[at + 2] > le:
            le = octets[at + 2]
        return min(max(le, EMPTY_LE), MAX_LE) + 6
    return _FIXED.get(start, 1)


_FIXED: Final = {_SD1: 6, _SD3: 14, _SD4: 3, _SC: 1}


def parse(octets: bytes | bytearray, at: int, end: int) -> Telegram | Flaw | None:
    """The telegram at ``octets[at]``, or the flaw, or None while ``end`` is before the end of the telegram.

    Needs ``at < end <= len(octets)``. A telegram's length is :func:`claimed`. Never raises.
    """
    if isinstance(octets, bytearray):
        return parse(bytes(octets[at : at + _LONGEST]), 0, min(end - at, _LONGEST))
    start = octets[at]
    if start == _SD2:
        return _parse_sd2(octets, at, end)
    if start == _SC:
        return SHORT_ACK
    if start == _SD1:
        return _parse_sd1(octets, at, end)
    if start == _SD4:
        return _parse_token(octets, at, end)
    if start == _SD3:
        return _parse_sd3(octets, at, end)
    return Flaw.BAD_START


def _parse_sd2(octets: bytes, at: int, end: int) -> Telegram | Flaw | None:
    if end - at < 9:
        return _short_sd2(octets, at, end)
    head = _read_head(octets[at : at + 7])
    if isinstance(head, Flaw):
        return head
    le, check, da, sa, fc, plain = head
    stop = at + 4 + le  # FCS
    if stop + 2 > end:
        return None
    if octets[stop + 1] != ED:
        return Flaw.BAD_ED
    data = octets[at + 7 : stop]
    if (check + sum(data)) & 0xFF != octets[stop]:
        return Flaw.BAD_FCS
    if plain:
        return Telegram(_KIND_SD2, da, sa, fc, None, None, data)
    return _content(_KIND_SD2, da, sa, fc, data)


#: LE; the sum of DA, SA and FC; these three; whether they are sound and no extension octets follow
_Head = tuple[int, int, int, int, int, bool]


@lru_cache(_KEPT_HEADS)
def _read_head(head: bytes) -> _Head | Flaw:
    """The first seven octets of an SD2 frame; cached, because in data exchange only the data change."""
    _, le, again, second, da, sa, fc = head
    if not EMPTY_LE <= le <= MAX_LE:
        return Flaw.LE_RANGE
    if again != le:
        return Flaw.LE_MISMATCH
    if second != _SD2:
        return Flaw.BAD_SECOND_SD
    return le, da + sa + fc, da, sa, fc, isinstance(_content(_KIND_SD2, da, sa, fc, b""), Telegram)


#: the telegram of a frame before its first one; compared by identity
_NO_TELEGRAM: Final = Telegram(Kind.SC, -1, -1)


class PlainFrame:
    """An SD2 frame without extension octets and with the LE ``le``: ``check`` is the sum of ``da``, ``sa`` and ``fc``,
    which are the last of the seven octets of ``head``.

    ``data_size``: the octets of its data, which end before octet ``stop``. ``last``: octets and telegram of the last
    frame with this head. All threads share this object, so the pair is one tuple: a reader takes it once, a writer
    replaces it.
    """

    __slots__ = ("check", "da", "data_size", "fc", "head", "last", "sa", "stop")

    def __init__(self, head: bytes, le: int, check: int, da: int, sa: int, fc: int) -> None:
        self.head = head
        self.stop = le + 4
        self.data_size = le - EMPTY_LE
        self.check = check
        self.da = da
        self.sa = sa
        self.fc = fc
        self.last: tuple[bytes | None, Telegram] = None, _NO_TELEGRAM


@lru_cache(_KEPT_HEADS)
def _plain_frame(head: bytes) -> PlainFrame | None:
    """The frame with the first seven octets ``head``. None for another kind, and if :func:`_read_head` finds a
    flaw."""
    if len(head) < 7 or head[0] != _SD2:
        return None
    found = _read_head(head)
    if isinstance(found, Flaw):
        return None
    le, check, da, sa, fc, plain = found
    return PlainFrame(head, le, check, da, sa, fc) if plain else None


#: stands for "no frame": the first seven octets of a telegram are never these eight
NO_FRAME: Final = PlainFrame(bytes(8), 0, 0, -1, -1, -1)


def plain_frame_of(telegram: Telegram) -> PlainFrame:
    """The kept frame of ``telegram``; :data:`NO_FRAME` for all but an SD2 with data and without extension octets."""
    if telegram.kind is not _KIND_SD2 or not telegram.data:
        return NO_FRAME
    if not telegram.dsap is telegram.ssap is telegram.dseg is telegram.sseg is None:
        return NO_FRAME
    head, _ = _head(telegram.da, telegram.sa, telegram.fc, len(telegram.data), None, None)
    return _plain_frame(head) or NO_FRAME


def _content(kind: Kind, da: int, sa: int, fc: int, body: bytes) -> Telegram | Flaw:
    """The telegram of a frame whose FCS is right. ``body``: its data unit with the address extension octets."""
    if fc > 0x7F and fc & 0xCF != 0xC0:
        return Flaw.BAD_FC
    if sa & 0x7F == BROADCAST:
        return Flaw.BAD_ADDRESS
    if da & sa & _EXTENDED and len(body) > 1 and body[0] <= _VALUE and body[1] <= _VALUE:
        # both SAPs, one octet each, as in DP services
        return Telegram(kind, da & 0x7F, sa & 0x7F, fc, body[0], body[1], body[2:])
    at = 0
    found: list[int | None] = []
    for address in (da, sa):
        sap = segment = None
        more = address & _EXTENDED
        while more:
            if at >= len(body):
                return Flaw.BAD_EXTENSION
            octet = body[at]
            at += 1
            more = octet & _MORE
            if octet & _SEGMENT:
                if segment is not None:
                    return Flaw.BAD_EXTENSION
                segment = octet & _VALUE
            else:
                if sap is not None:
                    return Flaw.BAD_EXTENSION
                sap = octet & _VALUE
        found += (sap, segment)
    dsap, dseg, ssap, sseg = found
    return Telegram(kind, da & 0x7F, sa & 0x7F, fc, dsap, ssap, body[at:], dseg, sseg)


def _short_sd2(octets: bytes, at: int, end: int) -> Flaw | None:
    """The flaw in the first octets of an SD2 frame that is shorter than the shortest, or None."""
    have = end - at
    if have < 3:
        return None  # an impossible LE, too: LEr decides how long the damaged frame may be (claimed)
    if not EMPTY_LE <= octets[at + 1] <= MAX_LE:
        return Flaw.LE_RANGE
    if octets[at + 2] != octets[at + 1]:
        return Flaw.LE_MISMATCH
    if have > 3 and octets[at + 3] != _SD2:
        return Flaw.BAD_SECOND_SD
    return None


def _parse_sd1(octets: bytes, at: int, end: int) -> Telegram | Flaw | None:
    have = end - at
    # without a data unit there is no room for extension octets
    if (have > 1 and octets[at + 1] > BROADCAST) or (have > 2 and octets[at + 2] > UNADDRESSED):
        return Flaw.BAD_ADDRESS
    if have < 6:
        return None
    da = octets[at + 1]
    sa = octets[at + 2]
    fc = octets[at + 3]
    if octets[at + 5] != ED:
        return Flaw.BAD_ED
    if (da + sa + fc) & 0xFF != octets[at + 4]:
        return Flaw.BAD_FCS
    if fc > 0x7F and fc & 0xCF != 0xC0:
        return Flaw.BAD_FC
    return Telegram(_KIND_SD1, da, sa, fc)


def _parse_token(octets: bytes, at: int, end: int) -> Telegram | Flaw | None:
    # only the addresses protect a token: both 0..126, no extension bit
    have = end - at
    if (have > 1 and octets[at + 1] > UNADDRESSED) or (have > 2 and octets[at + 2] > UNADDRESSED):
        return Flaw.BAD_ADDRESS
    if have < 3:
        return None
    return Telegram(_KIND_SD4, octets[at + 1], octets[at + 2])


def _parse_sd3(octets: bytes, at: int, end: int) -> Telegram | Flaw | None:
    if end - at < 14:
        return None
    if octets[at + 13] != ED:
        return Flaw.BAD_ED
    body = octets[at + 1 : at + 12]
    if sum(body) & 0xFF != octets[at + 12]:
        return Flaw.BAD_FCS
    return _content(_KIND_SD3, body[0], body[1], body[2], body[3:])
