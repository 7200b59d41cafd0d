"""The services of FDL and the table of their confirmations (L_status).

The table with its sources: docs/reference/fdl-services.md#confirmations.
"""

from __future__ import annotations

from enum import Enum
from typing import Final

from dpstack.fdl.interface import Failure
from dpstack.fdl.telegram import Kind, Req, Telegram


class FdlService(Enum):
    """A service of FDL that a program can order."""

    #: Send Data with Acknowledge
    SDA = "SDA"
    #: Send Data with No Acknowledge
    SDN = "SDN"
    #: Send and Request Data
    SRD = "SRD"
    #: Send and Request Data with multicast reply
    MSRD = "MSRD"
    #: Request FDL Status
    FDL_STATUS = "FDL_STATUS"
    #: Request Ident
    IDENT = "IDENT"
    #: Request LSAP Status
    LSAP_STATUS = "LSAP_STATUS"


class Confirmation(Enum):
    """The result of a service (L_status of the standard). The first nine are answers of the remote station."""

    #: positive: the service was carried out
    OK = "OK"
    #: the remote user has an error
    UE = "UE"
    #: the remote station has no resources for the data
    RR = "RR"
    #: the SAP, the service at it or this station is not activated there
    RS = "RS"
    #: reply data of low priority; the remote station has taken the data of the request
    DL = "DL"
    #: the data of the request were taken; there are no reply data
    NR = "NR"
    #: reply data of high priority; the data of the request were taken
    DH = "DH"
    #: reply data of low priority; the data of the request were not taken
    RDL = "RDL"
    #: reply data of high priority; the data of the request were not taken
    RDH = "RDH"
    #: the local SAP, or the service at it, is not activated
    LS = "LS"
    #: this station has no resources: its queue is full, or no token hold had time
    LR = "LR"
    #: no answer of the remote station, or none that can be one
    NA = "NA"
    #: this station is not in the token ring, or its port is gone
    DS = "DS"
    #: invalid parameters in the request
    IV = "IV"

    @property
    def text(self) -> str:
        """The confirmation in words."""
        return _TEXTS[self]

    @property
    def is_local(self) -> bool:
        """True for a result that this station found itself: LS, LR, DS and IV send nothing, NA had no answer."""
        return self in LOCAL

    def is_positive(self, service: FdlService) -> bool:
        """True if the remote station has carried out ``service`` (SDN: if it was sent). NR is positive for SRD and
        MSRD: the station has taken the data; Ident and LSAP status have no result then."""
        return self is _OK or (service in _WITH_REPLY and self in _TAKEN)

    @property
    def is_temporary(self) -> bool:
        """True if the standard says that a repetition may succeed."""
        return self in _TEMPORARY


_OK: Final = Confirmation.OK
_TAKEN: Final = frozenset((Confirmation.DL, Confirmation.DH, Confirmation.NR))
LOCAL: Final = frozenset((Confirmation.LS, Confirmation.LR, Confirmation.NA, Confirmation.DS, Confirmation.IV))
_TEMPORARY: Final = frozenset(
    (Confirmation.RR, Confirmation.RDL, Confirmation.RDH, Confirmation.LR, Confirmation.NA, Confirmation.NR)
)
_TEXTS: Final = {
    Confirmation.OK: "done",
    Confirmation.UE: "the remote user has an error (a controller in STOP, for instance)",
    Confirmation.RR: "the remote station has no room for the data now: try again",
    Confirmation.RS: "the SAP, the service at it or this station is not activated there",
    Confirmation.DL: "reply data, low priority",
    Confirmation.NR: "taken; there are no reply data",
    Confirmation.DH: "reply data, high priority",
    Confirmation.RDL: "reply data, low priority; the data of the request were not taken: try again",
    Confirmation.RDH: "reply data, high priority; the data of the request were not taken: try again",
    Confirmation.LS: "the own SAP, or the service at it, is not activated",
    Confirmation.LR: "this station has no room or no time for it now: try again",
    Confirmation.NA: "no answer, or none that can be one",
    Confirmation.DS: "this station is not in the token ring, or its port is gone",
    Confirmation.IV: "invalid parameters",
}

