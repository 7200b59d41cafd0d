"""Alarms at a class 1 master: recognised in the diagnoses of a slave, delivered once, acknowledged by Alarm_Ack.

An alarm is open from the diagnosis that brings it until the slave takes its acknowledgement. Alarm_Ack goes to SAP 51
between Read and Write, or to SAP 50 with Extra_Alarm_SAP. Facts: docs/reference/protocol.md#alarms,
docs/reference/protocol.md#alarm_ack. Decisions on points that the sources leave open:
docs/reference/decisions/alarms.md#alarms-at-the-master.

Acknowledged alarms that are in the diagnosis again: still the old alarm, or a new one with equal octets?

Slaves differ. The rules: docs/reference/decisions/alarms.md#the-same-alarm-again.
"""

from __future__ import annotations

from enum import Enum
from typing import Final

from msgspec import Struct, field, structs

from dpstack.dp.acyclic.job import ACKS, Outcome, ServiceFailure
from dpstack.dp.acyclic.queue import Provider
from dpstack.dp.doubts import standing_after
from dpstack.dp.master.slave_handler import SlaveHandler
from dpstack.dp.master.slave_reports import NO_ALARMS, AlarmCounts, DiagObserver
from dpstack.dp.pdu.alarm_blocks import HEAD, Alarm, Status, alarm_name, kind_of, parse_block
from dpstack.dp.pdu.diag_blocks import DeviceBlock
from dpstack.dp.pdu.diag_texts import first_slot_of
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.pdu.dpv1_status import ALARM_LIMITS, ALARM_MODE, ALARMS
from dpstack.dpv1.master.alarm_orders import (
    AcknowledgeAlarm,
    AlarmDone,
    AlarmRaised,
    HoldAlarms,
    StatusTold,
    texts_beside,
)
from dpstack.dpv1.master.ms1 import Ms1, Ms1Job
from dpstack.dpv1.master.srd_polling import negative_outcome, unreadable_outcome
from dpstack.dpv1.pdu.error_codes import AGAIN
from dpstack.dpv1.pdu.read_write import AlarmAck, Function, Negative, parse_response
from dpstack.errors import PduError
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import SAP_MS1, SAP_MS1_ALARM, Telegram
from dpstack.trace import Event
from dpstack.units import NEVER, NS_PER_MS

#: time in which a slave takes an acknowledged alarm out of its diagnosis
SETTLE: Final = 100 * NS_PER_MS


class Key(Struct, frozen=True):
    """The identity of an open alarm."""

    type: int
    slot: int
    sequence: int

    @classmethod
    def of(cls, alarm: Alarm) -> Key:
        return cls(alarm.type, alarm.slot, alarm.sequence)


class Asked(Struct, frozen=True):
    """The slave asked for ``diagnosis``, which holds ``alarm``; ``octets``: its block."""

    alarm: Alarm
    octets: bytes
    diagnosis: Diagnosis


class _Settled(Struct):
    """An acknowledged alarm that every diagnosis since has held."""

    octets: bytes
    until: int
    #: delivered although its block was equal to the last one
    again: bool
    #: the slave has asked for a diagnosis since then
    asked: Asked | None = None


