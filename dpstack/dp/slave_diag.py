"""The diagnosis as a slave application keeps it: its fault bits, and whether the master has seen the rest."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dpstack.dp.device import Device
from dpstack.dp.diagnosis import ALWAYS_ONE, FIXED_LEN, MAX_LEN, Diagnosis
from dpstack.dp.slave_data import CyclicData
from dpstack.dp.slave_states import SlaveAppState

_MAX_EXT: Final = MAX_LEN - FIXED_LEN


class DiagState:
    """Fault bits of one slave application, and what its owner has read of the extended diagnosis.

    ``ext`` is the device's extended diagnosis, None where the device has none.
    """

    __slots__ = ("_built", "_ident", "_told", "cfg_fault", "ext", "not_supported", "prm_fault")

    def __init__(self, device: Device) -> None:
        self._ident = device.ident
        self._told = self._built = b""
        self.prm_fault = self.cfg_fault = self.not_supported = False
        self.ext: Callable[[], bytes] | None = device.ext_diag
        # a device that leaves ext_diag as it is need not be asked in every exchange
        if getattr(device.ext_diag, "__func__", None) is Device.ext_diag:
            self.ext = None

    def clear_faults(self) -> None:
        """Good parameters, release or restart."""
        self.prm_fault = self.cfg_fault = self.not_supported = False

    def new_owner(self) -> None:
        """Another master has read nothing yet."""
        self._told = b""

    def fetched(self) -> None:
        """The owner has read what :meth:`build` gave last."""
        self._told = self._built

    def waiting(self) -> bool:
        """True when the owner must fetch the diagnosis (DH)."""
        return self.ext is not None and self.ext() != self._told

    def build(
        self, state: SlaveAppState, master: int | None, data: CyclicData | None, *, wd_on: bool, ill: bool, ext: bytes
    ) -> Diagnosis:
        """The diagnosis of this moment (B1); ``ill``: the device is broken."""
        self._built = ext
        status1 = (
            (data is None) << 1 | self.cfg_fault << 2 | bool(ext) << 3 | self.not_supported << 4 | self.prm_fault << 6
        )
        status2 = ALWAYS_ONE | (state is SlaveAppState.WAIT_PRM) | ill << 1 | wd_on << 3
        if data is not None:
            status2 |= data.frozen << 4 | data.synced << 5
        overflow = (len(ext) > _MAX_EXT) << 7
        return Diagnosis(status1, status2, overflow, master, self._ident, ext[:_MAX_EXT])
