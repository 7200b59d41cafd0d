"""The diagnosis of a slave: the six fixed octets (bits: :mod:`dpstack.dp.pdu.diag_bits`) and the blocks after them.

Facts: docs/reference/protocol.md#slave_diag; what slaves do instead:
docs/reference/protocol.md#how-real-devices-deviate.
"""

from __future__ import annotations

from enum import Enum
from typing import Final

from msgspec import Struct

from dpstack.dp.pdu.diag_bits import ALWAYS_ONE, FLAG, FLAGS, Flag, Reaction
from dpstack.dp.pdu.diag_blocks import Block, split_blocks
from dpstack.dp.pdu.layouts import Numbers
from dpstack.errors import PduError

#: Fixed octets, and the longest diagnosis.
FIXED_LEN: Final = 6
MAX_LEN: Final = 244
#: Master address of a slave that no master has parameterised.
NO_MASTER: Final = 255
_FIXED: Final = Numbers("Slave_Diag", status1=1, status2=1, status3=1, master=1, ident=2)


class _Bit:
    """One bit of the status octets as an attribute: the one that :data:`FLAGS` has under ``name``."""

    __slots__ = ("_mask", "_status")

    def __init__(self, name: str) -> None:
        self._status = f"status{FLAG[name].octet}"
        self._mask = FLAG[name].mask

    def __get__(self, diagnosis: Diagnosis, owner: type[Diagnosis]) -> bool:
        return bool(getattr(diagnosis, self._status) & self._mask)


class Diagnosis(Struct, frozen=True):
    """One diagnosis (the answer to Slave_Diag, DSAP 60).

    ``ident``: ident number. ``ext``: the octets after the six fixed ones, :attr:`blocks` splits them.
    """

    #: octet Station_status_1
    status1: int
    #: octet Station_status_2
    status2: int
    #: octet Station_status_3
    status3: int
    #: address of the master that has parameterised the slave; None without one (255)
    master: int | None
    ident: int
    ext: bytes = b""

    @classmethod
    def parse(cls, octets: bytes) -> Diagnosis | None:
        """Read ``octets``; None when they are no diagnosis (fewer than 6 octets or more than 244).

        No bit combination is refused: what slaves really set is for the caller to judge.
        """
        if not FIXED_LEN <= len(octets) <= MAX_LEN:
            return None
        status1, status2, status3, master, ident = _FIXED.parse(octets)
        return cls(status1, status2, status3, None if master == NO_MASTER else master, ident, octets[FIXED_LEN:])

    def build(self) -> bytes:
        """The octets. Raises PduError if a value does not fit."""
        if len(self.ext) > MAX_LEN - FIXED_LEN:
            raise PduError(f"Slave_Diag: {len(self.ext)} octets of extended diagnosis, 238 are possible")
        master = NO_MASTER if self.master is None else self.master
        return _FIXED.build(self.status1, self.status2, self.status3, master, self.ident) + self.ext

    @property
    def findings(self) -> tuple[Flag, ...]:
        """The flags that are set, in the order of the wire."""
        status = (0, self.status1, self.status2, self.status3)
        return tuple(flag for flag in FLAGS if status[flag.octet] & flag.mask)

    @property
    def flags(self) -> tuple[str, ...]:
        """The names of the flags that are set, as the JSON lines have them."""
        return tuple(flag.name for flag in self.findings)

    def conspicuous(self, *, exchanging: bool) -> tuple[Flag, ...]:
        """The flags to report one by one; ``exchanging``: the slave is in data exchange.

        Left out are those that only name a mode (WD_On, Sync_Mode), those that a master sets, and those that the master
        deals with itself: states and faults of the slave report them.
        """
        found = self.findings
        if exchanging and any(flag.exchange in (Reaction.PARAMETERISES, Reaction.REFUSES) for flag in found):
            exchanging = False  # it is about to be brought up again
        told = (Reaction.REPORTS, Reaction.WAITS) if exchanging else (Reaction.REPORTS,)
        return tuple(flag for flag in found if flag.remedy and (flag.exchange if exchanging else flag.bring_up) in told)

    @property
    def texts(self) -> tuple[str, ...]:
        """One line for people for each flag that is set, with what to do."""
        return tuple(f"{f.text}: {f.remedy}" if f.remedy else f.text for f in self.findings)

    @property
    def always_one(self) -> bool:
        """Status 2 bit 2, which every slave should set and some do not."""
        return bool(self.status2 & ALWAYS_ONE)

    @property
    def blocks(self) -> tuple[Block, ...]:
        """The blocks of the extended diagnosis, as far as their lengths are true."""
        return split_blocks(self.ext)[0]

    @property
    def ext_rest(self) -> bytes:
        """The octets of the extended diagnosis that no block holds, because a length lies."""
        return self.ext[sum(len(block.octets) for block in self.blocks) :]

    @property
    def ext_finding(self) -> str | None:
        """The fault in the lengths of the extended diagnosis, None when they are right."""
        return split_blocks(self.ext)[1]

    # those that only a master sets are in `findings`
    #: Station_Not_Ready: the slave is not ready for data exchange
    not_ready = _Bit("station_not_ready")
    #: Cfg_Fault: the slave refuses the configuration of the last Chk_Cfg
    cfg_fault = _Bit("cfg_fault")
    #: Ext_Diag: the extended diagnosis reports a fault
    ext_diag = _Bit("ext_diag")
    #: Not_Supported: the slave does not know the service or function
    not_supported = _Bit("not_supported")
    #: Prm_Fault: the slave refuses the last Set_Prm
    prm_fault = _Bit("prm_fault")
    #: Prm_Req: the slave must be parameterised and configured anew
    prm_req = _Bit("prm_req")
    #: Stat_Diag: the slave has no valid data at present
    stat_diag = _Bit("stat_diag")
    #: WD_On: the watchdog of the slave is on
    wd_on = _Bit("wd_on")
    #: Freeze_Mode: the slave holds its inputs
    freeze = _Bit("freeze_mode")
    #: Sync_Mode: the slave holds its outputs
    sync = _Bit("sync_mode")
    #: Ext_Diag_Overflow: there is more diagnosis than fits
    overflow = _Bit("ext_diag_overflow")


class SlaveView(Enum):
    """State of a slave as its diagnosis shows it; the values are those of ``scan --json``."""

    WAIT_PRM = "wait_prm"
    WAIT_CFG = "wait_cfg"
    DATA_EXCHANGE = "data_exchange"
    UNKNOWN = "unknown"


def view_of(diagnosis: Diagnosis | None) -> SlaveView:
    """The state behind a diagnosis: Prm_Req, Station_Not_Ready, a master's address
    (docs/reference/protocol.md#slave_diag)."""
    if diagnosis is None:
        return SlaveView.UNKNOWN
    if diagnosis.prm_req:
        return SlaveView.WAIT_PRM
    if diagnosis.not_ready:
        return SlaveView.WAIT_CFG
    return SlaveView.UNKNOWN if diagnosis.master is None else SlaveView.DATA_EXCHANGE
