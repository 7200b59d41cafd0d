"""The service access points of an active station: answers to other masters, indications, reply buffers.

A :class:`~dpstack.fdl.interface.ActiveResponder`. Everything it needs for an answer is here before the request comes:
the program is asked nothing, so nothing that it does changes the answer or its time. Which confirmation the requester
gets: docs/reference/fdl-services.md#saps.
"""

from __future__ import annotations

from typing import Final

from msgspec import Struct

from dpstack.errors import UsageError
from dpstack.fdl.codec import SC_OCTETS, encode_sd1, request_octets
from dpstack.fdl.services.confirmations import FdlService
from dpstack.fdl.services.identity import Ident
from dpstack.fdl.services.orders import (
    MAX_QUEUE,
    CloseSap,
    FdlIndicated,
    OpenSap,
    TakenIndications,
    UpdateReply,
    data_limit,
    sap_name,
)
from dpstack.fdl.telegram import COUNTED, FC_FCB, FC_FCV, FC_FUNCTION, Req, Resp, StationType, Telegram
from dpstack.params import BROADCAST, MAX_STATION
from dpstack.trace import Event

#: DSAP of an SDN to all SAPs of a station
ALL_SAPS: Final = 63
#: SAPs that DP gives its services at a master; beside a DP master they are its own
DP_SAPS: Final = range(48, 63)
_IN_RING: Final = StationType.MASTER_IN_RING << 4
_SDA: Final = frozenset((int(Req.SDA_LOW), int(Req.SDA_HIGH)))
_SRD: Final = frozenset((int(Req.SRD_LOW), int(Req.SRD_HIGH)))
_HIGH: Final = frozenset((int(Req.SDA_HIGH), int(Req.SDN_HIGH), int(Req.SRD_HIGH)))
_COUNTED: Final = frozenset(map(int, COUNTED))
_ANSWERED: Final = frozenset((int(Req.SDA_LOW), int(Req.SDA_HIGH), int(Req.SRD_LOW), int(Req.SRD_HIGH)))


class _Sap(Struct, eq=False):
    """An activated SAP: its access, what waits for the program, its reply data."""

    order: OpenSap
    waiting: int = 0
    lost: int = 0
    reply: bytes | None = None
    reply_high: bool = False
    reply_once: bool = False

    def admits(self, service: FdlService, sa: int, ssap: int | None) -> bool:
        order = self.order
        return (
            service in order.services
            and (order.access is None or order.access == sa)
            and (order.access_sap is None or order.access_sap == ssap)
        )

    @property
    def full(self) -> bool:
        return self.waiting >= self.order.queue


