"""FDL telegrams as values: kinds, function codes, service access points. The codec turns them into octets and back."""

from __future__ import annotations

from enum import IntEnum
from typing import Final

from msgspec import Struct

from dpstack.text import NamedInt


class Kind(IntEnum):
    """The kinds of telegram; the value is the start octet (docs/reference/protocol.md#telegrams)."""

    SD1 = 0x10
    SD2 = 0x68
    SD3 = 0xA2
    SD4 = 0xDC
    SC = 0xE5


#: End delimiter of SD1, SD2 and SD3.
ED: Final = 0x16
#: LE of an SD2 telegram: DA, SA, FC and 1..246 octets of data unit.
MIN_LE: Final = 4
MAX_LE: Final = 249
#: Octets of data that fit beside both SAP octets.
MAX_DATA: Final = 244

# --- FC octet -------------------------------------------------------------------------------------------------------
FC_REQUEST: Final = 0x40
FC_FCB: Final = 0x20
FC_FCV: Final = 0x10
FC_FUNCTION: Final = 0x0F
#: bits of the FC of a Clock_Value besides its function 0
_CLOCK_VALUE_FC: Final = 0xC0


class Req(IntEnum):
    """Function of a request (FC bits 3..0 with bit 6 = 1). CLOCK_VALUE is function 0 with bit 7 set."""

    TIME_EVENT = 0
    SDA_LOW = 3
    SDN_LOW = 4
    SDA_HIGH = 5
    SDN_HIGH = 6
    MSRD = 7
    FDL_STATUS = 9
    SRD_LOW = 12
    SRD_HIGH = 13
    IDENT = 14
    LSAP_STATUS = 15
    CLOCK_VALUE = 0x80


#: requests that carry a frame count; SC can answer them
COUNTED: Final = frozenset((Req.SDA_LOW, Req.SDA_HIGH, Req.SRD_LOW, Req.SRD_HIGH, Req.MSRD))
#: requests without answer: SDN, time event, clock value
UNANSWERED: Final = frozenset((Req.SDN_LOW, Req.SDN_HIGH, Req.TIME_EVENT, Req.CLOCK_VALUE))


class Resp(IntEnum):
    """Status of a response (FC bits 3..0 with bit 6 = 0)."""

    OK = 0
    UE = 1
    RR = 2
    RS = 3
    DL = 8
    NR = 9
    DH = 10
    RDL = 12
    RDH = 13


class StationType(NamedInt):
    """Station type in a response's FC, bits 5..4."""

    SLAVE = 0
    MASTER_NOT_READY = 1
    MASTER_READY = 2
    MASTER_IN_RING = 3

    @property
    def text(self) -> str:
        return self.name.lower().replace("_", " ")


class Telegram(Struct, frozen=True):
    """A decoded telegram.

    ``fc`` is -1 for SD4 and SC; ``da`` and ``sa`` are 0..127 without the extension bit and -1 for SC. ``dsap`` and
    ``ssap`` are None when absent: SAP 0 is a SAP. ``dseg`` and ``sseg`` are the region/segment address octets
    (bits 5..0), None when absent. ``data`` is the data unit without the address extension octets.
    """

    kind: Kind
    da: int
    sa: int
    fc: int = -1
    dsap: int | None = None
    ssap: int | None = None
    data: bytes = b""
    dseg: int | None = None
    sseg: int | None = None

    @property
    def is_request(self) -> bool:
        """True for a request (FC bit 6); an answer has an FC without it, SC and the token have none."""
        return self.fc >= 0 and bool(self.fc & FC_REQUEST)

    @property
    def function(self) -> int:
        """FC bits 3..0: :class:`Req` of a request (CLOCK_VALUE apart) or :class:`Resp` of a response."""
        return self.fc & FC_FUNCTION

    @property
    def is_clock_value(self) -> bool:
        """True for a Clock_Value (function 0 with bit 7 of the FC)."""
        return self.fc >= 0 and self.fc & _CLOCK_VALUE_FC == _CLOCK_VALUE_FC and not self.fc & FC_FUNCTION

    @property
    def empty_le3(self) -> bool:
        """True for an SD2 telegram with LE = 3: not in the standard, but two known slaves send it."""
        return self.kind is Kind.SD2 and not self.data and self.dsap is self.ssap is self.dseg is self.sseg is None

    @property
    def station_type(self) -> StationType:
        """Station type of a response."""
        return StationType(self.fc >> 4 & 3)


SHORT_ACK: Final = Telegram(Kind.SC, -1, -1)


def token(da: int, sa: int) -> Telegram:
    """The token from ``sa`` to ``da``."""
    return Telegram(Kind.SD4, da, sa)


# --- service access points (decimal as in the standard) -----------------------------------------------------------
SAP_SET_SLAVE_ADD: Final = 55
SAP_RD_INP: Final = 56
SAP_RD_OUTP: Final = 57
SAP_GLOBAL_CONTROL: Final = 58
SAP_GET_CFG: Final = 59
SAP_SLAVE_DIAG: Final = 60
SAP_SET_PRM: Final = 61
SAP_CHK_CFG: Final = 62
SAP_EXT_USER_PRM: Final = 53
SAP_MS1: Final = 51
SAP_MS1_ALARM: Final = 50
SAP_MS2_RM: Final = 49
#: the master's own SAPs
SSAP_MS0: Final = 62
SSAP_MS2: Final = 50
SSAP_MASTER_MASTER: Final = 54
