"""Values with quality, reason and source time; values of the stream by type."""

from __future__ import annotations

import math
import sys
from enum import Enum, StrEnum, unique
from typing import Final, NamedTuple

from dpstack.text import printable, shortened

#: characters of a text that a node holds
MOST_TEXT: Final = 1024
#: the greatest number of four octets (IEEE 754); a connector could not encode a greater one
_MOST_F32: Final = (2 - 2**-23) * 2.0**127
#: octets of a value: more than a slave has
MOST_OCTETS: Final = 244
#: the value of a node; None without one
Value = bool | int | float | str | bytes | None

#: 10.3 - 10.1 is 0.20000000000000107 for a float: a step as large as the dead band lies in it
_EDGE: Final = 1 + 1e-9

BOOL, TEXT, BYTES, FLOAT, COUNT = "bool", "text", "bytes", "f64", "u64"
#: limits of the whole numbers by type
LIMITS: Final[dict[str, tuple[int, int]]] = {
    **{f"u{bits}": (0, (1 << bits) - 1) for bits in (8, 16, 32, 64)},
    **{f"i{bits}": (-1 << (bits - 1), (1 << (bits - 1)) - 1) for bits in (8, 16, 32, 64)},
}
TYPES: Final = frozenset({BOOL, TEXT, BYTES, "f32", FLOAT, *LIMITS})


@unique
class Quality(StrEnum):
    """Quality of a value."""

    GOOD = "good"
    #: it is of this moment, and something is known that may make it wrong
    UNCERTAIN = "uncertain"
    #: it was good once, and is old
    STALE = "stale"
    #: it is wrong, or no value exists
    BAD = "bad"

    @property
    def sparkplug(self) -> int:
        """The number of Sparkplug B 3.0 (6.4.7, property ``Quality``), which has one for old and doubtful values."""
        return {Quality.GOOD: 192, Quality.BAD: 0}.get(self, 500)

    @property
    def rank(self) -> int:
        """0 good, 1 uncertain, 2 stale, 3 bad: of several the worst counts."""
        return _RANKS[self]


_RANKS: Final = {one: rank for rank, one in enumerate(Quality)}

#: the word for a number that has none
NO_MEANING: Final = "no meaning"


