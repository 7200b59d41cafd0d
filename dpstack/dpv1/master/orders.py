"""Orders of programs to the DP-V1 services of a master, and the events that answer them. Plain data; times in ns.

A class 2 connection is named by the token of the order that opened it. The machines that carry the orders out:
:mod:`dpstack.dpv1.master.ms1`, :mod:`dpstack.dpv1.master.ms2`, :mod:`dpstack.dpv1.master.alarm_handler`.
"""

from __future__ import annotations

from typing import Final

from dpstack.dp.acyclic.job import Outcome, ServiceEnd
from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.dpv1.pdu.ms2 import InitiateReq
from dpstack.dpv1.pdu.read_write import DataTransport, Function, ReadReq, Service, WriteReq
from dpstack.dpv1.timeouts import SERVICE_TIMEOUT, least_send_timeout
from dpstack.machine import Order
from dpstack.text import octets_text

#: Initiate with the send time-out to ask for by default
_USUAL_REQUEST: Final = InitiateReq(least_send_timeout(500_000))


# --- Read, Write, Data_Transport ---------------------------------------------------------------------------------


class RecordOrder(Order):
    """Read up to ``length`` octets of a record, or send ``data`` by Write or Data_Transport (``function``).

    The order has either the ``address`` of a slave of this master (MS1, without Data_Transport) or the token of a class
    2 ``connection``. Its end is the :class:`RecordDone` with ``token``. ``timeout_ns`` counts from the order; the
    slave's own time-out counts from the request. ``user``: the users of record 47 of a slave take turns; 0 for all
    programs without a number of their own.
    """

    token: int
    function: Function
    slot: int
    index: int
    length: int = MAX_RECORD
    data: bytes = b""
    timeout_ns: int = SERVICE_TIMEOUT
    address: int | None = None
    connection: int | None = None
    user: int = 0

    @property
    def service(self) -> Service:
        match self.function:
            case Function.READ:
                return ReadReq(self.slot, self.index, self.length)
            case Function.WRITE:
                return WriteReq(self.slot, self.index, self.data)
            case _:
                return DataTransport(self.slot, self.index, self.data)


class RecordDone(ServiceEnd):
    """The one end of a RecordOrder; the data that the slave sent are in ``outcome``.

    ``stale``: number of answers to other requests that came before it.
    """

    function: Function
    slot: int
    index: int
    stale: int = 0

    @classmethod
    def of(cls, service: Service, token: int, address: int, outcome: Outcome, stale: int, now: int) -> RecordDone:
        return cls(
            t_ns=now,
            token=token,
            address=address,
            function=service.function,
            slot=service.slot,
            index=service.index,
            outcome=outcome,
            stale=stale,
        )

    @property
    def title(self) -> str:
        return self.function.title

    @property
    def record(self) -> tuple[int, int]:
        """Slot and index."""
        return self.slot, self.index

    @property
    def result(self) -> str:
        """The record, and the number of octets that came."""
        where = f"{self.title} of slot {self.slot}, index {self.index}"
        return f"{where} done" if self.function is Function.WRITE else f"{where}, {octets_text(len(self.outcome.data))}"


# --- class 2 connections -----------------------------------------------------------------------------------------


class OpenConnection(Order):
    """Open a connection to the slave at ``address`` by the Initiate ``request``; its end is the InitiateDone with
    ``token``. The slave may have a longer send time-out than that in the request.

    ``response_ns``: the time in which the slave answers a service (C2_Response_Timeout), 0: not known. ``channels``:
    number of connections that the slave has (C2_Max_Count_Channels), 0: not known.
    """

    token: int
    address: int
    request: InitiateReq = _USUAL_REQUEST
    response_ns: int = 0
    channels: int = 0
    timeout_ns: int = SERVICE_TIMEOUT


class InitiateDone(ServiceEnd):
    """The one end of OpenConnection. Without a failure the connection is open: its server SAP in the slave, the send
    time-out that counts, and the slave's answer to Initiate (``max_len``: octets of data in one service)."""

    server_sap: int = 0
    send_timeout_ns: int = 0
    max_len: int = 0
    profile_ident: int = 0

    @property
    def title(self) -> str:
        return Function.INITIATE.title

    @property
    def result(self) -> str:
        return f"class 2 connection open, server SAP {self.server_sap}"
