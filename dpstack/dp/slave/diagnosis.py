"""The diagnosis of a slave application: its fault bits, and whether the master has read the rest.

Blocks stand in this order: alarm, status message, then what the device itself says, which is cut where there is no room
(Max_Diag_Data_Len).
"""

from __future__ import annotations

from collections.abc import Callable

from dpstack.dp.error_origin import DEVICE_CALL
from dpstack.dp.pdu.diag_bits import ALWAYS_ONE
from dpstack.dp.pdu.diag_blocks import NO_DIAG, UserDiag
from dpstack.dp.pdu.diagnosis import FIXED_LEN, Diagnosis
from dpstack.dp.slave.cyclic_data import CyclicData
from dpstack.dp.slave.device import DpV0Device
from dpstack.dp.slave.extension import DiagMessages
from dpstack.dp.slave.state_table import SlaveAppState
from dpstack.fdl.telegram import FC_FCB, FC_FCV


class DiagState:
    """Fault bits of one slave application, and what its owner has read of the application's own diagnosis.

    ``user`` asks the device, None where it never has anything to report; ``messages``: alarms and status messages,
    None where it has none. ``silent``: neither of them, there is never anything to fetch.
    """

    def __init__(self, device: DpV0Device, messages: DiagMessages | None = None) -> None:
        self._ident = device.ident
        self._room = device.max_diag_len - FIXED_LEN
        self._read_by_owner = NO_DIAG
        self._offered: UserDiag | None = None  # in an answer that the owner may not have received
        self.prm_fault = self.cfg_fault = self.not_supported = False
        is_plain = device.overrides_none("user_diag", "ext_diag")
        self.user: Callable[[], UserDiag] | None = None if is_plain else device.user_diag
        self._messages = messages
        self.silent = self.user is None and messages is None

    def clear_faults(self) -> None:
        """Good parameters, release or restart."""
        self.prm_fault = self.cfg_fault = self.not_supported = False

    def new_owner(self) -> None:
        """Another master has read nothing yet."""
        self._read_by_owner = NO_DIAG
        self._offered = None

    def offer(self, user: UserDiag) -> None:
        """An answer with ``user`` in it goes to the owner; :meth:`owner_asked` finds out whether it arrived."""
        if self._messages is not None:
            self._messages.offered()
        self._offered = user

    def owner_asked(self, fc: int) -> None:
        """The owner's next new request: it has the answer before, unless it had to take the station up afresh.

        A request again with the same FCB never gets here: the link layer repeats the answer
        (docs/protocol.md#frame-count-bit).
        """
        if self._offered is not None:
            if fc & (FC_FCV | FC_FCB) != FC_FCB:
                self._read_by_owner = self._offered
                if self._messages is not None:
                    self._messages.fetched()
            self._offered = None

    def waiting(self, fc: int) -> bool:
        """True when the owner, whose request has ``fc``, must fetch the diagnosis (DH)."""
        if self.silent:
            return False
        self.owner_asked(fc)
        # both are asked: with the first Data_Exchange alarms may be shown
        must_fetch = self._messages is not None and self._messages.must_fetch()
        if must_fetch or self.user is None:
            return must_fetch
        try:
            return self.user() != self._read_by_owner
        except Exception as error:
            DEVICE_CALL.mark(error)
            raise

    def build(
        self, state: SlaveAppState, master: int | None, data: CyclicData | None, user: UserDiag, *, wd: bool, ill: bool
    ) -> Diagnosis:
        """The diagnosis of this moment (docs/protocol.md#slave_diag); ``wd``: the watchdog is on, ``ill``: the device
        is broken."""
        blocks = b"" if self._messages is None else self._messages.octets()
        user = user.limited(self._room - len(blocks))
        status1 = (
            (data is None) << 1 | self.cfg_fault << 2 | user.fault << 3 | self.not_supported << 4 | self.prm_fault << 6
        )
        status2 = ALWAYS_ONE | (state is SlaveAppState.WAIT_PRM) | (ill or user.stat) << 1 | wd << 3
        if data is not None:
            status2 |= data.frozen << 4 | data.synced << 5
        return Diagnosis(status1, status2, user.overflow << 7, master, self._ident, blocks + user.ext)