class Settling:
    """The acknowledged alarms of one slave; ``in_order``: its Alarm_Mode is a sequence mode."""

    def __init__(self, in_order: bool) -> None:
        self._settled: dict[Key, _Settled] = {}
        self._counting = in_order
        self._keeps = False
        #: time to read the diagnosis again
        self.look_at: int = NEVER

    def raised(self, alarm: Alarm) -> None:
        self._counting = self._counting or alarm.sequence > 0
        self._settled.pop(Key.of(alarm), None)

    def over(self, key: Key, octets: bytes, again: bool, now: int) -> None:
        """The slave took its acknowledgement; ``again``: :meth:`doubtful` was true of it."""
        self._settled[key] = _Settled(octets, now + SETTLE, again)

    def displaced(self, keys: set[Key]) -> list[Asked]:
        """Drop the alarms that are no longer in the diagnosis, which holds ``keys``. Returns those of them that were
        new alarms after all."""
        gone = [self._settled.pop(key).asked for key in [key for key in self._settled if key not in keys]]
        return [asked for asked in gone if asked is not None and keys]

    def still(self, alarm: Alarm, octets: bytes, diagnosis: Diagnosis, flagged: bool, now: int) -> bool:
        """True if ``alarm`` is the acknowledged one, still there. ``flagged``: the slave asked for this diagnosis."""
        settled = self._settled.get(Key.of(alarm))
        if settled is None or settled.octets != octets:
            return False
        if self._counting:
            return True
        if flagged:
            settled.asked = Asked(alarm, octets, diagnosis)
        if now < settled.until:
            self.look_at = min(self.look_at, settled.until)
            return True
        if settled.asked is not None:
            return False
        self._keeps = self._keeps or settled.again
        return self._keeps

    def doubtful(self, key: Key, octets: bytes) -> bool:
        """True if nothing but :meth:`still` distinguishes a new alarm from the acknowledged one."""
        settled = self._settled.get(key)
        return settled is not None and settled.octets == octets and settled.asked is None

    def clear(self) -> None:
        self._settled.clear()
        self.look_at = NEVER


#: limit of the alarms of one slave that are open, or not yet taken by the application; by the rules there are up to 32
MAX_OPEN: Final = 64
#: pauses before the first, the second ... repetition of an acknowledgement
_AGAIN: Final = (100 * NS_PER_MS, 200 * NS_PER_MS, 500 * NS_PER_MS, 1000 * NS_PER_MS)
_NO: Final = (ServiceFailure.NEGATIVE, ServiceFailure.REFUSED, ServiceFailure.LENGTH, ServiceFailure.GUARDED)
_MALFORMED: Final = "its diagnosis holds a device block that is neither alarm nor status ({why}): {octets}"
_NOT_ENABLED: Final = (
    "its diagnosis holds a {what}, a kind that Set_Prm did not enable: neither delivered nor acknowledged; where it "
    'raises them put "{kind}" into dpv1 = {{ alarms = [...] }}'
)
_NO_EXTRA_SAP: Final = (
    "SAP 50 is closed, though it says Extra_Alarm_SAP: its alarms are acknowledged at SAP 51 (extra_alarm_sap = false)"
)
_REFUSED: Final = "{why}; the alarm was delivered, but the slave may wait for ever"


class Stage(Enum):
    """The stage of an open alarm."""

    HELD = "held"  # waits for the application
    WAITING = "waiting"  # waits for its acknowledgement
    ASKED = "asked"  # its acknowledgement is under way


class OpenAlarm(Struct, eq=False):
    """An alarm without an acknowledgement; ``octets``: its block in the diagnosis."""

    number: int
    alarm: Alarm
    octets: bytes
    stage: Stage
    #: its block and the last one are equal: it may be the last one, still in the diagnosis
    doubtful: bool = False
    #: acknowledgements begun
    attempts: int = 0
    #: an acknowledgement had no answer
    unanswered: bool = False
    not_before: int = 0
    #: the diagnosis may hold another alarm with the same numbers: read it again when this one is over
    shown: bool = False
    #: the response came after the acknowledgement's job had ended
    answered: bool = False

    @property
    def maybe_taken(self) -> bool:
        """The slave may have received its acknowledgement."""
        return self.unanswered or self.stage is Stage.ASKED


class AlarmBook(Struct):
    """The state of a slave's alarms that outlasts its parameters, also while DP-V1 is off.

    ``hold``: the application acknowledges (:class:`~dpstack.dpv1.master.alarm_orders.HoldAlarms`); ``number`` of the
    last alarm; ``untaken``: numbers of alarms that are void, but that the application has not taken yet.
    """

    counts: AlarmCounts = field(default_factory=AlarmCounts)
    number: int = 0
    hold: bool = False
    untaken: set[int] = field(default_factory=set)

    def count(self, name: str) -> None:
        self.counts = structs.replace(self.counts, **{name: getattr(self.counts, name) + 1})


