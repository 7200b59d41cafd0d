"""FDL services of a requester: the FC octet of each, and the match of a telegram with a request."""

from __future__ import annotations

from typing import Final

from msgspec import Struct

from dpstack.fdl.interface import Request
from dpstack.fdl.telegram import COUNTED, UNANSWERED, Kind, Req, Resp, Telegram


class Service(Struct, frozen=True):
    """``counted``: it carries FCB and FCV, and SC can answer it."""

    fc: int
    counted: bool
    answered: bool


#: FDL status, ident, LSAP status and SDN carry FCV = 0 and FCB = 0 (docs/reference/protocol.md#frame-count-bit)
SERVICES: Final[dict[Req, Service]] = {
    function: Service(
        0xC0 if function is Req.CLOCK_VALUE else 0x40 | function, function in COUNTED, function not in UNANSWERED
    )
    for function in Req
}
# an enum's member costs ten times a name of the module
_SC: Final = Kind.SC
_FDL_STATUS: Final = Req.FDL_STATUS
#: negative acknowledgements, and the positive one without data
_WITHOUT_DATA: Final = frozenset({int(Resp.OK), int(Resp.UE), int(Resp.RR), int(Resp.RS), int(Resp.NR)})


def answers(request: Request, telegram: Telegram) -> bool:
    """Whether ``telegram``, sent to this station or SC, can answer ``request``."""
    if telegram.sa != request.da:
        return telegram.kind is _SC and SERVICES[request.function].counted
    if request.function is _FDL_STATUS:
        return not telegram.data and telegram.dsap is telegram.ssap is None
    if telegram.ssap == request.dsap and telegram.dsap == request.ssap:
        return True
    # refused, or acknowledged without data: SD1 has no room for SAPs
    return not telegram.data and telegram.dsap is telegram.ssap is None and telegram.function in _WITHOUT_DATA


def same_answer(one: Request, other: Request) -> bool:
    """Whether one telegram can answer both requests: from the same station, or SC."""
    return one.da == other.da or (SERVICES[one.function].counted and SERVICES[other.function].counted)