class SapTable:
    """The SAPs of the station ``own``. Its indications are added to ``events``."""

    def __init__(self, own: int, events: list[Event], ident: Ident) -> None:
        self._own = own
        self._events = events
        self._ident = ident.build()
        self._saps: dict[int | None, _Sap] = {}
        self._closed: set[int | None] = set()
        #: beside a DP master its SAPs cannot be opened
        self.guarded = False
        # the kept answer for repetitions (docs/reference/protocol.md#frame-count-bit)
        self._kept: bytes | None = None
        self._kept_sa = -1
        self._kept_fcb = 0
        #: requests answered with the kept answer
        self.repeats = 0
        #: requests answered with RS or RR
        self.refused = 0

    # --- orders -------------------------------------------------------------------------------------------------
    def command(self, order: OpenSap | CloseSap | UpdateReply | TakenIndications) -> None:
        """Carry out an order. Raises UsageError."""
        match order:
            case OpenSap():
                self._open(order)
            case CloseSap(number):
                if self._saps.pop(number, None) is not None:
                    self._closed.add(number)
            case UpdateReply(number, data, high, once):
                sap = self._find(number)
                if data is not None and len(data) > data_limit(number, number):
                    raise UsageError(
                        f"{sap_name(number)}: {len(data)} octets of reply data; {data_limit(number, number)} fit"
                    )
                sap.reply, sap.reply_high, sap.reply_once = data, high, once
            case TakenIndications(number, count):
                taken = self._saps.get(number)
                if taken is not None:
                    taken.waiting = max(0, taken.waiting - count)

    def _open(self, order: OpenSap) -> None:
        number = order.number
        if number is not None and not 0 <= number < ALL_SAPS:
            raise UsageError(f"SAP {number}: a station's own SAPs are 0..62, or None for the default SAP")
        if self.guarded and number in DP_SAPS:
            raise UsageError(f"SAP {number} belongs to the DP master of this station (48 to 62 do): take 0..47")
        if number in self._saps:
            raise UsageError(f"{sap_name(number)} is in use already on this station: close it first, or take another")
        if order.access is not None and not 0 <= order.access <= MAX_STATION:
            raise UsageError(f"{sap_name(number)}: access by station {order.access}; stations are 0..{MAX_STATION}")
        if not 1 <= order.queue <= MAX_QUEUE:
            raise UsageError(f"{sap_name(number)}: a queue of {order.queue}; 1..{MAX_QUEUE} indications may wait")
        self._saps[number] = _Sap(order)
        self._closed.discard(number)

    def _find(self, number: int | None) -> _Sap:
        sap = self._saps.get(number)
        if sap is None:
            raise UsageError(f"{sap_name(number)} is not open on this station")
        return sap

    def is_deactivated(self, number: int | None) -> bool:
        """Whether the program has closed the SAP: nothing can be sent from it then. (One never opened may send.)"""
        return number in self._closed

    # --- responder ----------------------------------------------------------------------------------------------
    def forget(self) -> None:
        """The kept answer is no longer valid: another telegram came to this station, or the station left the bus."""
        self._kept_sa = -1

    def answer(self, request: Telegram, now: int) -> bytes | None:
        """The octets of the answer to a ``request`` to this station, other than FDL status; None: it stays silent."""
        fc, sa = request.fc, request.sa
        function = fc & FC_FUNCTION
        if fc & FC_FCB == self._kept_fcb and sa == self._kept_sa and fc & FC_FCV and function in _COUNTED:
            self.repeats += 1
            return self._kept
        self._kept_sa = -1
        octets = self._new_answer(request, function, now)
        if fc & (FC_FCB | FC_FCV) and function in _COUNTED:
            self._kept, self._kept_sa, self._kept_fcb = octets, sa, fc & FC_FCB
        return octets

    def _new_answer(self, request: Telegram, function: int, now: int) -> bytes | None:
        if request.dseg is not None or request.sseg is not None:
            return None  # to another segment
        if function == Req.IDENT:
            return request_octets(request.sa, self._own, _IN_RING | Resp.DL, self._ident, None, None)
        if function not in _ANSWERED:
            return self._refuse(request, Resp.RS)
        service = FdlService.SDA if function in _SDA else FdlService.SRD
        sap = self._saps.get(request.dsap)
        if sap is None or not sap.admits(service, request.sa, request.ssap):
            return self._refuse(request, Resp.RS)
        if service is FdlService.SRD:
            return self._reply(sap, request, function in _HIGH, now)
        if sap.full:
            return self._refuse(request, Resp.RR)
        self._indicate(sap, service, request, function in _HIGH, now)
        return SC_OCTETS

    def _refuse(self, request: Telegram, status: Resp) -> bytes:
        self.refused += 1
        return encode_sd1(request.sa, self._own, _IN_RING | status)

    def _reply(self, sap: _Sap, request: Telegram, high: bool, now: int) -> bytes:
        """The answer to an SRD: the reply data, or NR. If the queue has no room for the data of the request: RDL, RDH,
        RR."""
        reply, reply_high = sap.reply, sap.reply_high
        indicated = bool(request.data or reply) or sap.order.indicate_all
        refused = bool(request.data) and sap.full
        if reply is not None and len(reply) > data_limit(request.ssap, request.dsap):
            return self._refuse(request, Resp.UE)  # to the default SAP, from a SAP: one octet less fits
        if reply is None:
            if refused:
                return self._refuse(request, Resp.RR)
            status = Resp.NR
        elif refused:
            status = Resp.RDH if reply_high else Resp.RDL
        else:
            status = Resp.DH if reply_high else Resp.DL
        if reply is not None and sap.reply_once:
            sap.reply = None
        if indicated and not sap.full:
            self._indicate(sap, FdlService.SRD, request, high, now, replied=reply)
        fc = _IN_RING | status
        if reply is None:
            return encode_sd1(request.sa, self._own, fc)
        return request_octets(request.sa, self._own, fc, reply, request.ssap, request.dsap)

    def indicate(self, telegram: Telegram, now: int) -> None:
        """An SDN to this station, or to all. Nobody learns of one for which there is no SAP or no room."""
        function = telegram.fc & FC_FUNCTION
        if telegram.da == self._own:
            self._kept_sa = -1
        if telegram.dseg is not None or telegram.sseg is not None:
            return
        high = function in _HIGH
        if telegram.dsap == ALL_SAPS:
            saps = list(self._saps.values())
        else:
            sap = self._saps.get(telegram.dsap)
            saps = [] if sap is None else [sap]
        for sap in saps:
            if not sap.admits(FdlService.SDN, telegram.sa, telegram.ssap):
                continue
            if sap.full:
                sap.lost += 1
            else:
                self._indicate(sap, FdlService.SDN, telegram, high, now)

    def _indicate(
        self, sap: _Sap, service: FdlService, telegram: Telegram, high: bool, now: int, replied: bytes | None = None
    ) -> None:
        sap.waiting += 1
        lost, sap.lost = sap.lost, 0
        self._events.append(
            FdlIndicated(
                t_ns=now,
                sap=sap.order.number,
                service=service,
                source=telegram.sa,
                source_sap=telegram.ssap,
                data=telegram.data,
                high=high,
                broadcast=telegram.da == BROADCAST,
                replied=replied,
                lost=lost,
            )
        )
