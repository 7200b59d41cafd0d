"""Orders of a program to the FDL services of an active station, and the events that answer them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dpstack.fdl.services.confirmations import Confirmation, FdlService
from dpstack.machine import Order
from dpstack.params import BROADCAST
from dpstack.trace import Event

#: requests that may wait at a time
CAPACITY: Final = 32
#: indications of one SAP that may wait for the program at a time
MAX_QUEUE: Final = 256


def sap_name(number: int | None) -> str:
    """A SAP in a text."""
    return "the default SAP" if number is None else f"SAP {number}"


class FdlRequest(Order):
    """Send one request; :class:`FdlConfirmed` with the same ``token`` is its one end.

    ``address`` 0..126, of SDN 127 too; ``dsap`` and ``ssap`` 0..63 (63 only of SDN, as DSAP), None: the default SAP.
    ``timeout_ns``: how long it may wait for its turn. ``reply_max``: the longest reply data, in octets; None: as
    many as fit.
    """

    token: int
    service: FdlService
    address: int
    data: bytes = b""
    dsap: int | None = None
    ssap: int | None = None
    high: bool = False
    timeout_ns: int = 0
    reply_max: int | None = None


class CancelFdl(Order):
    """Forget the request with ``token`` if it has not been sent, because no program waits for it."""

    ENDS = True

    token: int


class OpenSap(Order):
    """Activate the SAP ``number`` (0..62; None: the default SAP). Raises UsageError if it is open already.

    ``services``: SDA, SDN and SRD as far as it takes them. ``access`` and ``access_sap``: the only station, and the
    only SAP there, that may use it. ``queue``: indications that may wait for the program. ``indicate_all``: an SRD
    without data in request and reply is indicated, too (Indication_mode).
    """

    number: int | None
    services: tuple[FdlService, ...]
    access: int | None = None
    access_sap: int | None = None
    queue: int = CAPACITY
    indicate_all: bool = False


class CloseSap(Order):
    """Deactivate a SAP; one that is not open is no error."""

    ENDS = True

    number: int | None


class UpdateReply(Order):
    """Set the reply data of a SAP for SRD (FDL_REPLY_UPDATE). ``data`` None: none. ``once``: for one reply (Single)."""

    number: int | None
    data: bytes | None
    high: bool = False
    once: bool = False


class TakenIndications(Order):
    """The program has taken ``count`` indications of a SAP: so many more may wait."""

    number: int | None
    count: int


class FdlConfirmed(Event):
    """The confirmation of the request with ``token``."""

    token: int
    #: the service
    service: FdlService
    #: station address of the request, 0..127
    address: int
    #: the result
    status: Confirmation
    #: data of the answer
    data: bytes = b""
    #: station type in the answer, 0..3 (:class:`~dpstack.fdl.telegram.StationType`); None without an answer
    kind: int | None = None
    #: more about the result, for people
    remark: str = ""

    MUST_ARRIVE = True

    def _text(self) -> str:
        more = f" ({self.remark})" if self.remark else ""
        octets = f": {self.data.hex(' ').upper()}" if self.data else ""
        return f"{self.service.value} to station {self.address}: {self.status.value}, {self.status.text}{more}{octets}"


class FdlIndicated(Event):
    """Another station has used a SAP of this station."""

    #: the own SAP; None: the default SAP
    sap: int | None
    #: SDA, SDN or SRD
    service: FdlService
    #: station address of the requester, 0..126
    source: int
    #: its SAP; None: the default SAP
    source_sap: int | None
    #: data of the request, 0..246 octets
    data: bytes
    #: the request had high priority
    high: bool
    #: the telegram was sent to all stations (127)
    broadcast: bool = False
    #: of SRD: the reply data that were sent; None: none
    replied: bytes | None = None
    #: SDN telegrams to this SAP that were lost before this one, because the queue was full
    lost: int = 0

    MUST_ARRIVE = True

    def _text(self) -> str:
        to = "all" if self.broadcast else sap_name(self.sap)
        octets = self.data.hex(" ").upper() or "no data"
        return f"{self.service.value} of station {self.source} to {to}: {octets}"


#: why a request must not be sent beside a DP master of the same station; None if it may
FdlGuard = Callable[[FdlRequest], str | None]


def data_limit(dsap: int | None, ssap: int | None) -> int:
    """The number of data octets that fit beside the SAPs: 246, less one for each."""
    return 246 - (dsap is not None) - (ssap is not None)


def fault_of(order: FdlRequest, own: int) -> str:
    """The parameter of ``order`` that cannot be, for people; empty if all can be. ``own``: address of this station."""
    last = BROADCAST if order.service is FdlService.SDN else BROADCAST - 1
    if not 0 <= order.address <= last:
        return f"address {order.address}: {order.service.value} goes to 0..{last}"
    if order.address == own:
        return f"address {own} is that of this station"
    for name, sap, highest in (
        ("dsap", order.dsap, 63 if order.service is FdlService.SDN else 62),
        ("ssap", order.ssap, 62),
    ):
        if sap is not None and not 0 <= sap <= highest:
            return f"{name} {sap}: {order.service.value} has 0..{highest}, or None for the default SAP"
    limit = data_limit(order.dsap, order.ssap)
    if len(order.data) > limit:
        return f"{len(order.data)} octets of data: {limit} fit into a telegram with these SAPs"
    return ""