@unique
class Reason(Enum):
    """Reason of a quality: text for people, quality, status code of OPC UA (Part 4, 7.39; Part 8, 6.3.2).

    The names from ANNOUNCED on are those of :class:`dpstack.dp.doubts.DoubtKind`; words come with the note.
    """

    GOOD = "", Quality.GOOD, 0x0000_0000
    #: no value yet, or none since the bus began (BadWaitingForInitialData)
    WAITING = "no value yet", Quality.BAD, 0x8032_0000
    #: not a number, too few octets, or of another type (Bad)
    NO_VALUE = "there is no valid value", Quality.BAD, 0x8000_0000
    #: for instance a quantity that the telegram of a drive does not carry (BadNotSupported)
    NOT_THERE = "this slave or bus does not give this value", Quality.BAD, 0x803D_0000
    #: UncertainNoCommunicationLastUsableValue
    NOT_EXCHANGING = "the slave is not in data exchange", Quality.STALE, 0x408F_0000
    #: UncertainLastUsableValue
    NOT_VALID = "the inputs of the slave are not valid", Quality.STALE, 0x4090_0000
    TOO_OLD = "the inputs are older than the watchdog of the slave", Quality.STALE, 0x4090_0000
    DRIVE_OFFLINE = "the drive gives no status", Quality.STALE, 0x4090_0000
    #: UncertainNoCommunicationLastUsableValue
    BUS_STALE = "the bus does not run, or its counters are old", Quality.STALE, 0x408F_0000
    NOT_SENT = "the live stream does not show this slave any more", Quality.STALE, 0x408F_0000
    STREAM_SILENT = "the live stream of the bus has stopped", Quality.STALE, 0x408F_0000
    STREAM_LATE = "the live stream of the bus arrives late", Quality.STALE, 0x408F_0000
    SEARCHING = "the bus searches its baud rate", Quality.STALE, 0x408F_0000
    ENDED = "the bus has ended", Quality.STALE, 0x408F_0000
    #: for instance its process was killed
    FAILED = "a fault has ended the bus", Quality.STALE, 0x408F_0000
    # --- by the diagnosis of the slave
    #: Uncertain
    ANNOUNCED = "diagnosis announced", Quality.UNCERTAIN, 0x4000_0000
    #: BadSensorFailure
    CHANNEL_FAULT = "channel fault", Quality.BAD, 0x808C_0000
    #: UncertainEngineeringUnitsExceeded
    CHANNEL_LIMIT = "limit exceeded", Quality.UNCERTAIN, 0x4094_0000
    #: UncertainSubNormal
    SLOT_FAULT = "diagnosis of the slot", Quality.UNCERTAIN, 0x4095_0000
    #: BadDeviceFailure
    SLOT_INVALID = "data of the slot invalid", Quality.BAD, 0x808B_0000
    #: BadConfigurationError
    SLOT_WRONG = "wrong module", Quality.BAD, 0x8089_0000
    #: BadNotConnected
    SLOT_MISSING = "no module", Quality.BAD, 0x808A_0000
    #: Uncertain
    SLAVE_FAULT = "diagnosis of the slave", Quality.UNCERTAIN, 0x4000_0000
    UNLISTED = "more diagnosis than fits", Quality.UNCERTAIN, 0x4000_0000
    #: BadOutOfService
    NO_VALID_DATA = "the slave has no valid data", Quality.BAD, 0x808D_0000
    #: BadDeviceFailure
    DEVICE_FAULT = "fault of the device", Quality.BAD, 0x808B_0000
    # --- by the value itself (Bad), and by a status octet beside it
    NOT_A_NUMBER = "not a number (NaN or infinite)", Quality.BAD, 0x8000_0000
    STATUS_BAD = "bad", Quality.BAD, 0x8000_0000
    STATUS_CONFIGURATION = "configuration error", Quality.BAD, 0x8089_0000
    STATUS_NOT_CONNECTED = "not connected", Quality.BAD, 0x808A_0000
    STATUS_DEVICE_FAILURE = "device failure", Quality.BAD, 0x808B_0000
    STATUS_SENSOR_FAILURE = "sensor failure", Quality.BAD, 0x808C_0000
    STATUS_NO_COMMUNICATION = "no communication", Quality.BAD, 0x8031_0000
    STATUS_OUT_OF_SERVICE = "out of service", Quality.BAD, 0x808D_0000
    STATUS_UNCERTAIN = "uncertain", Quality.UNCERTAIN, 0x4000_0000
    STATUS_LAST_USABLE = "last usable value", Quality.UNCERTAIN, 0x4090_0000
    STATUS_SUBSTITUTE = "substitute value", Quality.UNCERTAIN, 0x4091_0000
    STATUS_INITIAL = "initial value", Quality.UNCERTAIN, 0x4092_0000
    STATUS_NOT_ACCURATE = "sensor conversion not accurate", Quality.UNCERTAIN, 0x4093_0000
    STATUS_RANGE = "range of the unit exceeded", Quality.UNCERTAIN, 0x4094_0000
    STATUS_SUBNORMAL = "subnormal", Quality.UNCERTAIN, 0x4095_0000
    #: good with something to report
    STATUS_GOOD = "good", Quality.GOOD, 0x0000_0000

    def __init__(self, text: str, quality: Quality, status: int) -> None:
        self.text = text
        self.quality = quality
        self.opcua_status = status

    @property
    def is_by_slave(self) -> bool:
        """Whether the slave itself throws doubt on the value, in words of its own: the number is still the one that it
        sends."""
        return self in _BY_SLAVE

    def with_note(self, note: str) -> str:
        """The reason and further facts in one line. The note of a diagnosis has words of its own."""
        if self.is_by_slave or not note:
            return note or self.text
        return f"{self.text}: {note}"


