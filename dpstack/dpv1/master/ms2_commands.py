"""Orders to the class 2 connections (MS2) of a master, and what is told of them. Plain data; times in ns.

A connection is named by the token of the order that opened it. Who asks for what may be done with one is
:mod:`dpstack.dpv1.master.ms2`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from dpstack.dp.acyclic.job import ServiceEnd
from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.dpv1.pdu.ms2 import FEATURES
from dpstack.dpv1.pdu.read_write import Function
from dpstack.dpv1.timeouts import SERVICE_TIMEOUT, least_send_timeout
from dpstack.machine import Order
from dpstack.trace import Event

#: what is asked for where nobody says another send time-out
SEND_TIMEOUT: Final = least_send_timeout(500_000)


@dataclass(frozen=True, slots=True)
class OpenConnection(Order):
    """Open a connection to the slave at ``address`` (Initiate); its end is the InitiateDone with ``token``.

    ``send_timeout_ns``: asked for (the slave may have a longer one); ``response_ns``: in which the slave answers a
    service (C2_Response_Timeout), 0: not known. ``profile_features``, ``profile_ident``, ``source`` and ``destination``
    (API, access level, then up to 6 octets of network address and the MAC address) as in Initiate. ``channels``: how
    many connections the slave has (C2_Max_Count_Channels), 0: not known.
    """

    token: int
    address: int
    send_timeout_ns: int = SEND_TIMEOUT
    response_ns: int = 0
    features: int = FEATURES
    profile_features: int = 0
    profile_ident: int = 0
    source: bytes = bytes(2)
    destination: bytes = bytes(2)
    channels: int = 0
    timeout_ns: int = SERVICE_TIMEOUT


@dataclass(frozen=True, slots=True)
class ReadOver(Order):
    """Read up to ``length`` octets of a record over ``connection``; its end is the RecordDone with ``token``."""

    token: int
    connection: int
    slot: int
    index: int
    length: int = MAX_RECORD
    timeout_ns: int = SERVICE_TIMEOUT


@dataclass(frozen=True, slots=True)
class WriteOver(Order):
    """Write ``data``, otherwise as :class:`ReadOver`."""

    token: int
    connection: int
    slot: int
    index: int
    data: bytes
    timeout_ns: int = SERVICE_TIMEOUT


@dataclass(frozen=True, slots=True)
class TransportOver(Order):
    """Data_Transport of ``data`` over ``connection``; its end is the TransportDone with ``token``."""

    token: int
    connection: int
    slot: int
    index: int
    data: bytes
    timeout_ns: int = SERVICE_TIMEOUT


@dataclass(frozen=True, slots=True)
class CloseConnection(Order):
    """Abort ``connection``, also one that is being opened; services over it end. One that is over is no error."""

    ENDS = True

    connection: int


@dataclass(frozen=True, slots=True)
class CloseConnections(Order):
    """Abort all of them, then tell ConnectionsClosed: for the end of a bus."""

    ENDS = True


@dataclass(frozen=True, slots=True, kw_only=True)
class InitiateDone(ServiceEnd):
    """The one end of OpenConnection. Without a failure the connection is open: its server SAP in the slave, the send
    time-out that counts, and what the slave said in Initiate (``max_len``: octets of data in one service)."""

    server_sap: int = 0
    send_timeout_ns: int = 0
    max_len: int = 0
    features: int = 0
    profile_features: int = 0
    profile_ident: int = 0

    @property
    def title(self) -> str:
        """The standard's name."""
        return Function.INITIATE.title

    @property
    def result(self) -> str:
        return f"class 2 connection open, server SAP {self.server_sap}"


@dataclass(frozen=True, slots=True, kw_only=True)
class TransportDone(ServiceEnd):
    """The one end of a Data_Transport; the data that came back are in ``outcome``. ``stale`` as in RecordDone."""

    slot: int
    index: int
    stale: int = 0

    @property
    def title(self) -> str:
        """The standard's name."""
        return Function.DATA_TRANSPORT.title

    @property
    def result(self) -> str:
        """How many octets came back."""
        return f"{self.title} of slot {self.slot}, index {self.index}, {len(self.outcome.data)} octets"


@dataclass(frozen=True, slots=True, kw_only=True)
class ConnectionOver(Event):
    """The one end of a connection that was open, told when it is given back: ``reason`` says who ended it and why.

    ``abort``: subnet, instance and reason of the Abort that the slave sent, or that it was sent; None without any.
    ``ordered``: by whoever opened it.
    """

    connection: int
    address: int
    server_sap: int
    reason: str
    abort: tuple[int, int, int] | None = None
    ordered: bool = False

    OWED = True

    TEMPLATE = "slave {e.address}: class 2 connection (server SAP {e.server_sap}) is over: {e.reason}"


@dataclass(frozen=True, slots=True, kw_only=True)
class ConnectionsClosed(Event):
    """The end of CloseConnections: no slave holds anything for this master any more, as far as could be done."""

    OWED = True
    TEMPLATE = "no class 2 connection is open any more"
