"""The request PDUs of DP-V0: Set_Prm and Global_Control. (Chk_Cfg is :mod:`dpstack.gsd.identifiers`.)

Sources: protocol facts B2, B4, J; EN 50170-2 (Set_Prm, Global_Control), Festo CP FB13 manual (lock and unlock).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from dpstack.dp.wire import GLOBAL_CONTROL, SET_PRM, GlobalControlOctets, SetPrmOctets
from dpstack.errors import PduError

__all__ = ["MAX_USER_PRM", "GlobalControl", "PduError", "SetPrm"]

#: Octets of user parameters that fit after the seven fixed ones.
MAX_USER_PRM: Final = 237

#: What is sent as watchdog factors when the watchdog is off: the smallest legal ones, some slaves look at them anyway.
_NO_WATCHDOG: Final = (1, 1)


@dataclass(frozen=True, slots=True)
class SetPrm:
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
        """The octets. Raises PduError where a value does not fit."""
        if len(self.user_prm) > MAX_USER_PRM:
            raise PduError(f"Set_Prm: {len(self.user_prm)} octets of user parameters, {MAX_USER_PRM} are possible")
        if self.watchdog is not None and not all(1 <= factor <= 255 for factor in self.watchdog):
            raise PduError(f"Set_Prm: watchdog factors {self.watchdog} are outside 1..255 (None switches it off)")
        first, second = self.watchdog or _NO_WATCHDOG
        return SET_PRM.build(
            SetPrmOctets(
                lock=self.lock,
                unlock=self.unlock,
                sync=self.sync,
                freeze=self.freeze,
                wd_on=self.watchdog is not None,
                reserved=0,
                wd_fact_1=first,
                wd_fact_2=second,
                min_tsdr=self.min_tsdr,
                ident=self.ident,
                group_ident=self.group_mask,
                user_prm=self.user_prm,
            )
        )

    @classmethod
    def parse(cls, octets: bytes) -> SetPrm:
        """Read ``octets``; reserved bits are ignored, factors of 0 are kept as they came. Raises PduError."""
        raw = SET_PRM.parse(octets)
        if len(raw.user_prm) > MAX_USER_PRM:
            raise PduError(f"Set_Prm has {len(octets)} octets, octet {MAX_USER_PRM + 7} is the last possible one")
        return cls(
            ident=raw.ident,
            user_prm=raw.user_prm,
            lock=raw.lock,
            unlock=raw.unlock,
            sync=raw.sync,
            freeze=raw.freeze,
            watchdog=(raw.wd_fact_1, raw.wd_fact_2) if raw.wd_on else None,
            min_tsdr=raw.min_tsdr,
            group_mask=raw.group_ident,
        )


@dataclass(frozen=True, slots=True)
class GlobalControl:
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
        """The two octets. Raises PduError where the mask does not fit."""
        return GLOBAL_CONTROL.build(
            GlobalControlOctets(
                reserved_high=0,
                sync=self.sync,
                unsync=self.unsync,
                freeze=self.freeze,
                unfreeze=self.unfreeze,
                clear_data=self.clear,
                reserved_low=0,
                group_select=self.group_mask,
            )
        )

    @classmethod
    def parse(cls, octets: bytes) -> GlobalControl:
        """Read ``octets``; reserved bits are ignored. Raises PduError unless there are two."""
        raw = GLOBAL_CONTROL.parse(octets)
        if len(octets) != 2:
            raise PduError(f"Global_Control has {len(octets)} octets, octet 2 is the last one")
        return cls(
            clear=raw.clear_data,
            unfreeze=raw.unfreeze,
            freeze=raw.freeze,
            unsync=raw.unsync,
            sync=raw.sync,
            group_mask=raw.group_select,
        )