class AlarmHandler(DiagObserver):
    """The alarms of the slave that ``handler`` handles, under one set of parameters; ``book`` outlasts them."""

    def __init__(self, handler: SlaveHandler, book: AlarmBook) -> None:
        self.handler = handler
        setup = self._setup = handler.setup
        sent = setup.user_octets(None)
        self._enabled = sent[1]
        #: alarms at a time; 0: one of each type
        self._limit = ALARM_LIMITS[sent[2] & ALARM_MODE]
        self._has_extra_sap = setup.dpv1 is not None and setup.dpv1.extra_alarm_sap
        #: SAP 50 takes the acknowledgements, not SAP 51
        self.extra_sap = self._has_extra_sap
        self._extra_sap_took = False
        self._reports = handler.reports
        self._want_diagnosis = handler.want_diagnosis
        self._book = book
        self._open: dict[Key, OpenAlarm] = {}
        self._asked: OpenAlarm | None = None
        self._settling = Settling(in_order=self._limit > 0)
        self._dropped = False
        self._silence_reported = False
        self._last: Diagnosis | None = None
        #: blocks of the last diagnosis: they bring no new alarm
        self._before: set[bytes] = set()
        #: exchanges at the last diagnosis; after a later request without an answer the slave may offer it again
        self._read_after = 0
        self._unsure = False
        self._statuses: dict[tuple[int, int], bytes] = {}
        self._standing: tuple[Alarm, ...] = ()

    # --- from the diagnosis -------------------------------------------------------------------------------------

    def opened(self, last: Diagnosis | None, now: int) -> None:
        """Data exchange begins: status messages in the last diagnosis before it count, alarms in it are read again."""
        for message, octets in self._messages(last, now):
            if isinstance(message, Status):
                self._on_status(message, octets, now)
            else:
                self._want_diagnosis(now)

    def read(self, diagnosis: Diagnosis, flagged_at: int, exchanges: int, now: int) -> None:
        """A diagnosis of the slave in data exchange, after so many ``exchanges``; ``flagged_at``: the first of them in
        which it asked for it (DH), 0: it did not."""
        last, self._last = self._last, diagnosis
        flagged = flagged_at > 0
        renewed = flagged and diagnosis == last
        if self._unsure and renewed and flagged_at == self._read_after + 1:  # offered again
            flagged = renewed = False
        before = () if last is None or renewed else last.blocks
        self._read_after, self._unsure = exchanges, False
        self._before = {block.octets for block in before}
        messages = self._messages(diagnosis, now)
        statuses = {}
        standing = {Key.of(message) for message, _ in messages if isinstance(message, Alarm)}
        for displaced in self._settling.displaced(standing):
            self._new(displaced.alarm, displaced.octets, displaced.diagnosis, doubtful=False, now=now)
        for message, octets in messages:
            if isinstance(message, Alarm):
                self._on_alarm(message, octets, diagnosis, flagged, now)
            else:
                self._on_status(message, octets, now)
                statuses[message.type, message.slot] = octets
        self._statuses = statuses

    def _messages(self, diagnosis: Diagnosis | None, now: int) -> list[tuple[Alarm | Status, bytes]]:
        found: list[tuple[Alarm | Status, bytes]] = []
        for block in () if diagnosis is None else diagnosis.blocks:
            if isinstance(block, DeviceBlock):
                try:
                    found.append((parse_block(block.octets), block.octets))
                except PduError as error:
                    if not self._book.counts.malformed:
                        self._reports.remark(_MALFORMED.format(why=error, octets=block.octets.hex(" ")), now)
                    self._count("malformed")
        return found

    def _on_status(self, status: Status, octets: bytes, now: int) -> None:
        if self._statuses.get((status.type, status.slot)) != octets:
            self._statuses[status.type, status.slot] = octets
            self._count("statuses")
            first = first_slot_of(self._setup.texts)
            self._reports.event(StatusTold, now, status=status, first_slot=first)

    def _on_alarm(self, alarm: Alarm, octets: bytes, diagnosis: Diagnosis, flagged: bool, now: int) -> None:
        kind = kind_of(alarm.type)
        if not self._enabled & ALARMS[kind]:
            self._count("not_enabled")
            self._reports.remark(_NOT_ENABLED.format(what=alarm_name(alarm.type), kind=kind), now)
            return
        key = Key.of(alarm)
        self._standing = standing_after(self._standing, alarm)
        self._conclude(alarm, octets, now)
        known = self._open.get(key)
        fresh = octets not in self._before
        if known is not None:
            if not (fresh and known.maybe_taken):
                if fresh and known.octets != octets:  # it replaces an alarm without acknowledgement
                    self._too_many(now)
                known.shown = known.shown or known.maybe_taken or known.octets != octets
                return
            self._over(known, Outcome(), now)
        if fresh or not self._settling.still(alarm, octets, diagnosis, flagged, now):
            doubtful = not fresh and self._settling.doubtful(key, octets)
            self._new(alarm, octets, diagnosis, doubtful=doubtful, now=now)

    def _conclude(self, alarm: Alarm, octets: bytes, now: int) -> None:
        """``alarm`` replaces others whose acknowledgement had no answer: the slave has taken it."""
        for known in tuple(self._open.values()):
            alike = not self._limit and known.alarm.type == alarm.type
            instead = known.octets != octets and (alike or Key.of(known.alarm) == Key.of(alarm))
            if instead and known.unanswered and known.stage is Stage.WAITING:
                self._over(known, Outcome(), now)

    def _new(self, alarm: Alarm, octets: bytes, diagnosis: Diagnosis, *, doubtful: bool, now: int) -> None:
        standing = [known.alarm.type for known in self._open.values() if not known.maybe_taken]
        if len(standing) >= self._limit if self._limit else alarm.type in standing:
            self._too_many(now)
        if len(self._open) + len(self._book.untaken) >= MAX_OPEN:
            self._count("dropped")
            self._dropped = True
            self._reports.remark(f"raises alarms while {MAX_OPEN} wait to be taken: dropped, not acknowledged", now)
            return
        self._book.number += 1
        stage = Stage.HELD if self._book.hold else Stage.WAITING
        self._open[Key.of(alarm)] = OpenAlarm(self._book.number, alarm, octets, stage, doubtful)
        self._settling.raised(alarm)
        self._count("raised")
        self._reports.event(
            AlarmRaised,
            now,
            number=self._book.number,
            alarm=alarm,
            diagnosis=diagnosis,
            held=self._book.hold,
            texts=texts_beside(diagnosis, alarm, self._setup.texts),
        )

    def _count(self, name: str) -> None:
        self._book.count(name)
        self._reports.mark_changed()

    def _too_many(self, now: int) -> None:
        self._count("too_many")
        agreed = f"{self._limit} at a time (alarm_mode)" if self._limit else "one of each type at a time"
        self._reports.remark(f"raises more alarms than agreed, which is {agreed}; see its counters", now)

    # --- from the application -----------------------------------------------------------------------------------

    def release(self, number: int | None, now: int) -> None:
        """The station acknowledges the alarm ``number``, None: all that wait. One that is over is no error."""
        for known in self._open.values():
            if known.stage is Stage.HELD and number in (None, known.number):
                known.stage = Stage.WAITING
        self._make_room(now)

    # --- the acknowledgement ------------------------------------------------------------------------------------

    def missed(self) -> None:
        """The slave gave no answer to a request of any service."""
        self._unsure = self._unsure or self.handler.exchanges == self._read_after

    @property
    def counts(self) -> AlarmCounts:
        """Counted since the start, also under other parameters."""
        return self._book.counts

    @property
    def busy(self) -> bool:
        """True while :meth:`next_ack` may return an alarm, now or later."""
        return bool(self._open) or self._settling.look_at != NEVER

    @property
    def standing(self) -> tuple[Alarm, ...]:
        return self._standing

    def next_ack(self, now: int) -> OpenAlarm | None:
        """The alarm to be acknowledged now: one at a time, in the order they came. Called in every token hold while
        :attr:`busy`."""
        if self._settling.look_at <= now:
            self._settling.look_at = NEVER
            self._want_diagnosis(now)
        if self._asked is not None or not self._open or self.handler.exchanges == self._read_after:
            return None
        for known in tuple(self._open.values()):
            if known.answered:
                self._over(known, Outcome(), now)
            elif known.stage is Stage.WAITING and known.not_before <= now:
                return known
        return None

    def begin_ack(self, known: OpenAlarm) -> None:
        """Begin the acknowledgement of ``known``."""
        self._asked = known
        known.stage = Stage.ASKED
        if known.attempts:
            self._count("repeated")
        known.attempts += 1

    def ended(self, known: OpenAlarm, outcome: Outcome, now: int) -> None:
        if self._asked is known:
            self._asked = None
        if self._open.get(Key.of(known.alarm)) is not known:
            return  # the slave left data exchange meanwhile
        is_busy = outcome.codes is not None and outcome.codes[1] in AGAIN
        refused = outcome.failure in _NO and not is_busy
        self._extra_sap_took |= self.extra_sap and outcome.failure is None
        taken = known.unanswered and self._extra_sap_took
        if outcome.failure is ServiceFailure.REFUSED and self.extra_sap and not taken:
            self.extra_sap = False
            known.stage = Stage.WAITING
            self._reports.remark(_NO_EXTRA_SAP, now)
        elif outcome.failure is None or (refused and known.unanswered):
            self._over(known, Outcome(), now)
        elif refused:
            self._count("refused")
            if self._book.counts.refused == 1:
                self._reports.remark(_REFUSED.format(why=self._remark_of(outcome)), now)
            self._over(known, outcome, now)
        else:
            known.stage = Stage.WAITING
            known.not_before = now + _AGAIN[min(known.attempts, len(_AGAIN)) - 1]
            if outcome.failure not in (ServiceFailure.CLOSED, ServiceFailure.NEGATIVE):
                known.unanswered = True
                if not self._silence_reported:
                    self._silence_reported = True
                    self._reports.remark(f"{self._remark_of(outcome)}; it is acknowledged again until it answers", now)

    def _remark_of(self, outcome: Outcome) -> str:
        """The text of ``outcome`` without the slave: the master puts the slave before every remark."""
        return outcome.text.removeprefix(f"slave {self._setup.address} ")

    def _over(self, known: OpenAlarm, outcome: Outcome, now: int) -> None:
        key = Key.of(known.alarm)
        del self._open[key]
        self._settling.over(key, known.octets, known.doubtful, now)
        if outcome.failure is None:
            self._count("acknowledged")
        self._done(known, outcome, now)
        if known.shown:
            self._want_diagnosis(now)
        self._make_room(now)

    def _done(self, known: OpenAlarm, outcome: Outcome, now: int) -> None:
        self._reports.event(AlarmDone, now, number=known.number, outcome=outcome)

    def _make_room(self, now: int) -> None:
        """Read the diagnosis again if there is room for an alarm that was dropped."""
        if self._dropped and len(self._open) + len(self._book.untaken) < MAX_OPEN:
            self._dropped = False
            self._want_diagnosis(now)

    # --- the end ------------------------------------------------------------------------------------------------

    def closed(self, now: int) -> None:
        """Data exchange is over: the open alarms of the slave are void."""
        self.extra_sap = self._has_extra_sap
        text = f"{self._setup.who} left data exchange: its alarms are void"
        for known in self._open.values():
            if known.stage is Stage.HELD:
                self._book.untaken.add(known.number)
            self._done(known, Outcome(ServiceFailure.CLOSED, text), now)
        self._open.clear()
        self._settling.clear()
        self._statuses.clear()
        self._standing = ()
        self._last = self._asked = None
        self._dropped = False


