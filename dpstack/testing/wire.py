"""Observation of a simulated line by its octets: exchanges, services, Clear, safe outputs.

Nothing here asks the master or a slave: every statement follows from the octets on the line, the requests and the
answers. Octets that no station received whole (dropped, damaged, collided, cut off) count as not sent.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from enum import Enum, auto
from functools import lru_cache
from typing import Final, NamedTuple

from msgspec import Struct

from dpstack.api.bus.compose import core_of
from dpstack.api.config.slave import SlaveConfig
from dpstack.decode.names import NO_NAMES, Names
from dpstack.decode.wire_log import render, render_changes
from dpstack.dp.pdu.requests import GlobalControl
from dpstack.dp.services import EMPTY_STATUS, SERVICE_NAMES, positive
from dpstack.errors import PduError, UsageError
from dpstack.fdl.telegram import SAP_GLOBAL_CONTROL, SAP_SET_PRM, SAP_SLAVE_DIAG, SHORT_ACK, Kind, Req, Telegram
from dpstack.params import BROADCAST
from dpstack.profile import DriveCore, Goal, State
from dpstack.sim.transmission import on_wire
from dpstack.text import printable
from dpstack.trace import WireEntry, WireFields, WireLog
from dpstack.units import ns_to_s

#: the name of the service without a SAP
DATA_EXCHANGE: Final = "Data_Exchange"
#: telegrams, exchanges and services that are kept
KEPT: Final = 20_000
#: telegrams that are judged at once, and kinds of octets whose judgement is kept
_AT_ONCE: Final = 4_096
#: telegrams that the log of a failure decodes first
_NEAR: Final = 4_000
#: outputs that a message shows
_SHOWN: Final = 12
#: goals of a drive's control word without a run
_RESTING: Final = (Goal.IDLE, Goal.STOP, Goal.QUICK_STOP, Goal.COAST)
#: remarks of the simulated line about octets that no station received, or not whole
_NOT_RECEIVED: Final = ("dropped", "silenced", "collision", "cut off", "damaged")
#: the services of a bring-up in their order
_BRING_UP: Final = ("Slave_Diag", "Set_Prm", "Chk_Cfg", "Slave_Diag", DATA_EXCHANGE)
# Set_Prm, first octet: Lock_Req, Unlock_Req; group ident in the last of its seven octets
_LOCK: Final = 0x80
_UNLOCK: Final = 0x40
_GROUP_AT: Final = 6
# Slave_Diag: Station_Not_Ready in octet 1, Prm_Req in octet 2
_SRD: Final = (Req.SRD_LOW, Req.SRD_HIGH, Req.MSRD)
_NOT_READY: Final = 0x02
_PRM_REQ: Final = 0x01


class Exchange(NamedTuple):
    """A Data_Exchange at ``t`` seconds of bus time. ``inputs``: the octets of a positive answer; None without one."""

    #: bus time in seconds
    t: float
    #: octets of the request
    outputs: bytes
    inputs: bytes | None


#: of an :class:`Exchange` and of a :class:`Service`, with the time in ns
_Seen = tuple[int, bytes, bytes | None]
_Asked = tuple[int, str, bool]


class Service(NamedTuple):
    """A service of the master at a slave at ``t`` seconds of bus time. Successive Data_Exchanges are one entry, which
    is answered when one of them was.
    """

    #: bus time in seconds
    t: float
    #: name of the service
    name: str
    #: the slave answered positively
    answered: bool


class Watched(Struct, frozen=True):
    """A slave whose outputs are judged. ``safe``: safe outputs, for people; ``places``: the octets that show whether
    outputs are safe, ``accepted``: what these may be. ``drives``: of a slave with several, judged instead."""

    name: str
    address: int
    safe: bytes
    places: tuple[int, ...]
    accepted: frozenset[bytes]
    drives: tuple[Watched, ...] = ()

    @classmethod
    def of(cls, slave: SlaveConfig, safe: bytes | None = None) -> Watched:
        """``safe`` None: those of the configuration, or any control word of the drive that stops it or does not start
        it. Raises UsageError for another length."""
        own = slave.params.safe_outputs if safe is None else safe
        if len(own) != slave.params.output_len:
            raise UsageError(f"{slave.name}: {len(own)} safe octets, it has {slave.params.output_len} of outputs")
        if safe is not None or slave.raw or not slave.has_drive:
            return cls(slave.name, slave.address, own, tuple(range(len(own))), frozenset({own}))
        if slave.drives:
            drives = tuple(
                cls._of_core(core, slave.address, own[slice(*one.outputs)], one.outputs[0])
                for one in slave.drives
                for core in (core_of(slave, one, simulated=True),)
                if core is not None
            )
            return cls(slave.name, slave.address, own, (), frozenset({b""}), drives)
        core = core_of(slave, simulated=True)
        assert core is not None
        return cls._of_core(core, slave.address, own)

    @classmethod
    def _of_core(cls, core: DriveCore, address: int, own: bytes, at: int = 0) -> Watched:
        """``own``: the safe outputs of the drive, which begin ``at`` that octet of the slave."""
        zero, ones = core.encode(0, 0), core.encode(0xFFFF, 0)
        lead = len(own) - len(zero)  # the parameter channel
        control = [octet for octet in range(len(zero)) if zero[octet] != ones[octet]]
        if not control:
            return cls(core.name, address, own, tuple(range(at, at + len(own))), frozenset({own}))
        words = {core.table.steady[goal] for goal in _RESTING} - {core.table.run.get(State.RUNNING)}
        accepted = {bytes(core.encode(word, 0)[octet] for octet in control) for word in words}
        accepted.add(bytes(own[lead + octet] for octet in control))
        return cls(core.name, address, own, tuple(at + lead + octet for octet in control), frozenset(accepted))

    @property
    def zeros_are_safe(self) -> bool:
        if self.drives:
            return all(one.zeros_are_safe for one in self.drives)
        return bytes(len(self.places)) in self.accepted

    def is_safe(self, outputs: bytes) -> bool:
        if self.drives:
            return all(one.is_safe(outputs) for one in self.drives)
        return bytes(outputs[at] for at in self.places if at < len(outputs)) in self.accepted


class _Place(Enum):
    """Place of octets in an exchange; OTHER: another request, or a token; NONE: they are no telegram."""

    EXCHANGE = auto()
    OTHER = auto()
    ANSWER = auto()
    NONE = auto()


# asked for each telegram: an enum's member costs ten times a name of the module
_ANSWER: Final = _Place.ANSWER
_EXCHANGE: Final = _Place.EXCHANGE
_OTHER: Final = _Place.OTHER
_NONE: Final = _Place.NONE
_SC: Final = Kind.SC


class _Outputs:
    """The outputs that may act at one slave, as the octets on the line show.

    Outputs that are not safe count at once; safe ones, Clear and Unlock count when the slave has answered them, or
    answered before them if they have no answer.
    """

    def __init__(self, slave: Watched) -> None:
        self.slave = slave
        self.last: bytes | None = None
        #: the last exchange whose outputs act and are not safe; None: safe
        self.acting: _Seen | None = None
        self._received: _Seen | None = None  # its outputs act with the next SYNC
        self._calm: bytes | None = None  # safe outputs that change nothing any more
        self._synced = False
        self._group = 0
        self._answers = False  # its last request was answered
        self._exchanges = False  # that was a Data_Exchange
        self._zeros_are_safe = slave.zeros_are_safe
        self._is_safe = lru_cache(_AT_ONCE)(slave.is_safe)
        #: time in ns, outputs, and the inputs of a positive answer; the last ones
        self.exchanges: deque[_Seen] = deque(maxlen=KEPT)
        #: time in ns, name, whether it was answered positively; the last ones
        self.services: deque[_Asked] = deque(maxlen=KEPT)

    def exchange(self, t_ns: int, outputs: bytes) -> None:
        """A Data_Exchange that has no answer yet."""
        self.last = outputs
        self._answers = self._exchanges = False
        self.exchanges.append((t_ns, outputs, None))
        if not self.services or self.services[-1][1] != DATA_EXCHANGE:
            self.services.append((t_ns, DATA_EXCHANGE, False))
        self._may_act(self.exchanges[-1])

    def _may_act(self, seen: _Seen) -> None:
        outputs = seen[1]
        if not self._is_safe(outputs) and any(outputs):
            self._calm = None
            self._received = seen
            if not self._synced:
                self.acting = seen

    def exchanged(self, outputs: bytes, inputs: bytes) -> None:
        """The slave has answered the last Data_Exchange, with these outputs, positively."""
        t_ns, _, _ = self.exchanges.pop()
        self.answered(t_ns, outputs, inputs)

    def answered(self, t_ns: int, outputs: bytes, inputs: bytes) -> None:
        """A Data_Exchange that the slave has answered positively."""
        seen = (t_ns, outputs, inputs)
        self.exchanges.append(seen)
        self.last = outputs
        if not self._exchanges:
            self._answers = self._exchanges = True
            if not self.services or self.services[-1][1] != DATA_EXCHANGE:
                self.services.append((t_ns, DATA_EXCHANGE, True))
            elif not self.services[-1][2]:
                self._positive()
        if outputs == self._calm:
            return
        if self._received is not None and self._received[1] == outputs:  # not safe, and judged before
            self._received = seen
            if not self._synced:
                self.acting = seen
            return
        self._may_act(seen)
        if not outputs:
            self._received = self.acting = None
        elif self._is_safe(outputs):
            self._received = None
            if not self._synced:
                self.acting = None
            if self.acting is None:
                self._calm = outputs

    def _positive(self) -> None:
        t_ns, name, _ = self.services[-1]
        self.services[-1] = (t_ns, name, True)

    def control(self, command: GlobalControl) -> None:
        if command.group_mask and not command.group_mask & self._group:
            return
        if command.clear and self._answers and self._zeros_are_safe:
            self._received = self.acting = None
        if command.unsync:
            if self._synced:
                self.acting = self._received
            self._synced = False
        elif command.sync:
            self.acting = self._received
            self._synced = True

    def request(self, t_ns: int, dsap: int) -> None:
        """A service that has no answer yet."""
        self._answers = self._exchanges = False
        self.services.append((t_ns, SERVICE_NAMES[dsap], False))

    def answer(self, dsap: int, request: bytes, answer: bytes, *, done: bool) -> None:
        """The answer to the last service; ``done``: a positive one."""
        self._answers = done
        if not done:
            return
        self._positive()
        if dsap == SAP_SET_PRM and len(request) > _GROUP_AT:
            if request[0] & _UNLOCK:
                self._leave()
            elif request[0] & _LOCK:
                self._group = request[_GROUP_AT]
        elif dsap == SAP_SLAVE_DIAG and len(answer) > 1 and (answer[0] & _NOT_READY or answer[1] & _PRM_REQ):
            self._leave()

    def _leave(self) -> None:
        """The slave is not in data exchange, so it has no outputs."""
        self._received = self.acting = None
        self._synced = False


#: a telegram, its place in an exchange, whose Data_Exchange it is, whether it is a positive answer to one
_Known = tuple[Telegram, _Place, _Outputs | None, bool]


class Wire:
    """Everything that went over a simulated line, from its octets. Times are seconds of bus time.

    Slaves are named by name or address. ``exchanges`` and ``services`` know the last 20,000 of each slave, ``text`` the
    last 20,000 telegrams; ``assert_last_outputs_safe`` knows all. The line is judged when somebody asks, or when 4,096
    telegrams wait for it.
    """

    def __init__(
        self,
        slaves: Iterable[Watched],
        baud: Callable[[], int],
        names: Names = NO_NAMES,
        log: WireLog | None = None,
    ) -> None:
        self._baud = baud
        self._log = log
        self._names = names
        self._count = 0
        self._slaves = tuple(slaves)
        self._waiting: list[WireFields] = []  # not judged yet
        self._kept: deque[WireFields] = deque(maxlen=KEPT)
        self._outputs = {slave.address: _Outputs(slave) for slave in self._slaves}
        self._clears: deque[float] = deque(maxlen=KEPT)
        self._open: Telegram | None = None  # a request without its answer
        self._known: dict[bytes, _Known] = {}
        if log is not None:
            log.hand_to(self._take)

    def __repr__(self) -> str:
        return f"<Wire of {len(self._slaves)} slaves, {len(self._entries)} telegrams kept>"

    @property
    def _entries(self) -> list[WireEntry]:
        self._judge()
        return [WireEntry._make(one) for one in self._kept]

    # --- what was seen ----------------------------------------------------------------------------------------------

    def exchanges(self, slave: str | int, since: float = 0.0) -> list[Exchange]:
        """The Data_Exchanges of ``slave`` from ``since`` on, with those that it did not answer."""
        return [one for one in map(_exchange, self._seen(slave).exchanges) if one.t >= since]

    def services(self, slave: str | int, since: float = 0.0) -> list[Service]:
        """The services of the master at ``slave`` from ``since`` on, repetitions too."""
        return [one for one in map(_service, self._seen(slave).services) if one.t >= since]

    def last_outputs(self, slave: str | int) -> bytes | None:
        """The outputs of the last Data_Exchange that was sent to ``slave``; None before the first."""
        return self._seen(slave).last

    @property
    def clears(self) -> list[float]:
        """The times of each Global_Control with Clear."""
        self._judge()
        return list(self._clears)

    def text(self, last: int = 40, *, every: bool = False) -> str:
        """The last lines of the decoded log. Telegrams that repeat what was there before are one line, so that the log
        reaches back to what has changed: other outputs, an answer that is missing, a bring-up. ``every``: a line for
        each of the ``last`` telegrams."""
        entries = self._entries
        if every:
            near = entries[-max(_NEAR, last) :]
            log = render(near, self._baud(), names=self._names, last=last, number=self._count - len(near) + 1)
        else:
            # most failures have their reason in the last seconds; the whole log is decoded only if it is needed
            for reach in (_NEAR, KEPT):
                near = entries[-reach:]
                first = self._count - len(near) + 1
                log = render_changes(near, self._baud(), names=self._names, last=last, number=first)
                if log.count("\n") >= last or len(near) == len(entries):
                    break
        return "\n".join(map(printable, log.splitlines()))

    # --- assertions -------------------------------------------------------------------------------------------------

    def assert_last_outputs_safe(self, slave: str | int) -> None:
        """The outputs that act at ``slave`` are safe: by its last Data_Exchanges, by Clear, or because the slave says
        that it is not in data exchange.

        Safe are the outputs for every way out, which are zeros without another configuration, and of a drive every
        control word that stops it or does not start it. Safe outputs, Clear and Unlock count only from a slave that
        answers; other outputs count as soon as they are sent. Outputs under SYNC act with the next SYNC. If zeros
        are no safe outputs, zeros and Clear leave what acts.
        """
        __tracebackhide__ = True
        outputs = self._seen(slave)
        if outputs.acting is None:
            return
        t_ns, octets, _ = outputs.acting
        watched = outputs.slave
        raise AssertionError(
            f"{_who(watched)} may still act on outputs that are not safe: {octets.hex(' ')} at {ns_to_s(t_ns):.6f} s; "
            f"safe are {watched.safe.hex(' ')}, or Clear, answered by the slave (of a silent slave the wire does not "
            f"show whether its watchdog has expired: look at the device's outputs and exchanging)"
        )

    def assert_exchanged(self, slave: str | int, outputs: bytes | str | None = None, since: float = 0.0) -> None:
        """``slave`` answered a Data_Exchange from ``since`` on, one with ``outputs`` (octets, or hex) if given."""
        __tracebackhide__ = True
        watched = self._find(slave)
        wanted = bytes.fromhex(outputs) if isinstance(outputs, str) else outputs
        answered: list[bytes] = []  # the last outputs first
        for t_ns, octets, inputs in reversed(self._seen(slave).exchanges):
            if ns_to_s(t_ns) < since:
                break
            if inputs is not None:
                if wanted in (None, octets):
                    return
                answered.append(octets)
        seen = ", ".join(dict.fromkeys(one.hex(" ") or "none" for one in answered[_SHOWN - 1 :: -1])) or "no exchange"
        behind = "" if wanted is None else f" with the outputs {wanted.hex(' ')}"
        raise AssertionError(f"{_who(watched)} answered no Data_Exchange{behind} since {since:g} s; answered: {seen}")

    def assert_clear(self, since: float = 0.0) -> None:
        """A Global_Control with Clear was sent from ``since`` on."""
        __tracebackhide__ = True
        if not any(t >= since for t in self.clears):
            raise AssertionError(f"no Clear was sent since {since:g} s")

    def assert_brought_up(self, slave: str | int, since: float = 0.0) -> None:
        """From ``since`` on ``slave`` answered the services of a bring-up in their order: Slave_Diag, Set_Prm, Chk_Cfg,
        Slave_Diag, Data_Exchange. Other services may stand between them."""
        __tracebackhide__ = True
        names = [one.name for one in self.services(slave, since) if one.answered]
        left: Sequence[str] = _BRING_UP
        for name in names:
            if left and name == left[0]:
                left = left[1:]
        if left:
            seen = ", ".join(dict.fromkeys(names)) or "nothing"
            raise AssertionError(
                f"{_who(self._find(slave))}: the bring-up lacks {', '.join(left)} since {since:g} s; answered: {seen}"
            )

    def _find(self, slave: str | int) -> Watched:
        for one in self._slaves:
            if slave in (one.name, one.address):
                return one
        known = ", ".join(f"{one.name} ({one.address})" for one in self._slaves) or "none"
        raise UsageError(f"no slave {slave!r} on this bus; there are: {known}")

    def _seen(self, slave: str | int) -> _Outputs:
        """All that was seen of ``slave`` up to now."""
        self._judge()
        return self._outputs[self._find(slave).address]

    # --- from the line ----------------------------------------------------------------------------------------------

    def add(self, fields: WireFields) -> None:
        """A transmission on the line, in the order of their ends."""
        self._take([fields])

    def _take(self, transmissions: Sequence[WireFields]) -> None:
        self._waiting += transmissions
        if len(self._waiting) >= _AT_ONCE:
            self._judge()

    def _judge(self) -> None:
        """Judge the transmissions that wait for it."""
        if self._log is not None:
            self._log.settle()
        waiting, self._waiting = self._waiting, []
        self._count += len(waiting)
        self._kept.extend(waiting)
        known = self._known
        at, asked, slave = 0, self._open, None  # slave: of a Data_Exchange that it has not been handed
        for t_ns, _, octets, _, note in waiting:
            if note and any(word in note for word in _NOT_RECEIVED):
                continue
            if (found := known.get(octets)) is None:
                found = self._know(octets)
            telegram, place, exchanges, is_data = found
            if place is _ANSWER:
                if asked is None or (telegram.sa != asked.da and telegram.kind is not _SC):
                    continue
                if slave is None:
                    self._answered(asked, telegram)
                elif is_data:
                    slave.answered(at, asked.data, telegram.data)
                else:
                    slave.exchange(at, asked.data)
                asked = slave = None
                continue
            if place is _NONE:
                continue
            if slave is not None and asked is not None:
                slave.exchange(at, asked.data)
            at, asked, slave = t_ns, telegram, exchanges
            if place is not _EXCHANGE:
                asked = self._request(t_ns, telegram)
        if slave is not None and asked is not None:
            slave.exchange(at, asked.data)
        self._open = asked

    def _know(self, octets: bytes) -> _Known:
        known, (telegram, _) = self._known, on_wire(octets, self._baud())  # the line has asked it, too
        if len(known) >= _AT_ONCE:
            known.clear()
        if telegram is None:
            found: _Known = (SHORT_ACK, _NONE, None, False)
        elif not (telegram.is_request or telegram.kind is Kind.SD4):
            found = (telegram, _ANSWER, None, _answers_data(telegram))
        elif (
            telegram.is_request and telegram.dsap is None and telegram.function in _SRD and telegram.da in self._outputs
        ):
            found = (telegram, _EXCHANGE, self._outputs[telegram.da], False)
        else:
            found = (telegram, _OTHER, None, False)
        known[octets] = found
        return found

    def _request(self, t_ns: int, telegram: Telegram) -> Telegram | None:
        """A request that is no Data_Exchange, or a token; returns a request that has an answer."""
        dsap = telegram.dsap
        if dsap == SAP_GLOBAL_CONTROL:
            self._control(t_ns, telegram)
            return None
        outputs = self._outputs.get(telegram.da)
        if outputs is None or dsap is None or dsap not in SERVICE_NAMES:  # FDL_Status, DP-V1
            return None
        outputs.request(t_ns, dsap)
        return telegram

    def _control(self, t_ns: int, telegram: Telegram) -> None:
        try:
            command = GlobalControl.parse(telegram.data)
        except PduError:
            return
        if command.clear:
            self._clears.append(ns_to_s(t_ns))
        for address, outputs in self._outputs.items():
            if telegram.da in (BROADCAST, address):
                outputs.control(command)

    def _answered(self, request: Telegram, answer: Telegram) -> None:
        outputs, dsap = self._outputs[request.da], request.dsap
        if dsap is not None:
            outputs.answer(dsap, request.data, answer.data, done=positive(dsap, answer))
        elif _answers_data(answer):
            outputs.exchanged(request.data, answer.data)


def _answers_data(telegram: Telegram) -> bool:
    """Whether an answer to a Data_Exchange is positive."""
    return telegram.kind is _SC or telegram.function in EMPTY_STATUS


def _exchange(seen: _Seen) -> Exchange:
    t_ns, outputs, inputs = seen
    return Exchange(ns_to_s(t_ns), outputs, inputs)


def _service(seen: _Asked) -> Service:
    t_ns, name, answered = seen
    return Service(ns_to_s(t_ns), name, answered)


def _who(slave: Watched) -> str:
    return printable(f"{slave.name} ({slave.address})")
