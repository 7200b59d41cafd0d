"""The request PDUs of DP-V0: Set_Prm, Global_Control and Set_Slave_Add. (Chk_Cfg is :mod:`dpstack.gsd.identifiers`.)

Facts: docs/reference/protocol.md#set_prm, docs/reference/protocol.md#lock-and-unlock,
docs/reference/protocol.md#global_control, docs/reference/protocol.md#set_slave_add.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

from msgspec import Struct

from dpstack.dp.pdu.layouts import OCTET, REST, WORD, Layout, Numbers, Pdu, adapted
from dpstack.errors import PduError
from dpstack.gsd.identifiers import MAX_USER_PRM
from dpstack.params import MAX_STATION

#: The fixed octets of Set_Prm.
SET_PRM_LEN: Final = 7
#: Octets for the device itself that fit after the four fixed ones of Set_Slave_Add.
MAX_REM_SLAVE_DATA: Final = 240

#: this many Global_Controls are cached, parsed and built
_KEPT_CONTROLS: Final = 64
#: The watchdog factors while the watchdog is off: the smallest legal ones, because some slaves check them anyway.
_NO_WATCHDOG: Final = (1, 1)
_SET_PRM: Final = Numbers("Set_Prm", station_status=1, wd_fact_1=1, wd_fact_2=1, min_tsdr=1, ident=2, group_ident=1)
#: bits of Station_status
_LOCK: Final = 0x80
_UNLOCK: Final = 0x40
_SYNC_REQ: Final = 0x20
_FREEZE_REQ: Final = 0x10
_WD_ON: Final = 0x08
_GLOBAL_CONTROL: Final = Numbers("Global_Control", control_command=1, group_select=1)
#: bits of Control_Command
_SYNC: Final = 0x20
_UNSYNC: Final = 0x10
_FREEZE: Final = 0x08
_UNFREEZE: Final = 0x04
_CLEAR: Final = 0x02


class SetPrm(Struct, frozen=True):
    """Set_Prm (DSAP 61).

    ``lock``/``unlock``: 10 locks the slave to the sender, 01 and 11 release it, 00 may only change min T_SDR and the
    slave's own parameters. ``watchdog``: the two factors of T_WD = 10 ms x f1 x f2, None = off. ``min_tsdr`` in bit
    times, 0 keeps what the slave has. ``group_mask``: bit n-1 for group n, taken with ``lock`` only.
    ``user_prm``: 0..237 octets, from octet 8 on.
    """

    ident: int
    user_prm: bytes = b""
    lock: bool = True
    unlock: bool = False
    sync: bool = False
    freeze: bool = False
    watchdog: tuple[int, int] | None = None
    min_tsdr: int = 11
    group_mask: int = 0

    def build(self) -> bytes:
        """The octets. Raises PduError if a value does not fit."""
        if len(self.user_prm) > MAX_USER_PRM:
            raise PduError(f"Set_Prm: {len(self.user_prm)} octets of user parameters, {MAX_USER_PRM} are possible")
        if self.watchdog is not None and not all(1 <= factor <= 255 for factor in self.watchdog):
            raise PduError(f"Set_Prm: watchdog factors {self.watchdog} are outside 1..255 (None switches it off)")
        first, second = self.watchdog or _NO_WATCHDOG
        status = _LOCK * self.lock | _UNLOCK * self.unlock | _SYNC_REQ * self.sync | _FREEZE_REQ * self.freeze
        status |= _WD_ON * (self.watchdog is not None)
        return _SET_PRM.build(status, first, second, self.min_tsdr, self.ident, self.group_mask) + self.user_prm

    @classmethod
    def parse(cls, octets: bytes) -> SetPrm:
        """Read ``octets``; reserved bits are ignored, factors of 0 are kept as they came. Raises PduError."""
        status, first, second, min_tsdr, ident, group_mask = _SET_PRM.parse(octets)
        last = SET_PRM_LEN + MAX_USER_PRM
        if len(octets) > last:
            raise PduError(f"Set_Prm has {len(octets)} octets, octet {last} is the last possible one")
        return cls(
            ident=ident,
            user_prm=octets[SET_PRM_LEN:],
            lock=bool(status & _LOCK),
            unlock=bool(status & _UNLOCK),
            sync=bool(status & _SYNC_REQ),
            freeze=bool(status & _FREEZE_REQ),
            watchdog=(first, second) if status & _WD_ON else None,
            min_tsdr=min_tsdr,
            group_mask=group_mask,
        )


class GlobalControl(Struct, frozen=True):
    """Global_Control (DSAP 58, SDN, usually to 127).

    All False is Operate. ``group_mask`` 0 concerns all slaves of the sender. Unfreeze and unsync win over freeze and
    sync.
    """

    clear: bool = False
    unfreeze: bool = False
    freeze: bool = False
    unsync: bool = False
    sync: bool = False
    group_mask: int = 0

    def build(self) -> bytes:
        """The two octets. Raises PduError if the mask does not fit."""
        return _build_control(self)

    @classmethod
    def parse(cls, octets: bytes) -> GlobalControl:
        """Read ``octets``; reserved bits are ignored. Raises PduError unless there are two."""
        return _parse_control(octets)


@lru_cache(_KEPT_CONTROLS)  # all slaves of a bus read the same Global_Control again and again
def _build_control(control: GlobalControl) -> bytes:
    command = _SYNC * control.sync | _UNSYNC * control.unsync | _FREEZE * control.freeze
    command |= _UNFREEZE * control.unfreeze | _CLEAR * control.clear
    return _GLOBAL_CONTROL.build(command, control.group_mask)


@lru_cache(_KEPT_CONTROLS)
def _parse_control(octets: bytes) -> GlobalControl:
    command, group_mask = _GLOBAL_CONTROL.parse(octets)
    if len(octets) > _GLOBAL_CONTROL.size:
        raise PduError(f"Global_Control has {len(octets)} octets, octet {_GLOBAL_CONTROL.size} is the last one")
    return GlobalControl(
        clear=bool(command & _CLEAR),
        unfreeze=bool(command & _UNFREEZE),
        freeze=bool(command & _FREEZE),
        unsync=bool(command & _UNSYNC),
        sync=bool(command & _SYNC),
        group_mask=group_mask,
    )


class SetSlaveAdd(Pdu, frozen=True):
    """Set_Slave_Add (DSAP 55): the station address of a slave in Wait_Prm.

    ``address``: the new one, 0..125. ``ident``: the slave's own, else it does nothing. ``no_add_chg``: the slave shall
    refuse any further change of its address. ``rem_slave_data``: 0..240 octets that mean something to the device only.
    """

    address: int
    ident: int
    no_add_chg: bool = False
    rem_slave_data: bytes = b""

    def build(self) -> bytes:
        """The octets. Raises PduError if a value does not fit."""
        if not 0 <= self.address <= MAX_STATION:
            raise PduError(f"Set_Slave_Add: {self.address} is no address for a slave, {MAX_STATION} is the highest")
        if len(self.rem_slave_data) > MAX_REM_SLAVE_DATA:
            raise PduError(
                f"Set_Slave_Add: {len(self.rem_slave_data)} octets for the device, {MAX_REM_SLAVE_DATA} are possible"
            )
        return self.LAYOUT.build(self)


SetSlaveAdd.LAYOUT = Layout(
    "Set_Slave_Add",
    SetSlaveAdd,
    "address" / OCTET * "new_address",
    "ident" / WORD,
    # No_Add_Chg is a Boolean of one octet: 0 is false, anything else true; FF is true to every reader.
    "no_add_chg" / adapted(OCTET, bool, lambda is_fixed: 0xFF if is_fixed else 0),
    "rem_slave_data" / REST,
)