class AckJob(Ms1Job):
    """The acknowledgement of ``known``, one of ``alarms``, at SAP 51 or 50. The positive response repeats the request.

    After a lost response the master first asks the slave for the response that it may still have, then sends the
    request again (:class:`~dpstack.dpv1.master.ms1.Ms1Job`).
    """

    hint = ""
    why_closed = "see Extra_Alarm_SAP_supp of its GSD file (dpv1 = { extra_alarm_sap = ... })"

    def __init__(self, known: OpenAlarm, alarms: AlarmHandler, ms1: Ms1) -> None:
        alarm = known.alarm
        title = f"{Function.ALARM_ACK.title} of {alarm.title}, slot {alarm.slot}, sequence number {alarm.sequence}"
        self._ack = AlarmAck.of(alarm)
        self._known = known
        self._alarms = alarms
        sap = SAP_MS1_ALARM if alarms.extra_sap else SAP_MS1
        super().__init__(title, alarms.handler, ms1, self._ack.build(), HEAD, sap)

    @property
    def settled(self) -> bool:
        """The master has fetched the response to an earlier acknowledgement."""
        return self._known.answered

    def accept_late(self, octets: bytes) -> bool:
        outcome = self.outcome_of(octets)
        if outcome is None or outcome.failure is not None:
            return False
        self._known.answered = True
        return True

    def outcome_of(self, octets: bytes) -> Outcome | None:
        """The response has slot, type and specifier of the request."""
        try:
            if octets[0] & 0x80:
                response = parse_response(octets)
                if not isinstance(response, Negative) or response.function != Function.ALARM_ACK:
                    return None
                return negative_outcome(self.address, self.title, response)
            return Outcome() if octets[0] == Function.ALARM_ACK and AlarmAck.parse(octets) == self._ack else None
        except PduError as error:
            return unreadable_outcome(self.address, self.title, error)

    def ends(self, token: int, outcome: Outcome, now: int) -> list[Event]:
        """The alarm handler emits the event of the alarm's end."""
        self._alarms.ended(self._known, outcome, now)
        return []


