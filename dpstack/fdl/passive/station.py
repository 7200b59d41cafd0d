"""The passive station: the responder's side of the link layer.

The station answers no earlier than T_SDR after the last bit of the request. It answers FDL status requests itself,
repeats its last answer when a master repeats the request, and passes all other requests to its application (a
``Responder``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, Protocol

from msgspec import Struct
from msgspec.structs import replace

from dpstack.errors import ConfigError, UsageError
from dpstack.fdl.codec import SC_OCTETS, encode_sd1, request_octets
from dpstack.fdl.commands import AtStation
from dpstack.fdl.decoder import Decoder
from dpstack.fdl.events import le3_notice
from dpstack.fdl.interface import RS_REPLY, DecoderStats, Reply, Responder
from dpstack.fdl.telegram import COUNTED, FC_FCB, FC_FCV, FC_FUNCTION, FC_REQUEST, Req, Resp, Telegram
from dpstack.machine import LineDown, LineUp
from dpstack.params import BROADCAST, UNADDRESSED, BusParams
from dpstack.phy.line import Line
from dpstack.phy.patience import EXACT, Patience
from dpstack.trace import Event
from dpstack.units import NEVER, NOW

#: T_SDR of a station is never less than this (docs/reference/protocol.md#t-sdr).
LOWEST_TSDR: Final = 11

_DL: Final = Resp.DL
_DH: Final = Resp.DH
_SERVED: Final = COUNTED - {Req.MSRD} | {Req.IDENT}
_MSRD: Final = int(Req.MSRD)
_REFUSED: Final = frozenset((Req.MSRD, Req.LSAP_STATUS))
_UNCONFIRMED: Final = frozenset((Req.SDN_LOW, Req.SDN_HIGH))
#: the time comes to all only; a Clock_Value has the function of a Time_Event
_TO_ALL: Final = _UNCONFIRMED | {Req.TIME_EVENT}


class PassiveStats(Struct):
    """Counters of one passive station, always on."""

    requests: int = 0  # handed to the application
    repeats: int = 0  # answered with the kept answer
    status: int = 0  # FDL status requests
    indications: int = 0  # SDN and broadcasts
    refused: int = 0  # RS and other negative acknowledgements
    dropped: int = 0  # answers not sent because the line was taken before


class Stub(Protocol):
    """The faults between one station and its line (:mod:`dpstack.sim.slave_faults`)."""

    def hears(self, telegram: Telegram, now: int) -> bool:
        """Whether the station receives ``telegram``."""

    def answer(self, octets: bytes, now: int) -> bytes | None:
        """The octets that the station sends instead of its answer ``octets``; None: nothing."""


class PassiveReceiver:
    """The receiver of one or more passive stations: bus parameters, times of the line, decoder."""

    #: a passive station answers at once or not at all
    held_up: Final = None

    def __init__(self, params: BusParams, patience: Patience) -> None:
        self._patience = patience
        self.line = Line(params)
        self.decoder = Decoder(stall_ns=0)
        #: see :class:`~dpstack.fdl.interface.TellsMoves`
        self.on_move: Callable[[], None] | None = None

    @property
    def decoder_stats(self) -> DecoderStats:
        """Counters of the receiver."""
        return self.decoder.stats

    def set_params(self, params: BusParams) -> None:
        """Take baud rate and times from ``params``; unfinished telegrams and unsent answers are dropped."""
        #: baud rate and times of the line
        self.params = params
        #: the rate of the receiver, in bit/s
        self.baud = params.baud
        self.line.set_params(params)
        self.decoder.stall_ns = self.line.t_stall_ns + self._patience.stall_ns
        self._forget()
        if self.on_move is not None:
            self.on_move()

    def command(self, command: object, now: int) -> None:
        """:class:`LineDown` and :class:`LineUp` from the driver, :class:`AtStation`. UsageError on anything else."""
        match command:
            case AtStation(act):
                act(now)
            case LineDown() | LineUp():
                self._forget()
                self.line.idle_since = now
            case _:
                raise UsageError(f"a passive station knows no {type(command).__name__}: tell its application directly")

    def _forget(self) -> None:
        """Drop unfinished telegrams and the unsent answer."""
        self.decoder.reset()


class PassiveStation(PassiveReceiver):
    """A passive station with its application. A ``BusStation`` and the ``StationControl`` of its application.

    ``address`` 0..126. ``params`` give the baud rate, min T_SDR and the slot time; ``t_sdr`` is the station's own
    response time in bit times (>= 11, default min T_SDR); the answer starts the larger of the two after the request.
    """

    #: a passive station hears only telegrams to its address and to all
    hears_all: Final = False
    unread: Sequence[Sequence[Event]] = ()

    def __init__(
        self,
        address: int,
        responder: Responder,
        params: BusParams,
        *,
        t_sdr: int | None = None,
        patience: Patience = EXACT,
    ) -> None:
        if t_sdr is not None and t_sdr < LOWEST_TSDR:
            raise ConfigError(f"station {address}: t_sdr = {t_sdr} bit times; {LOWEST_TSDR} is the least")
        super().__init__(params, patience)
        self.responder = responder
        self._t_sdr = LOWEST_TSDR if t_sdr is None else t_sdr
        self._pending = self.decoder.pending
        self._last: Telegram | None = None  # the last request, if it was counted and new
        #: the one before that, if it is the same but for FCB: when it comes again, it is new
        self._again: Telegram | None = None
        self._same: Reply | None = None  # the reply of which ``_kept`` has the data
        #: MSRD goes to the application, and its answer to all stations
        self._takes_msrd: bool = getattr(responder, "takes_msrd", False)
        #: the application gets answers of other stations to all; None: it wants none
        self._overhear: Callable[[Telegram, int], None] | None = getattr(responder, "overhear", None)
        self._unread: Sequence[Event] | None = getattr(responder, "events", None)
        self._tx: bytes | None = None
        self._asked_at = 0  # the time of the request of ``_tx``
        self._kept: bytes | None = None  # the last answer, for repetitions; None = silence was the answer
        self._kept_sa = -1  # the master that got it; -1 = no answer is kept
        self.set_address(address)
        self._kept_fcb = 0
        self._reply: Reply | None = None  # the last one with data, its telegram and the addresses and SAPs of that
        self._reply_octets = b""
        self._reply_to: tuple[int, int, int | None, int | None] = (-1, -1, None, None)
        self._events: list[Event] = []
        #: the station's own events and its application's; called in every step, so its application's alone at first
        self.take_events: Callable[[], list[Event]] = responder.take_events
        self._reported_le3: set[int] = set()
        self._stats = PassiveStats()
        self._requests = 0  # handed to the application: a Struct takes ten times as long to count
        self._min_tsdr = 0  # of Set_Prm; 0: Set_Prm gave none
        #: the faults between the station and its line; None without
        self.stub: Stub | None = None
        self.set_params(params)
        responder.attached(self)
        #: the deadline of the application in ns, as it was after its last call
        self.due = responder.wake_at()

    def __repr__(self) -> str:
        return f"<PassiveStation {self.address}>"

    # --- settings ---
    def set_address(self, address: int) -> None:
        """Change the station address, 0..126; an answer under way still goes out. Raises ConfigError."""
        if not 0 <= address <= UNADDRESSED:
            raise ConfigError(f"station address {address}: must be 0..{UNADDRESSED}")
        self.address = address
        self._forget_kept()
        if self.on_move is not None:
            self.on_move()

    def set_min_tsdr(self, bits: int) -> None:
        """Min T_SDR in bit times as Set_Prm gives it: 0 keeps the present one, 1..10 count as 11."""
        if bits:
            self._min_tsdr = max(bits, LOWEST_TSDR)
        self._t_sdr_ns = self.params.ns(max(self._t_sdr, self._min_tsdr or self.params.min_tsdr))
        #: the requester no longer waits for an answer that begins so long after the request
        self._late_ns = max(self.line.t_sl_ns, self._t_sdr_ns)

    def set_params(self, params: BusParams) -> None:
        """Take baud rate and times from ``params``; unfinished telegrams and the unsent answer are dropped.

        Min T_SDR of Set_Prm stays valid: a slave without a watchdog stays in Data_Exchange while it searches its rate.
        """
        super().set_params(params)
        self.set_min_tsdr(0)

    @property
    def stats(self) -> PassiveStats:
        """The counters up to now, always the same object."""
        self._stats.requests = self._requests
        return self._stats

    @property
    def t_sdr_ns(self) -> int:
        """The time from a request to the start of the answer, in ns."""
        return self._t_sdr_ns

    # --- receiving ---
    def receive(self, chunk: bytes, now: int) -> int:
        """Octets from the line; the last bit of the last octet came no later than ``now``."""
        self.line.idle_since = now  # receiving while sending implies sent
        self._again = None
        for telegram in self.decoder.feed(chunk, now):
            self.process(telegram, now)
        return self.wake_at()

    def activity(self, now: int) -> None:
        """Another station begins to send: an answer now would collide, and its master no longer waits for it."""
        if self._tx is not None:
            self.line.note_activity(now)
            self.drop()

    def telegram(self, telegram: Telegram, now: int) -> None:
        """A whole telegram, decoded by the medium; it ended at ``now``."""
        self.line.idle_since = now
        if self.decoder.pending:
            # unfinished octets came before the telegram: their rest will not follow
            for late in self.decoder.stalled(now):
                self.process(late, now)
        self.process(telegram, now)

    def command(self, command: object, now: int) -> None:
        super().command(command, now)
        self.poke()

    def poke(self) -> None:
        """Read the deadline of the application anew."""
        self.due = self.responder.wake_at()

    def drop(self) -> None:
        """Do not send the answer that waits."""
        if self._tx is not None:
            self._tx = None
            self._stats.dropped += 1

    # --- time and sending ---
    def wake(self, now: int) -> None:
        """Process a stalled telegram, and call the application at its deadline."""
        if self.decoder.pending and self.decoder.stall_at() <= now:
            for telegram in self.decoder.stalled(now):
                self.process(telegram, now)
            self.drop_if_late(now)
        if self.due <= now:
            self.responder.tick(now)
            self.due = self.responder.wake_at()

    def drop_if_late(self, now: int) -> None:
        """Drop the answer if noise behind the request delayed it past the slot time: the master no longer waits."""
        if self._tx is not None and now > self._asked_at + self._late_ns:
            self.drop()

    def answer_at(self) -> int:
        """Earliest start of the answer that waits, in ns; NEVER without one."""
        return NEVER if self._tx is None else self.line.idle_since + self._t_sdr_ns

    def take_tx(self, now: int) -> bytes | None:
        """The answer, once T_SDR is over and no octets of another telegram are pending."""
        if self._pending or self.due <= now:
            self.wake(now)
        octets = self._tx
        # the line must have been silent for T_SDR: octets of an unfinished telegram hold the answer
        if octets is None or self._pending or now < self.line.idle_since + self._t_sdr_ns:
            return None
        self._tx = None
        return octets

    def sent(self, at: int) -> int:
        """The answer leaves the line at ``at``."""
        self.line.idle_since = at
        if self._pending or self._unread is None or self._unread or self._events:
            return self._deadline()
        return self.due

    def wake_at(self) -> int:
        """The next of: start of the answer, stall of an unfinished telegram, deadline of the application."""
        at = self.due
        if self.decoder.pending:
            own = self.decoder.stall_at()
        elif self._tx is not None:
            own = self.line.idle_since + self._t_sdr_ns
        else:
            return at
        return own if own < at else at

    def hear(self, telegram: Telegram, start: int, end: int) -> int:
        if telegram is not self._again or self._tx is not None or self.stub is not None:
            if telegram.da != BROADCAST:
                self.activity(start)
            self.telegram(telegram, end)
            return self._deadline()
        # as telegram(), process() and _answer()
        self._again = self._last
        self._last = telegram
        self._kept_fcb ^= FC_FCB
        self._asked_at = self.line.idle_since = end
        self._requests += 1
        responder = self.responder
        reply = responder.serve(telegram, end)
        self.due = due = responder.wake_at()
        if reply is None:
            self._kept = self._same = None
        elif reply is not self._same:
            self._kept = self._octets(telegram, reply)
            self._same = reply if reply is self._reply else None
        octets = self._tx = self._kept
        if octets is None or self._unread is None or self._unread or self._events:
            return self._deadline()
        at = end + self._t_sdr_ns
        return at if at < due else due

    def _deadline(self) -> int:
        if self._unread is None or self._unread or self._events:
            return NOW
        return self.wake_at()

    def _take_all_events(self) -> list[Event]:
        events = [*self._events, *self.responder.take_events()]
        self._events = []
        self.take_events = self.responder.take_events
        return events

    # --- answers ---
    def process(self, telegram: Telegram, now: int) -> None:
        """Process a received telegram. The caller has set the end of the telegram in ``line``."""
        # the sender of a new telegram no longer waits for the earlier answer
        if self._tx is not None:
            self.drop()
        fc = telegram.fc
        if fc < 0 or not fc & FC_REQUEST:
            if self._overhear is not None and telegram.da == BROADCAST and fc >= 0:
                self._pass_on(self._overhear, telegram, now)
            return
        stub = self.stub
        if stub is not None and not stub.hears(telegram, now):
            return
        da = telegram.da
        if da == self.address:
            if telegram.sa != da and telegram.dseg is telegram.sseg is None:
                octets = self._answer(telegram, fc, now)
                if stub is not None and octets is not None:
                    octets = stub.answer(octets, now)
                self._tx = octets
                self._asked_at = now
        elif da == BROADCAST and fc & FC_FUNCTION in _TO_ALL:
            self._indicate(telegram, now)

    def _pass_on(self, overhear: Callable[[Telegram, int], None], telegram: Telegram, now: int) -> None:
        """Give the answer of another station to all to the application."""
        if telegram.sa != self.address and (self.stub is None or self.stub.hears(telegram, now)):
            overhear(telegram, now)
            self.due = self.responder.wake_at()

    def _answer(self, telegram: Telegram, fc: int, now: int) -> bytes | None:
        """The answer to a request to this station in octets; None: it stays silent."""
        function = fc & FC_FUNCTION
        sa = telegram.sa
        if not telegram.data and telegram.empty_le3 and sa not in self._reported_le3:
            self._reported_le3.add(sa)
            self._events.append(le3_notice(f"station {self.address}", sa, now))
            self.take_events = self._take_all_events
        if fc & FC_FCB == self._kept_fcb and sa == self._kept_sa and fc & FC_FCV and function in COUNTED:
            # docs/reference/protocol.md#frame-count-bit: same requester, same FCB: the answer was lost. Repeat the
            # answer without another call of the application.
            self._stats.repeats += 1
            return self._kept
        last = self._last
        self._forget_kept()  # the next telegram to this station ends the validity of the kept answer
        if function in _SERVED or (function == _MSRD and self._takes_msrd):
            self._requests += 1
            responder = self.responder
            reply = responder.serve(telegram, now)
            self.due = responder.wake_at()
        elif function in _REFUSED:
            reply = RS_REPLY
        elif function == Req.FDL_STATUS:
            self._stats.status += 1
            return encode_sd1(sa, telegram.da, Resp.OK)
        else:
            if function in _UNCONFIRMED:
                self._indicate(telegram, now)
            return None
        to = (sa, telegram.da, telegram.ssap, telegram.dsap)
        if reply is self._reply and to == self._reply_to and function != _MSRD:
            octets: bytes | None = self._reply_octets
        elif reply is None:
            octets = None
        else:
            octets = self._octets(telegram, reply)
        if fc & (FC_FCV | FC_FCB) and self.address == telegram.da:
            # FCV = 0 with FCB = 1 starts the count; a request from another SA is new whatever its FCB
            self._kept = octets
            self._kept_sa = sa
            self._kept_fcb = fc & FC_FCB
            if fc & FC_FCV and function in COUNTED:
                self._last = telegram
                self._same = reply if reply is self._reply else None
                if last is not None and replace(last, fc=last.fc ^ FC_FCB) == telegram:
                    self._again = last
        return octets

    def _indicate(self, telegram: Telegram, now: int) -> None:
        self._stats.indications += 1
        self.responder.indicate(telegram, now)
        self.due = self.responder.wake_at()

    def _octets(self, request: Telegram, reply: Reply) -> bytes:
        """The answer in octets: SC or SD1 for an answer without data, else SD2 with the SAPs exchanged."""
        status, data, short = reply
        if short:
            return SC_OCTETS
        da = request.sa
        sa = request.da
        if self._takes_msrd and request.fc & FC_FUNCTION == _MSRD and (status is _DL or status is _DH):
            da = BROADCAST
        if data or status is _DL or status is _DH:
            self._reply = reply
            self._reply_to = (da, sa, request.ssap, request.dsap)
            self._reply_octets = request_octets(da, sa, status, data, request.ssap, request.dsap)
            return self._reply_octets
        if status is not Resp.OK:
            self._stats.refused += 1
        return encode_sd1(da, sa, status)

    def _forget(self) -> None:
        super()._forget()
        self._tx = None
        self._forget_kept()

    def _forget_kept(self) -> None:
        self._kept_sa = -1
        self._last = self._again = None
