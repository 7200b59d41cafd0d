"""The base class of a device: the part of a slave that its author writes."""

from __future__ import annotations

from collections.abc import Container
from enum import Enum

from dpstack.dp.pdu.diag_blocks import NO_DIAG, UserDiag
from dpstack.dp.slave.events import Report
from dpstack.dp.slave.extension import SlaveService
from dpstack.units import NEVER


class Leave(Enum):
    """The reason why data exchange ended."""

    WATCHDOG = "watchdog"  # the master fell silent
    UNLOCK = "unlock"
    NEW_PARAMETERS = "new parameters"  # another Set_Prm, good or bad
    NEW_CONFIGURATION = "new configuration"
    WRONG_LENGTH = "wrong length"
    POWER_OFF = "power off"
    FAILURE = "failure"  # an exception in this very device


class DpV0Device:
    """A DP device behind a :class:`~dpstack.dp.slave.application.SlaveApp`; subclass it, override what differs.

    ``ident``: ident number. ``other_idents``: ident numbers that it takes over from Set_Prm, and shows until it is
    released. ``configs``: acceptable identifier octets, the default first. ``fail_safe``: an empty output frame is
    taken as Clear (otherwise as one of the wrong length); ``wd_base_1ms``: WD_Base_1ms in DPV1_Status_1 is understood.
    ``max_diag_len``: octets of a whole diagnosis, 6..244.

    All times in ns on the bus's clock; nothing here may block or read a clock of its own. An exception takes the device
    out of data exchange until it is restarted.
    """

    ident: int = 0
    other_idents: Container[int] = frozenset()
    configs: tuple[bytes, ...] = (b"",)
    #: name for messages
    name: str = "device"
    fail_safe: bool = False
    #: a master that does not announce empty output frames in DPV1_Status_1 is refused
    fail_safe_required: bool = False
    #: the device takes part in SYNC
    sync_supported: bool = True
    #: the device takes part in FREEZE
    freeze_supported: bool = True
    #: a master can change the address by Set_Slave_Add
    set_slave_add: bool = False
    wd_base_1ms: bool = False
    max_diag_len: int = 244
    #: outputs while no master gives any (Clear, before the first exchange); empty for zeros
    safe: bytes = b""
    #: time of the next call of :meth:`tick`, in ns
    due_at: int = NEVER

    def services(self, report: Report) -> tuple[SlaveService, ...]:
        """Its services beyond DP-V0; their events go to ``report``. Raises ConfigError if they cannot be."""
        return ()

    def check_prm(self, user_prm: bytes) -> str | None:
        """Judge the user parameters of Set_Prm (without the seven fixed octets): a reason to refuse, or None."""
        return None

    def check_cfg(self, config: bytes) -> str | None:
        """Judge the identifier octets of Chk_Cfg: a reason to refuse, or None. Default: one of ``configs``."""
        if config in self.configs:
            return None
        known = " or ".join(c.hex(" ") for c in self.configs)
        return f"configuration {config.hex(' ')} is not {known}"

    def enter(self, config: bytes, now: int) -> None:
        """Configuration accepted: data exchange begins with ``config``."""

    def exchange(self, outputs: bytes, now: int) -> bytes:
        """One Data_Exchange: take ``outputs`` (as the configuration has them), return the inputs."""
        return b""

    def clear(self, now: int) -> None:
        """Global_Control Clear, or an empty output frame: outputs are void until :meth:`operate`."""

    def operate(self, now: int) -> None:
        """Global_Control Operate (called at every change from Clear, and once after entry)."""

    def leave(self, reason: Leave, now: int) -> None:
        """Data exchange ended; react as the device does to a lost master."""

    def ext_diag(self) -> bytes:
        """Octets after the six fixed ones of the diagnosis; empty when there is nothing to report."""
        return b""

    def user_diag(self) -> UserDiag:
        """The diagnosis of the device, read in every exchange. Default: a fault with :meth:`ext_diag`."""
        ext = self.ext_diag()
        return UserDiag(ext, True) if ext else NO_DIAG

    def address_set(self, address: int, fixed: bool, rem_slave_data: bytes) -> bool:
        """Set_Slave_Add gives the slave another address, 0..125; True when it is kept over a restart.

        ``fixed``: No_Add_Chg, no further change but by an initial reset, which comes here as address 126.
        ``rem_slave_data``: 0..240 octets, meant for this device.
        """
        return False

    def wake_at(self) -> int:
        """When :meth:`tick` is wanted, in ns, or NEVER; a device that computes it has its own method.

        The slave asks after each request, tick and command: only these may bring it forward.
        """
        return self.due_at

    def tick(self, now: int) -> int | None:
        """The time asked for has come. An address where the slave restarts by itself and stands there from then on."""

    def overrides_none(self, *methods: str) -> bool:
        """True if the device overrides none of ``methods``; then the slave need not call them."""
        return all(getattr(getattr(self, name), "__func__", None) is getattr(DpV0Device, name) for name in methods)