_BY_SLAVE: Final = frozenset(list(Reason)[list(Reason).index(Reason.ANNOUNCED) :])
#: BadNoCommunication: there is not even an old value
_NO_COMMUNICATION: Final = 0x8031_0000


class Reading(NamedTuple):
    """Value of a node. ``value``: the last good one while the quality is stale; of a bad one the number that the slave
    sends, or None without any. Readers that see no quality beside it get :attr:`plain`.

    ``time``: source time of ``value`` in s since 1970 by the clock of the stream; 0 before the first. ``note``: further
    facts about the reason, printable.
    """

    value: Value = None
    reason: Reason = Reason.WAITING
    time: float = 0.0
    note: str = ""

    @property
    def quality(self) -> Quality:
        return Quality.BAD if self.value is None else self.reason.quality

    @property
    def plain(self) -> Value:
        """The value for a reader who sees no quality beside it: None while it is bad."""
        return None if self.quality is Quality.BAD else self.value

    @property
    def has_remark(self) -> bool:
        """Whether there is something to say besides the value: it is not good, or good with a remark."""
        return self.reason is not Reason.GOOD or self.value is None

    @property
    def opcua_status(self) -> int:
        """The status code of OPC UA."""
        if self.value is None and self.reason.quality is Quality.STALE:
            return _NO_COMMUNICATION
        return self.reason.opcua_status

    @property
    def text(self) -> str:
        """The reason in one line; empty for a good value."""
        return self.reason.with_note(self.note)


def base_type(declared: str) -> str:
    """The type of the values of a field that is declared as ``declared``: ``u31`` and ``u32ws`` give u32, ``i16le``
    i16."""
    base = declared.partition("@")[0].removesuffix("le").removesuffix("ws")
    bits = base[1:]
    if base in TYPES or base[:1] not in ("u", "i") or not bits.isdecimal() or len(bits) > 2:
        return base
    return next((f"{base[0]}{size}" for size in (8, 16, 32, 64) if int(bits) <= size), base)


def clean(text: object) -> str:
    """``text`` for people, short and without control characters; empty if it is no text."""
    return shortened(printable(text[: MOST_TEXT + 1]), MOST_TEXT) if isinstance(text, str) else ""


def value_of(given: object, type_: str) -> Value:
    """``given``, of an item of the stream or of an order, as a value of ``type_``; None if it is no such value. Octets
    are given as they are, or as hex."""
    if type_ == BOOL:
        return given if isinstance(given, bool) else None
    if type_ == TEXT:
        return clean(given) if isinstance(given, str) else None
    if type_ == BYTES:
        return _octets(given)
    if isinstance(given, bool) or not isinstance(given, (int, float)):
        return None
    if type_ in LIMITS:
        low, high = LIMITS[type_]
        whole = isinstance(given, int) or given.is_integer()
        return int(given) if whole and low <= given <= high else None
    try:
        number = float(given)
    except OverflowError:
        return None
    most = _MOST_F32 if type_ == "f32" else sys.float_info.max
    return number if abs(number) <= most else None


def _octets(given: object) -> bytes | None:
    if isinstance(given, bytes):
        return given if len(given) <= MOST_OCTETS else None
    if not isinstance(given, str) or len(given) > 2 * MOST_OCTETS:
        return None
    try:
        return bytes.fromhex(given)
    except ValueError:
        return None


def is_news(before: Value, now: Value, band: float) -> bool:
    """Whether ``now`` is another value than ``before``; of numbers one that is more than ``band`` away."""
    if before == now:
        return False
    if band and isinstance(before, (int, float)) and isinstance(now, (int, float)):
        return not abs(now - before) <= band * _EDGE and not (math.isnan(now) and math.isnan(before))
    return not (isinstance(before, float) and isinstance(now, float) and math.isnan(before) and math.isnan(now))