class Alarms(Provider):
    """The alarms of the slaves of a class 1 master: their handlers, orders, acknowledgements."""

    def __init__(self, ms1: Ms1) -> None:
        self._ms1 = ms1
        self._books: dict[int, AlarmBook] = {}
        #: of slaves that are parameterised for DP-V1
        self._alarms: dict[int, AlarmHandler] = {}
        if ms1.master is not None:
            ms1.master.roster.observe(self._observer)

    def _observer(self, handler: SlaveHandler, before: SlaveHandler | None) -> DiagObserver:
        address = handler.setup.address
        self._alarms.pop(address, None)
        if before is None:
            self._books[address] = AlarmBook()
        if handler.setup.dpv1 is None:
            return NO_ALARMS
        alarms = self._alarms[address] = AlarmHandler(handler, self._books[address])
        return alarms

    def command(self, order: object, now: int) -> bool:
        """HoldAlarms and AcknowledgeAlarm, also for an alarm that is over. Raises UsageError as for a service."""
        match order:
            case HoldAlarms(address, on):
                handler = self._ms1.dpv1_slave(address) if on else self._ms1.slave(address)
                book = self._books[handler.setup.address]
                book.hold = on
                if not on:
                    book.untaken.clear()
                    if address in self._alarms:
                        self._alarms[address].release(None, now)
            case AcknowledgeAlarm(address, number):
                handler = self._ms1.slave(address)
                self._books[handler.setup.address].untaken.discard(number)
                if address in self._alarms:
                    self._alarms[address].release(number, now)
            case _:
                return False
        return True

    def queue_jobs(self, now: int) -> None:
        """Acknowledgements go out in the hold of the Data_Exchange before them, one at a time for each slave."""
        for alarms in self._alarms.values():
            known = alarms.next_ack(now) if alarms.busy else None
            if known is not None:
                alarms.begin_ack(known)
                job = AckJob(known, alarms, self._ms1)
                self.queue.put(job, job.timeout_ns, now, token=ACKS, first=True)

    def request_ended(self, request: Request, outcome: Telegram | Failure, now: int) -> None:
        """Silence leaves the slave in doubt whether its diagnosis was read."""
        if isinstance(outcome, Telegram) or outcome in (Failure.ABANDONED, Failure.HELD_BACK, Failure.REFUSED):
            return
        alarms = self._alarms.get(request.da)
        if alarms is not None:
            alarms.missed()
