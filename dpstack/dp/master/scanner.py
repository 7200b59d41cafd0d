"""The scanner: the live list with ident number, state and owner of each slave.

It sends FDL status, Slave_Diag and, if wanted, Get_Cfg. These services change nothing in a slave and are open to every
master in every state (docs/reference/protocol.md#services-by-state); a request from another address leaves watchdog and
frame count of the owner alone. The scanner sends one request a token hold, in the time that is left, like the live
list.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection
from typing import Final

from msgspec import Struct, structs

from dpstack.dp.master.verdicts import foreign_owner
from dpstack.dp.pdu.diagnosis import Diagnosis, SlaveView, view_of
from dpstack.dp.services import positive
from dpstack.errors import UsageError
from dpstack.fdl.commands import AttachUser
from dpstack.fdl.events import StationFound
from dpstack.fdl.interface import Failure, LinkUser, Request
from dpstack.fdl.livelist import ALL_ADDRESSES, LiveList, live_allowance, long_look
from dpstack.fdl.telegram import SAP_GET_CFG, SAP_SLAVE_DIAG, SSAP_MS0, Req, StationType, Telegram
from dpstack.params import BusParams
from dpstack.phy.patience import Patience
from dpstack.trace import Event

#: three first requests and the probe with FCV = 1 that finds slaves which know nothing else
#: (docs/reference/protocol.md#slaves-that-know-only-fcv-1)
_ATTEMPTS: Final = 4


class Found(Struct, frozen=True, kw_only=True):
    """One station. Of a slave also ``ident``, ``state``, ``master`` (its owner) and ``diagnosis``, as far as known.

    ``config``: its identifier octets, if the scanner asked for them and the slave answered.
    """

    #: station address, 0..126
    address: int
    #: type of the station
    kind: StationType
    #: state of a slave by its diagnosis; None: not known, or no slave
    state: SlaveView | None = None
    #: ident number of a slave; None while it is not known
    ident: int | None = None
    #: address of the slave's master; None without one
    master: int | None = None
    config: bytes | None = None
    #: last diagnosis of a slave; None before the first
    diagnosis: Diagnosis | None = None

    @property
    def text(self) -> str:
        """The station in one line."""
        words = [f"station {self.address}: {self.kind.text}"]
        if self.ident is not None:
            words.append(f"ident 0x{self.ident:04X}")
        if self.state is not None:
            words.append(self.state.value)
        if self.master is not None:
            words.append(f"master {self.master}")
        return ", ".join(words)

    def as_dict(self) -> dict[str, object]:
        """As in the JSON of ``scan``: null if a key does not apply or is not known; ``config`` (hex) if it is
        known."""
        known = {} if self.config is None else {"config": self.config.hex(" ").upper()}
        return {
            "address": self.address,
            "type": self.kind.name.lower(),
            "ident": None if self.ident is None else f"0x{self.ident:04X}",
            "state": None if self.state is None else self.state.value,
            "master": self.master,
            **known,
        }


class StationSeen(Event):
    """A station was found, or it has changed; ``present`` False: it no longer answers."""

    #: the station
    found: Found
    #: False: it no longer answers
    present: bool = True

    def _text(self) -> str:
        return self.found.text if self.present else f"station {self.found.address} no longer answers"


class ScanDone(Event):
    """The scanner has asked every address. ``token``: of the :class:`SurveyOrder`, 0 for the list of a read-only bus.

    ``found``: the stations in order of their addresses. ``unreadable``: addresses whose answers could not be read.
    """

    stations: int
    token: int = 0
    found: tuple[Found, ...] = ()
    unreadable: tuple[int, ...] = ()

    MUST_ARRIVE = True

    TEMPLATE = "live list complete: {e.stations} stations besides this one"


class _Question(Struct):
    address: int
    sap: int
    tries: int = _ATTEMPTS


class Scanner(LinkUser):
    """A ``LinkUser`` on top of ``live``; ``own``: the address of this station.

    ``configs``: ask for the identifier octets too. ``skip``: addresses whose slaves are not asked (the DP master of
    this station knows more of them). ``period_ns``: ask each slave again after this time, and silent addresses in
    ``wanted`` too. ``found`` is the result, complete when ``done``. ``token``: see :class:`ScanDone`.
    """

    def __init__(
        self,
        own: int,
        live: LiveList,
        *,
        configs: bool = False,
        skip: Collection[int] = (),
        period_ns: int = 0,
        wanted: Collection[int] = (),
        token: int = 0,
    ) -> None:
        self.live = live
        self.found: dict[int, Found] = {}
        #: the scanner has asked every address at least once
        self.done = False
        self._own = own
        self._configs = configs
        self._skip = frozenset(skip)
        self._period_ns = period_ns
        self._wanted = tuple(wanted)
        self._token = token
        self._next_at = 0
        self._questions: deque[_Question] = deque()
        self._asked: _Question | None = None
        self._turn = False
        self._reported: dict[int, Found] = {}
        self.events: list[Event] = []

    # --- link user ----------------------------------------------------------------------------------------------
    def token_received(self, now: int) -> None:
        self._turn = True
        self.live.token_received(now)
        if self._period_ns and now >= self._next_at and not self._questions:
            self._next_at = now + self._period_ns
            for address in self._wanted:
                if address not in self.found:
                    self.live.ask_soon(address)
            for found in self.found.values():
                if found.kind is StationType.SLAVE:
                    self._ask(found.address, SAP_SLAVE_DIAG)

    def next_request(self, now: int, high_only: bool) -> Request | None:
        """The next question to a slave that was found, else the next address of the live list."""
        if high_only or not self._turn:
            return None
        if not self._questions:
            request = self.live.next_request(now, high_only)
            self._turn = request is None
            return request
        self._turn = False
        question = self._asked = self._questions.popleft()
        # SRD high like all DP services (docs/reference/protocol.md#slaves-that-know-only-fcv-1), but with low priority
        # here
        return Request(question.address, Req.SRD_HIGH, b"", question.sap, SSAP_MS0, patient=True)

    def started(self, request: Request, at: int) -> None:
        """The live list counts its silent polls."""
        if request.dsap is None:
            self.live.started(request, at)

    def result(self, request: Request, outcome: Telegram | Failure, now: int) -> None:
        question, self._asked = self._asked, None
        if question is None:
            self.live.result(request, outcome, now)
            self._read_live_list(now)
        elif outcome in (Failure.ABANDONED, Failure.REFUSED, Failure.HELD_BACK):
            self._questions.appendleft(question)
        elif isinstance(outcome, Telegram) and positive(question.sap, outcome):
            self._answered(question, outcome.data, now)
        else:
            self._not_answered(question, now, silent=outcome is Failure.NO_ANSWER)
        if not self.done and self.live.done and not self._questions:
            self.done = True
            found = tuple(found for _, found in sorted(self.found.items()))
            unreadable = tuple(sorted(self.live.unreadable))
            self.events.append(
                ScanDone(t_ns=now, stations=len(found), token=self._token, found=found, unreadable=unreadable)
            )

    def take_events(self) -> list[Event]:
        """Stations found, changed and lost."""
        events = self.events.copy()
        self.events.clear()
        return events

    # --- what was found -----------------------------------------------------------------------------------------
    def _read_live_list(self, now: int) -> None:
        for event in self.live.take_events():
            if not isinstance(event, StationFound):
                continue
            if event.kind is None:
                self._gone(event.address, now)
                continue
            slave = event.kind is StationType.SLAVE
            self.found[event.address] = Found(
                address=event.address, kind=event.kind, state=SlaveView.UNKNOWN if slave else None
            )
            if slave and event.address not in self._skip:
                self._ask(event.address, SAP_SLAVE_DIAG)
                if self._configs:
                    self._ask(event.address, SAP_GET_CFG)
            else:
                self._report(event.address, now)

    def _ask(self, address: int, sap: int) -> None:
        self._questions.append(_Question(address, sap))

    def _answered(self, question: _Question, data: bytes, now: int) -> None:
        found = self.found.get(question.address)
        if found is None:
            return
        if question.sap == SAP_GET_CFG:
            self.found[question.address] = structs.replace(found, config=data)
            return
        diagnosis = Diagnosis.parse(data)
        state = view_of(diagnosis)
        owner = None
        if diagnosis is not None:
            # some slaves name the station that asks as their master: the scanner owns no slave
            owner = foreign_owner(diagnosis, self._own)
        ident = None if diagnosis is None else diagnosis.ident
        self.found[question.address] = structs.replace(
            found, state=state, ident=ident, master=owner, diagnosis=diagnosis
        )
        self._report(question.address, now)

    def _not_answered(self, question: _Question, now: int, *, silent: bool) -> None:
        """Ask again, as often as a slave may need first requests; then report its FDL status only, or its loss."""
        question.tries -= 1
        if question.tries:
            self._questions.append(question)
        elif question.sap == SAP_SLAVE_DIAG:
            if silent and question.address in self._reported:
                self.live.forget(question.address, now)
                self._read_live_list(now)
            else:
                self._report(question.address, now)

    def _report(self, address: int, now: int) -> None:
        found = self.found.get(address)
        if found is not None and found != self._reported.get(address):
            self._reported[address] = found
            self.events.append(StationSeen(t_ns=now, found=found))

    def _gone(self, address: int, now: int) -> None:
        found = self.found.pop(address, None)
        self._reported.pop(address, None)
        if found is not None:
            self.events.append(StationSeen(t_ns=now, found=found, present=False))


class SurveyOrder(AttachUser):
    """Ask ``addresses`` (0..126) once; :class:`ScanDone` has the result. ``skip``: addresses whose slaves get no
    Slave_Diag.

    ``configs``: ask for identifier octets too. ``quick``: no limit for the share of the bus time that polls of silent
    addresses take.
    """

    addresses: tuple[int, ...]
    skip: tuple[int, ...]
    configs: bool
    quick: bool

    def link_user(self, params: BusParams, patience: Patience, now: int) -> Scanner:
        """Raises UsageError for an address that no station can have."""
        for address in self.addresses:
            if address not in ALL_ADDRESSES:
                raise UsageError(f"no station has the address {address}: the live list asks 0..126")
        allowance = None if self.quick else live_allowance(params, patience, now)
        look = long_look(params, patience) if self.quick else None
        live = LiveList(params.address, addresses=self.addresses, allowance=allowance, long_look=look)
        return Scanner(params.address, live, configs=self.configs, skip=self.skip, token=self.token)
