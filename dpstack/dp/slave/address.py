"""The station address of a slave: from Set_Slave_Add, over restarts, back by an initial reset
(docs/protocol.md#set_slave_add).

No_Add_Chg closes the service for good; only an initial reset, done at the device itself, gives the slave the address
126 and opens it again.
"""

from __future__ import annotations

from dpstack.dp.error_origin import DEVICE_CALL
from dpstack.dp.pdu.requests import SetSlaveAdd
from dpstack.dp.slave.device import DpV0Device
from dpstack.dp.slave.events import AddressChanged, Report
from dpstack.params import MAX_STATION, UNADDRESSED


class SlaveAddress:
    """Where one slave stands on the bus. ``fixed``: Set_Slave_Add is closed."""

    __slots__ = ("_device", "_kept_address", "_kept_fixed", "_report", "fixed")

    def __init__(self, device: DpV0Device, report: Report, fixed: bool) -> None:
        self._device = device
        self._report = report
        self.fixed = fixed
        self._kept_address = report.address
        self._kept_fixed = fixed

    def attached(self) -> None:
        """A station was built around the application: this is the address it was switched on with."""
        self._kept_address = self._report.address

    @property
    def kept(self) -> tuple[int | None, bool]:
        """The address from the next power-on, and whether Set_Slave_Add is closed then."""
        return self._kept_address, self._kept_fixed

    @property
    def open(self) -> bool:
        """Whether Set_Slave_Add is served at all."""
        return self._device.set_slave_add and not self.fixed

    def judge(self, wanted: SetSlaveAdd) -> str | None:
        """A reason to leave the address as it is, or None."""
        if wanted.ident != self._device.ident:
            return f"octets 2-3: ident number 0x{wanted.ident:04X}, this device is 0x{self._device.ident:04X}"
        if wanted.address > MAX_STATION:
            return f"octet 1: address {wanted.address} is outside 0..{MAX_STATION}"
        return None

    def take(self, wanted: SetSlaveAdd, master: int, now: int) -> None:
        """The address of an accepted Set_Slave_Add. Exceptions of the device pass through, nothing is changed then."""
        self._change(wanted.address, wanted.no_add_chg, wanted.rem_slave_data, master, now)

    def initial_reset(self, now: int) -> None:
        """As delivered: 126, and open. Exceptions of the device pass through."""
        self._change(UNADDRESSED, False, b"", None, now)

    def set_at_device(self, address: int) -> None:
        """By a parameter of the device: from the next restart."""
        self._kept_address = address

    def restart(self) -> None:
        """Switched on again: what was not kept is gone."""
        self.fixed = self._kept_fixed
        if self._kept_address is not None:
            self._report.readdress(self._kept_address)

    def _change(self, address: int, fixed: bool, rem_slave_data: bytes, master: int | None, now: int) -> None:
        before = self._report.address
        with DEVICE_CALL:
            kept = self._device.address_set(address, fixed, rem_slave_data) or master is None
        if kept:
            self._kept_address, self._kept_fixed = address, fixed
        self.fixed = fixed
        self._report.readdress(address)
        self._report.emit(AddressChanged, now, before=before, master=master, fixed=fixed, kept=kept)
