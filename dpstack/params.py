"""Bus parameters under the standard's names: presets for each baud rate, limits.

All times are bit times. Table and limits with their sources: docs/reference/protocol.md#bus-parameters; what follows
from them: docs/reference/bus-parameters.md.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from msgspec import Struct
from msgspec.structs import replace

from dpstack.errors import ParamError
from dpstack.units import BAUD_RATES, baud_text, bits_to_ns

#: Silence in bit times that ends a telegram and enables the receivers for the next request.
T_SYN: Final = 33

#: Highest station address; 126 is the address of a slave as delivered, 127 the broadcast address.
MAX_STATION: Final = 125
#: T_SL in bit times (14 bits in the bus parameter record)
MAX_T_SL: Final = 16_383
UNADDRESSED: Final = 126
BROADCAST: Final = 127
#: T_ID1 of the VPC3+C manual, p 58, without T_SET and T_QUI
_PUBLISHER_TSDR: Final = 37
#: octets of DPV1_Status at the beginning of the user parameters
DPV1_STATUS_LEN: Final = 3


#: bus parameter -> lowest value, highest value, text for messages
BUS_LIMITS: Final = {
    "address": (0, MAX_STATION, "station addresses"),
    "hsa": (1, 126, "highest station address"),
    "t_sl": (37, MAX_T_SL, "T_SL"),
    "t_set": (1, 494, "T_SET"),
    "t_qui": (0, 31, "T_QUI"),
    "min_tsdr": (11, 255, "T_SDR"),
    "max_tsdr": (12, 1_023, "T_SDR"),
    "t_tr": (256, 16_777_960, "T_TR"),
    "gap": (0, 100, "GAP factor, 0 = off"),
    "max_retry": (0, 15, "retries"),
    "extra_idle": (0, 100_000, "extra idle time"),
}


# Columns as in Felser's table; gap, retry and T_TR by the Softing table (docs/reference/protocol.md#bus-parameters).
_COLUMNS: Final = ("t_sl", "min_tsdr", "max_tsdr", "t_set", "t_qui", "gap", "max_retry", "t_tr")
_PRESETS: Final = {
    9_600: (100, 11, 60, 1, 0, 1, 1, 50_000),
    19_200: (100, 11, 60, 1, 0, 1, 1, 50_000),
    31_250: (100, 11, 60, 1, 0, 1, 1, 50_000),  # PA's rate: the row of its neighbours, unconfirmed
    45_450: (640, 11, 400, 95, 0, 10, 1, 50_000),
    93_750: (100, 11, 60, 1, 0, 1, 1, 50_000),
    187_500: (100, 11, 60, 1, 0, 1, 1, 50_000),
    500_000: (200, 11, 100, 1, 0, 1, 1, 100_000),
    1_500_000: (300, 11, 150, 1, 0, 10, 1, 300_000),
    3_000_000: (400, 11, 250, 4, 3, 10, 2, 600_000),
    6_000_000: (600, 11, 450, 8, 6, 10, 3, 1_200_000),
    12_000_000: (1000, 11, 800, 16, 9, 10, 4, 2_400_000),
}


class BusParams(Struct, frozen=True, kw_only=True):
    """The parameters of one bus as one station sees them. Construction checks every limit and names what is wrong.

    Use :meth:`preset` for the standard's values at a baud rate. Times in bit times; ``address`` is TS.
    Raises :class:`~dpstack.errors.ParamError`.
    """

    #: baud rate in bit/s
    baud: int
    #: TS, the address of this station, 0..126
    address: int
    #: slot time T_SL: how long a master waits for the first octet of an answer, in bit times
    t_sl: int
    #: shortest time in bit times that a station leaves between a request and its answer, min T_SDR
    min_tsdr: int
    #: longest time in bit times until the answer of a slave begins, max T_SDR
    max_tsdr: int
    #: setup time T_SET between an event and the reaction of this station, in bit times
    t_set: int
    #: quiet time T_QUI of the transmitter after its last octet, in bit times
    t_qui: int
    #: target rotation time T_TR of the token, in bit times
    t_tr: int
    #: GAP update factor G: a GAP pass every G x T_TR; 0: no GAP polls
    gap: int
    #: highest station address that the master looks for among new masters, 0..126
    hsa: int = 126
    #: repetitions of a request without an answer
    max_retry: int = 1
    #: extra silence in front of every request, for slaves that find frame ends by a long pause
    extra_idle: int = 0

    def __post_init__(self) -> None:
        problems = list(self._problems())
        if problems:
            raise ParamError(f"bus parameters at {baud_text(self.baud)}: " + "; ".join(problems))

    def _problems(self) -> Iterable[str]:
        if self.baud not in BAUD_RATES:
            yield _unknown_rate(self.baud)
        for name, (low, high, what) in BUS_LIMITS.items():
            value = getattr(self, name)
            if not low <= value <= high:
                yield f"{name} = {value} is outside {low}..{high} ({what})"
        if self.t_qui >= self.min_tsdr:
            yield f"t_qui = {self.t_qui} is not less than min_tsdr = {self.min_tsdr}"
        if self.address > self.hsa:
            yield f"address {self.address} lies above hsa {self.hsa}: no other master would ever find it"
        if self.max_tsdr + 15 > self.t_sl:
            yield f"t_sl = {self.t_sl} is less than max_tsdr + 15 = {self.max_tsdr + 15}"
        if self.max_tsdr < 35 + 2 * self.t_set + self.t_qui:
            yield f"max_tsdr = {self.max_tsdr} is less than 35 + 2 t_set + t_qui = {self.t_id1_bare}"
        upper = min(self.max_tsdr - 1, 34 + 2 * self.t_set + self.t_qui)
        if self.min_tsdr > upper:
            yield f"min_tsdr = {self.min_tsdr} is more than min(max_tsdr - 1, 34 + 2 t_set + t_qui) = {upper}"

    @classmethod
    def preset(cls, baud: int, *, slave_max_tsdr: Iterable[int] = (), **given: int | None) -> BusParams:
        """The standard's parameters at ``baud``, widened to the attached slaves; address 2.

        ``slave_max_tsdr`` are the MaxTsdr of the attached slaves in bit times at this rate;
        T_SL = max(table, largest + 15). A parameter ``given`` by its name, unless None, replaces the preset one; all
        are checked.
        """
        if baud not in _PRESETS:
            raise ParamError(_unknown_rate(baud))
        preset = dict(zip(_COLUMNS, _PRESETS[baud], strict=True))
        preset["max_tsdr"] = max((preset["max_tsdr"], *slave_max_tsdr))
        preset["t_sl"] = max(preset["t_sl"], preset["max_tsdr"] + 15)
        preset |= {name: value for name, value in given.items() if value is not None}
        return cls(baud=baud, **{"address": 2, **preset})

    def replace(self, **changes: int) -> BusParams:
        """A checked copy with some parameters changed."""
        return replace(self, **changes)

    def ns(self, bits: int) -> int:
        """``bits`` bit times at this rate in nanoseconds."""
        return bits_to_ns(bits, self.baud)

    @property
    def t_id1_bare(self) -> int:
        """T_QUI + 2 T_SET + 2 + T_SYN in bit times, before the comparison with min T_SDR."""
        return self.t_qui + 2 * self.t_set + 2 + T_SYN

    @property
    def t_id1(self) -> int:
        """Idle time in bit times after an answer, SC or token, before this station's next request (extra included)."""
        return max(self.t_id1_bare, self.min_tsdr) + self.extra_idle

    @property
    def publisher_min_tsdr(self) -> int:
        """The least min T_SDR of a publisher (DXB) in bit times, as subscribers need an idle time before its answer:
        37 + 2 T_SET + T_QUI (docs/reference/decisions/dxb.md#min-t_sdr)."""
        return _PUBLISHER_TSDR + 2 * self.t_set + self.t_qui

    @property
    def t_id2(self) -> int:
        """Idle time in bit times after a request that is not answered (SDN, broadcast; extra included)."""
        return max(self.t_id1_bare, self.max_tsdr) + self.extra_idle

    @property
    def t_to(self) -> int:
        """Time-out T_TO in bit times after which this station considers the token lost."""
        return self.t_to_of(self.address)

    def t_to_of(self, address: int) -> int:
        """T_TO in bit times of the master ``address`` on this bus (docs/reference/protocol.md#t_to)."""
        return (6 + 2 * address) * self.t_sl


def _unknown_rate(baud: int) -> str:
    return f"baud {baud} is no PROFIBUS rate (known: {', '.join(map(str, BAUD_RATES))})"
