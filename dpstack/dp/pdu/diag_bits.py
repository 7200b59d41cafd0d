"""The bits of the diagnosis as one table: who sets each, how the master reacts, the texts for the user.

The master judges by this table (:mod:`dpstack.dp.master.verdicts`), and docs/reference/dp-v0.md is written from it.
Facts: docs/reference/protocol.md#slave_diag, docs/reference/protocol.md#what-a-diagnosis-means.
"""

from __future__ import annotations

from enum import Enum
from typing import Final

from msgspec import Struct


class SetBy(Enum):
    """The station that sets a bit: the slave itself, or the master in the diagnosis that it keeps for its user."""

    SLAVE = "slave"
    MASTER = "master"


class Reaction(Enum):
    """The master's reaction to the bit, the most serious one last. docs/reference/dp-v0.md prints the values."""

    REPORTS = "reports it, goes on"
    WAITS = "reads the diagnosis again until the bit is 0"
    PARAMETERISES = "begins again with Set_Prm"
    REFUSES = "fault; tries again after 1 to 10 s"


class Flag(Struct, frozen=True):
    """One bit. ``text`` says what it means, ``remedy`` what to do (empty: nothing is wrong).

    ``bring_up`` and ``exchange``: its reaction after Set_Prm and Chk_Cfg, and in data exchange; of a bit that
    it sets itself, None: whatever a slave puts there is ignored. ``note``: more about what the master does.
    """

    octet: int  # 1..3
    mask: int
    name: str
    set_by: SetBy
    bring_up: Reaction | None
    exchange: Reaction | None
    text: str
    remedy: str = ""
    note: str = ""


_S, _M = SetBy.SLAVE, SetBy.MASTER
_T, _W, _P, _R = Reaction

#: Status 2 bit 2 should always be 1; some slaves leave it 0, which has no effect.
ALWAYS_ONE: Final = 0x04

#: Every bit of the three status octets that has a meaning, in the order of the wire.
FLAGS: Final = (
    Flag(
        1, 0x01, "station_non_existent", _M, None, None, "does not answer", "check power, address and cable",
        "set while the slave does not answer; the master asks again after 0.1 to 1 s",
    ),
    Flag(
        1, 0x02, "station_not_ready", _S, _W, _T, "is not ready for data exchange", "wait; then look at the device",
        "after 10 s the fault `not_ready`, with the octet in which Get_Cfg differs",
    ),
    Flag(
        1, 0x04, "cfg_fault", _S, _R, _R,
        "refuses the configuration", "compare the identifier octets with its GSD file",
        "reads the real identifiers by Get_Cfg and names the octet that differs",
    ),
    Flag(
        1, 0x08, "ext_diag", _S, _T, _T, "has something to report in its extended diagnosis", "look at the device",
        "decodes the blocks; without this bit they are status messages, not errors",
    ),
    Flag(
        1, 0x10, "not_supported", _S, _R, _T,
        "does not know a function that was asked for", "leave out sync and freeze",
    ),
    Flag(
        1, 0x20, "invalid_slave_response", _M, None, None,
        "gave an impossible answer", "look for a second one at its address",
        "set after answers of the wrong length; the master sends safe outputs and unlocks the slave",
    ),
    Flag(
        1, 0x40, "prm_fault", _S, _R, _R,
        "refuses the parameters", "compare ident number and parameters with its GSD file",
        "the message has the octets sent and the slave's extended diagnosis",
    ),
    Flag(
        1, 0x80, "master_lock", _M, None, None,
        "is parameterised by another master", "stop that master, or leave the slave out",
        "set if octet 4 has the address of another master; the slave is never parameterised",
    ),
    Flag(2, 0x01, "prm_req", _S, _P, _P, "wants to be parameterised", "the master does it", "at most three times"),
    Flag(
        2, 0x02, "stat_diag", _S, _W, _W, "cannot give valid data", "look at the device's own fault display",
        "in data exchange every 100 ms; meanwhile outputs go on and inputs are not valid",
    ),
    Flag(2, 0x08, "wd_on", _S, _T, _T, "watches its master", note="reported if it is 0 and should be 1"),
    Flag(2, 0x10, "freeze_mode", _S, _T, _T, "its inputs are frozen"),
    Flag(2, 0x20, "sync_mode", _S, _T, _T, "its outputs are held until the next SYNC"),
    Flag(
        2, 0x40, "not_present", _M, None, None, "is not there", "check power, address and cable",
        "other masters set it; this one says station_non_existent",
    ),
    Flag(
        2, 0x80, "deactivated", _M, None, None, "is taken out of service by its master", "",
        "set after deactivate(): safe outputs, Unlock, then nothing is sent to it until activate()",
    ),
    Flag(
        3, 0x80, "ext_diag_overflow", _S, _T, _T, "has more diagnosis than fits", "look at the device itself",
        "the received part is decoded",
    ),
)  # fmt: skip

FLAG: Final = {flag.name: flag for flag in FLAGS}


def weightiest(reactions: tuple[Reaction | None, ...]) -> Reaction:
    """The most serious one of the reactions to the bits of one diagnosis."""
    return max(filter(None, reactions), key=tuple(Reaction).index, default=Reaction.REPORTS)
