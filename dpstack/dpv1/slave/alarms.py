"""Alarms and status messages of a slave: raised by its application, shown in the diagnosis, alarms acknowledged.

The diagnosis holds one alarm at a time and one status message beside it. Each stays until the slave's own master has
fetched it; then the next takes its place. An alarm is over when it is acknowledged.

Facts: docs/reference/protocol.md#alarms. Decisions on points that the sources leave open:
docs/reference/decisions/alarms.md#alarms-at-the-slave.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from enum import Enum
from typing import Final, NamedTuple

from msgspec import Struct
from msgspec.structs import replace

from dpstack.dp.pdu.alarm_blocks import SEQUENCES, VENDOR, Alarm, Status, StatusType, kind_of
from dpstack.dp.pdu.dpv1_status import ALARM_LIMITS, ALARMS, check_alarm_kinds
from dpstack.dpv1.pdu.error_codes import Code
from dpstack.dpv1.pdu.read_write import AlarmAck, Function, Negative
from dpstack.errors import AlarmError, ConfigError, PduError, UsageError

#: alarms, and status messages, that wait to be shown
MAX_WAITING: Final = 32


class AlarmSupport(Struct, frozen=True):
    """The alarms of a slave: ``kinds``, keys of :data:`~dpstack.dp.pdu.dpv1_status.ALARMS` [Diagnostic_Alarm_supp ...].

    ``sequence``: in sequence mode so many at a time, 2..32, or 0 if it has type mode only
    [Alarm_Sequence_Mode_Count]; ``extra_sap``: Alarm_Ack comes over SAP 50 too [Extra_Alarm_SAP_supp].
    Raises ConfigError.
    """

    kinds: frozenset[str] = frozenset()
    sequence: int = 0
    extra_sap: bool = False

    def __post_init__(self) -> None:
        check_alarm_kinds(sorted(self.kinds))
        if self.sequence != 0 and not 2 <= self.sequence <= SEQUENCES:
            raise ConfigError(f"{self.sequence} alarms at a time: 2..{SEQUENCES}, or 0 without sequence mode")


class AlarmEnd(Enum):
    ACKNOWLEDGED = "acknowledged"
    LEFT = "data exchange ended before it was acknowledged"
    WITHDRAWN = "withdrawn before it was shown"


class Raised:
    """An alarm that was raised. ``end`` is None until it is over; ``ended`` is called then, and must not raise."""

    def __init__(self, alarm: Alarm) -> None:
        #: with its sequence number, from when it is shown
        self.alarm = alarm
        self.end: AlarmEnd | None = None
        self.ended: Callable[[], object] | None = None
        #: True once an answer to a master contained the alarm
        self.offered = False

    def finish(self, end: AlarmEnd) -> None:
        self.end = end
        if self.ended is not None:
            self.ended()


class Shown(NamedTuple):
    """The alarm and the status message in one diagnosis."""

    alarm: Raised | None
    status: Status | None
    octets: bytes


class Acknowledged(NamedTuple):
    """The result of an Alarm_Ack: its answer, the alarm that is over with it, the reason of a negative answer."""

    answer: AlarmAck | Negative
    alarm: Alarm | None = None
    reason: str | None = None


_NOTHING: Final = Shown(None, None, b"")
_Key = tuple[int, int, int]


class AlarmServer:
    """The alarms of one slave. ``room``: octets of the diagnosis after the fixed ones, at least 4."""

    def __init__(self, support: AlarmSupport, room: int, name: str = "slave") -> None:
        self.support = support
        self._room = room
        self._name = name
        self._enabled = frozenset[str]()
        #: this many at a time in sequence mode, 0: type mode
        self.limit = 0
        self._waiting: deque[Raised] = deque()
        self._statuses: deque[Status] = deque()
        self._on_its_way: dict[_Key, Raised] = {}
        self._acknowledged: deque[_Key] = deque(maxlen=SEQUENCES - 1)
        self._last_status: Status | None = None  # fetched with the last diagnosis
        self._current: Raised | None = None  # stands in the diagnosis; with _fetched the master has it
        self._offered = _NOTHING  # in an answer that the master may not have received
        self.close()

    # --- the application ----------------------------------------------------------------------------------------

    def alarm(self, alarm: Alarm) -> Raised:
        """Raise ``alarm``; its sequence number is given here. Raises AlarmError if it cannot go out now, PduError
        if it cannot be."""
        self._check_room(alarm.build())
        kind = kind_of(alarm.type)
        what = f"slave {self._name}: {alarm.text}"
        if kind not in self.support.kinds:
            raise AlarmError(f"{what}: this slave has no {kind} alarms; name them in its description", "not supported")
        self._check_open(what)
        if kind not in self._enabled:
            todo = f'add "{kind}" to alarms of [slave.dpv1] there'
            raise AlarmError(f"{what}: its master did not enable {kind} alarms in Set_Prm; {todo}", "not enabled")
        if len(self._waiting) >= MAX_WAITING:
            raise AlarmError(
                f"{what}: {MAX_WAITING} alarms wait already; its master does not acknowledge them", "queue full"
            )
        raised = Raised(alarm)
        self._waiting.append(raised)
        self._advance()
        return raised

    def withdraw(self, raised: Raised) -> None:
        """Remove an alarm that the application no longer waits for, unless an answer to a master contained it."""
        if raised in self._waiting:
            self._waiting.remove(raised)
            raised.finish(AlarmEnd.WITHDRAWN)
        elif raised is self._current and not raised.offered:
            self._current, self._fetched = None, True
            del self._on_its_way[_key(raised.alarm)]
            raised.finish(AlarmEnd.WITHDRAWN)
            self._advance()

    def status(self, status: Status) -> None:
        """Send a status once. Raises AlarmError if it cannot go out now, PduError if it cannot be."""
        if status.type not in VENDOR and status.type not in StatusType.__members__.values():
            raise PduError(f"there is no status of type {status.type:d}: 1..3, 30, 31, 32..126")
        self._check_room(status.build())
        what = f"slave {self._name}: {status.text}"
        self._check_open(what)
        if len(self._statuses) >= MAX_WAITING:
            raise AlarmError(f"{what}: {MAX_WAITING} wait already; its master does not fetch them", "queue full")
        self._statuses.append(status)

    @property
    def pending(self) -> tuple[Raised, ...]:
        """The alarms that are not over: those on their way, then those that wait."""
        return (*self._on_its_way.values(), *self._waiting)

    # --- the slave application ----------------------------------------------------------------------------------

    def agree(self, status_2: int, status_3: int) -> None:
        """DPV1_Status_2 and 3 of Set_Prm: what is enabled, and how many at a time
        (docs/reference/protocol.md#dpv1_status)."""
        self._enabled = frozenset(kind for kind, bit in ALARMS.items() if status_2 & bit)
        self.limit = min(ALARM_LIMITS[status_3 & 7], self.support.sequence)

    def open(self) -> None:
        """Data exchange begins, with DPV1_Enable."""
        self.close()
        self._is_open = True

    def close(self) -> None:
        """Data exchange ends: no alarm is possible, those that are not acknowledged are over."""
        over = self.pending
        self._is_open = self._started = False
        self._waiting.clear()
        self._statuses.clear()
        self._on_its_way.clear()
        self._acknowledged.clear()
        self._last_status = None
        self._current, self._fetched = None, True
        self._sequence = 0
        for raised in over:
            raised.finish(AlarmEnd.LEFT)

    def must_fetch(self) -> bool:
        """A Data_Exchange is answered: whether the master must fetch a diagnosis."""
        if not self._is_open:
            return False
        self._started = True
        return not self._fetched or bool(self._statuses)

    def _shown(self) -> Shown:
        """The alarm and the status message in the diagnosis now."""
        if not self._started:
            return _NOTHING
        alarm = self._current
        status = self._statuses[0] if self._statuses and self._statuses[0] != self._last_status else None
        alarm_octets = b"" if alarm is None else alarm.alarm.build()
        status_octets = b"" if status is None else status.build()
        if len(alarm_octets) + len(status_octets) > self._room:
            if self._fetched:
                return Shown(None, status, status_octets)
            return Shown(alarm, None, alarm_octets)
        return Shown(alarm, status, alarm_octets + status_octets)

    def octets(self) -> bytes:
        """The blocks in the diagnosis."""
        return self._shown().octets

    def offered(self) -> None:
        """An answer to the master holds them; whether it arrived is not known yet."""
        self._offered = self._shown()
        if self._offered.alarm is not None:
            self._offered.alarm.offered = True

    def fetched(self) -> None:
        """The master has what was offered last."""
        shown = self._offered
        if shown.alarm is not None and shown.alarm is self._current:
            self._fetched = True
        if shown.status is not None and self._statuses and self._statuses[0] is shown.status:
            self._statuses.popleft()
        self._last_status = shown.status
        self._advance()

    def acknowledge(self, octets: bytes) -> Acknowledged:
        """Alarm_Ack."""
        try:
            ack = AlarmAck.parse(octets)
        except PduError as error:
            return Acknowledged(Negative(Function.ALARM_ACK, Code.INVALID_PARAMETER), reason=str(error))
        key = (ack.slot, ack.type, ack.sequence)
        raised = self._on_its_way.get(key)
        if raised is None or not raised.offered:
            if key in self._acknowledged:
                return Acknowledged(ack)
            what = f"type {ack.type:d}, slot {ack.slot}, sequence number {ack.sequence}"
            reason = f"no alarm of {what} is on its way"
            return Acknowledged(Negative(Function.ALARM_ACK, Code.INVALID_PARAMETER), reason=reason)
        del self._on_its_way[key]
        self._acknowledged.append(key)
        if raised is self._current:
            self._current, self._fetched = None, True
        raised.finish(AlarmEnd.ACKNOWLEDGED)
        self._advance()
        return Acknowledged(ack, raised.alarm)

    # --- inside -------------------------------------------------------------------------------------------------

    def _advance(self) -> None:
        """Show the next alarm, when the one before was fetched and the mode lets it."""
        if not self._fetched or not self._waiting:
            return
        raised = self._next()
        if raised is None:
            return
        self._waiting.remove(raised)
        used = {sequence for _, _, sequence in self._on_its_way}
        while self._sequence in used:
            self._sequence = (self._sequence + 1) % SEQUENCES
        raised.alarm = replace(raised.alarm, sequence=self._sequence)
        self._sequence = (self._sequence + 1) % SEQUENCES
        self._on_its_way[_key(raised.alarm)] = raised
        self._current, self._fetched = raised, False

    def _next(self) -> Raised | None:
        if self.limit:
            return self._waiting[0] if len(self._on_its_way) < self.limit else None
        busy = {_class(raised.alarm.type) for raised in self._on_its_way.values()}
        return next((raised for raised in self._waiting if _class(raised.alarm.type) not in busy), None)

    def _check_open(self, what: str) -> None:
        if not self._is_open:
            raise AlarmError(
                f"{what}: it is not in data exchange with a master that set DPV1_Enable", "not in data exchange"
            )

    def _check_room(self, octets: bytes) -> None:
        if len(octets) > self._room:
            raise UsageError(
                f"slave {self._name}: a block of {len(octets)} octets, its diagnosis has room for {self._room} "
                f"(Max_Diag_Data_Len); give fewer octets of data"
            )


def _key(alarm: Alarm) -> _Key:
    return alarm.slot, alarm.type, alarm.sequence


def _class(alarm_type: int) -> int:
    """The class of which type mode allows one alarm at a time: a type of the standard, or all vendor types."""
    return VENDOR.start if alarm_type in VENDOR else alarm_type