_LOCAL_OF_ALL: Final = frozenset((Confirmation.LR, Confirmation.DS, Confirmation.IV))
_ACKNOWLEDGED: Final = frozenset(
    (_OK, Confirmation.UE, Confirmation.RR, Confirmation.RS, Confirmation.LS, Confirmation.NA)
)
_REPLIED: Final = frozenset(
    (
        Confirmation.DL,
        Confirmation.DH,
        Confirmation.NR,
        Confirmation.RDL,
        Confirmation.RDH,
        Confirmation.UE,
        Confirmation.RR,
        Confirmation.RS,
        Confirmation.LS,
        Confirmation.NA,
    )
)
#: The confirmations that each service may have. (SC answers an SRD whose data were taken, without reply data: NR.)
ALLOWED: Final[dict[FdlService, frozenset[Confirmation]]] = {
    FdlService.SDA: _ACKNOWLEDGED | _LOCAL_OF_ALL,
    FdlService.SDN: frozenset((_OK, Confirmation.LS)) | _LOCAL_OF_ALL,
    FdlService.SRD: _REPLIED | _LOCAL_OF_ALL,
    FdlService.MSRD: _REPLIED | _LOCAL_OF_ALL,
    FdlService.FDL_STATUS: frozenset((_OK, Confirmation.NA)) | _LOCAL_OF_ALL,
    FdlService.IDENT: frozenset((_OK, Confirmation.NR, Confirmation.NA)) | _LOCAL_OF_ALL,
    FdlService.LSAP_STATUS: frozenset((_OK, Confirmation.RS, Confirmation.NR, Confirmation.NA)) | _LOCAL_OF_ALL,
}

#: function code of each service with low and with high priority
FUNCTIONS: Final[dict[FdlService, tuple[Req, Req]]] = {
    FdlService.SDA: (Req.SDA_LOW, Req.SDA_HIGH),
    FdlService.SDN: (Req.SDN_LOW, Req.SDN_HIGH),
    FdlService.SRD: (Req.SRD_LOW, Req.SRD_HIGH),
    FdlService.MSRD: (Req.MSRD, Req.MSRD),
    FdlService.FDL_STATUS: (Req.FDL_STATUS, Req.FDL_STATUS),
    FdlService.IDENT: (Req.IDENT, Req.IDENT),
    FdlService.LSAP_STATUS: (Req.LSAP_STATUS, Req.LSAP_STATUS),
}
#: services with SAPs and data of the program
WITH_DATA: Final = frozenset((FdlService.SDA, FdlService.SDN, FdlService.SRD, FdlService.MSRD))
#: services that answer with data, although their only positive confirmation is OK
_READING: Final = frozenset((FdlService.IDENT, FdlService.LSAP_STATUS))
_WITH_REPLY: Final = frozenset((FdlService.SRD, FdlService.MSRD))
_BY_STATUS: Final = {
    0: Confirmation.OK,
    1: Confirmation.UE,
    2: Confirmation.RR,
    3: Confirmation.RS,
    8: Confirmation.DL,
    9: Confirmation.NR,
    10: Confirmation.DH,
    12: Confirmation.RDL,
    13: Confirmation.RDH,
}
_BY_FAILURE: Final = {
    Failure.NO_ANSWER: Confirmation.NA,
    Failure.GARBLED: Confirmation.NA,
    Failure.WRONG: Confirmation.NA,
    Failure.ABANDONED: Confirmation.DS,
    Failure.REFUSED: Confirmation.IV,
    Failure.HELD_BACK: Confirmation.LR,
}


def confirmation_of(service: FdlService, outcome: Telegram | Failure) -> tuple[Confirmation, str]:
    """The confirmation of ``service`` whose request ended with ``outcome``, and a remark for people (may be empty).

    A status that the clause of the service does not allow is no plausible reaction: NA, and the remark names it.
    """
    if isinstance(outcome, Failure):
        return _BY_FAILURE[outcome], outcome.value if outcome is not Failure.NO_ANSWER else ""
    status = 0 if outcome.kind is Kind.SC else outcome.function
    found = _BY_STATUS.get(status)
    if service in _READING and found is Confirmation.DL:
        return Confirmation.OK, ""
    if service in _WITH_REPLY and found is Confirmation.OK:
        # SC, or OK without data: the data were taken, and there is no reply
        return (Confirmation.DL if outcome.data else Confirmation.NR), ""
    if service is FdlService.IDENT and found in (Confirmation.RS, Confirmation.UE):
        return Confirmation.NR, f"answered with {found.value}"
    if service is FdlService.LSAP_STATUS and found is Confirmation.UE:
        return Confirmation.NR, "answered with UE"
    if found is None or found not in ALLOWED[service]:
        name = f"status {status}" if found is None else found.value
        return Confirmation.NA, f"the answer {name} is none that {service.value} may have"
    return found, ""
