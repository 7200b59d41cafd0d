"""The diagnosis of a slave: the six fixed octets (bits: :mod:`dpstack.dp.pdu.diag_bits`), and the blocks that may
follow.

Facts: docs/protocol.md#slave_diag; what slaves do instead: docs/protocol.md#how-real-devices-deviate.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from dpstack.dp.pdu.diag_bits import ALWAYS_ONE, FLAG, FLAGS, Does, Flag, SetBy
from dpstack.dp.pdu.diag_blocks import Block, split_blocks
from dpstack.dp.pdu.layouts import DIAGNOSIS, DiagnosisOctets
from dpstack.errors import PduError

__all__ = ["ALWAYS_ONE", "FIXED_LEN", "FLAG", "FLAGS", "MAX_LEN", "NO_MASTER", "Diagnosis", "Flag", "SetBy"]

#: Fixed octets, and the longest diagnosis.
FIXED_LEN: Final = 6
MAX_LEN: Final = 244
#: Master address of a slave that nobody has parameterised.
NO_MASTER: Final = 255


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """One diagnosis (the answer to Slave_Diag, DSAP 60).

    ``master``: address of the master that has parameterised the slave, None for none (255). ``ident``: ident number.
    ``ext``: the octets after the six fixed ones, :attr:`blocks` splits them.
    """

    status1: int
    status2: int
    status3: int
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
        raw = DIAGNOSIS.parse(octets)
        master = None if raw.master_add == NO_MASTER else raw.master_add
        return cls(raw.status_1, raw.status_2, raw.status_3, master, raw.ident, raw.ext_diag)

    def build(self) -> bytes:
        """The octets. Raises PduError where a value does not fit."""
        if len(self.ext) > MAX_LEN - FIXED_LEN:
            raise PduError(f"Slave_Diag: {len(self.ext)} octets of extended diagnosis, 238 are possible")
        master = NO_MASTER if self.master is None else self.master
        return DIAGNOSIS.build(DiagnosisOctets(self.status1, self.status2, self.status3, master, self.ident, self.ext))

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
        """The flags that people are told of one by one; ``exchanging``: the slave is in data exchange.

        Left out are those that only name a mode (WD_On, Sync_Mode), those that a master sets, and those that the master
        deals with itself: states and faults of the slave tell of them.
        """
        found = self.findings
        if exchanging and any(flag.exchange in (Does.PARAMETERISES, Does.REFUSES) for flag in found):
            exchanging = False  # it is about to be brought up again
        told = (Does.TELLS, Does.WAITS) if exchanging else (Does.TELLS,)
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
        """What is wrong with the lengths in the extended diagnosis, None when they are true."""
        return split_blocks(self.ext)[1]

    @property
    def station_non_existent(self) -> bool:
        """The master's bit: no answer."""
        return bool(self.status1 & 0x01)

    @property
    def not_ready(self) -> bool:
        """Station_Not_Ready."""
        return bool(self.status1 & 0x02)

    @property
    def cfg_fault(self) -> bool:
        """Chk_Cfg was refused."""
        return bool(self.status1 & 0x04)

    @property
    def ext_diag(self) -> bool:
        """The extended diagnosis reports something."""
        return bool(self.status1 & 0x08)

    @property
    def not_supported(self) -> bool:
        """A function was asked for that the slave does not have."""
        return bool(self.status1 & 0x10)

    @property
    def invalid_response(self) -> bool:
        """The master's bit: implausible answer."""
        return bool(self.status1 & 0x20)

    @property
    def prm_fault(self) -> bool:
        """Set_Prm was refused."""
        return bool(self.status1 & 0x40)

    @property
    def master_lock(self) -> bool:
        """The master's bit: parameterised by another master."""
        return bool(self.status1 & 0x80)

    @property
    def prm_req(self) -> bool:
        """The slave wants Set_Prm."""
        return bool(self.status2 & 0x01)

    @property
    def stat_diag(self) -> bool:
        """Static diagnosis: the slave cannot give valid data, the master keeps asking."""
        return bool(self.status2 & 0x02)

    @property
    def wd_on(self) -> bool:
        return bool(self.status2 & 0x08)

    @property
    def freeze(self) -> bool:
        return bool(self.status2 & 0x10)

    @property
    def sync(self) -> bool:
        return bool(self.status2 & 0x20)

    @property
    def not_present(self) -> bool:
        """The master's bit: not there."""
        return bool(self.status2 & 0x40)

    @property
    def deactivated(self) -> bool:
        """The master's bit: taken out of service."""
        return bool(self.status2 & 0x80)

    @property
    def overflow(self) -> bool:
        return bool(self.status3 & 0x80)
