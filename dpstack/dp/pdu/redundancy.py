"""PrmCmdAck and Red_State: status messages of a redundant slave, with the state of both of its sides."""

from __future__ import annotations

from enum import IntFlag
from typing import Final

from msgspec import Struct

# Source: AUMA AC 01.2 manual p46 and AC(V) 01.2 manual p48 (table 34), after PNO 2.212. VIPA's IM 253-2DP50 counts
# Data_Exchange as bit 4 (System 200V manual p3-54), in a status of its own type 0: that one is not read here.


class PrmFunction(IntFlag):
    """Function of PrmCmd, and of PrmCmdAck."""

    PRIMARY_REQUEST = 0x02
    STOP_MS1 = 0x04
    START_MS1 = 0x08
    CHECK_PROPERTIES = 0x10
    MASTER_STATE_CLEAR = 0x40


class RedState(IntFlag):
    """The state of one side of a redundant slave."""

    BACKUP = 0x01
    PRIMARY = 0x02
    HARDWARE_DEFECT = 0x04
    DATA_EXCHANGE = 0x08
    MASTER_STATE_CLEAR = 0x10
    BAUD_RATE_FOUND = 0x20
    OUTPUT_HOLD_TIME = 0x40


#: octets of function and two states; the octet of a third state is not used
_LEAST: Final = 3


class Redundancy(Struct, frozen=True):
    """``sequence`` 0..31: that of the PrmCmd. ``own``: the side that sends it, ``other``: the second one.

    Red_State_1 and 2: to AUMA the primary's and the backup's, to VIPA those of the side that is asked and of the other.
    """

    sequence: int
    function: PrmFunction
    own: RedState
    other: RedState

    @classmethod
    def of(cls, specifier: int, data: bytes) -> Redundancy | None:
        """Read specifier and data of a status; None if the data are too short."""
        if len(data) < _LEAST:
            return None
        return cls(specifier >> 3, PrmFunction(data[0]), RedState(data[1]), RedState(data[2]))

    @property
    def octets(self) -> bytes:
        """The data of the status."""
        return bytes((self.function, self.own, self.other, 0))

    @property
    def text(self) -> str:
        sides = f"this side: {_names(self.own)}; the other side: {_names(self.other)}"
        return f"sequence number {self.sequence}, function: {_names(self.function)}; {sides}"


def _names(flags: PrmFunction | RedState) -> str:
    known = [one.name.lower().replace("_", " ") for one in type(flags) if one in flags and one.name]
    left = flags & ~sum(type(flags))
    return ", ".join([*known, *([f"0x{left:02X} (reserved)"] if left else [])]) or "none"
