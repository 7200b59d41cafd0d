"""Orders to the DP master and its modes."""

from __future__ import annotations

from collections.abc import Mapping

from dpstack.dp.slave_params import SlaveParams
from dpstack.machine import Order
from dpstack.text import NamedInt


class Mode(NamedInt):
    """The modes of a class 1 master (values as masters report them)."""

    OFFLINE = 0x00  # not in the ring
    STOP = 0x40  # in the ring, nothing is sent to slaves
    CLEAR = 0x80  # inputs are read, outputs are zero (empty for Fail_Safe slaves)
    OPERATE = 0xC0


class SetMode(Order):
    """Go to ``mode``, up at once; down from Operate through safe values (as at the end) and Clear.

    ``ModeChanged`` reports each mode on the way.
    """

    mode: Mode


class Alive(Order):
    """The application is alive: restart the application watchdog, if it is armed. ``limit_ns``: arm it for so long in
    Operate, 0 switches it off; None, and a master whose settings have a watchdog, leave it as it is armed."""

    limit_ns: int | None = None


class Shutdown(Order):
    """The ordered end: safe values (a cycle, and 50 ms if they are not zeros), Clear twice, out of the ring; then
    ``MasterStopped``."""

    ENDS = True


class AddSlave(Order):
    """Add one more slave while the bus runs."""

    setup: SlaveParams


class RemoveSlave(Order):
    """Remove a slave: safe outputs for 50 ms, unlock. A slave added at this address meanwhile waits for that."""

    address: int


class DeactivateSlave(Order):
    """Take a slave out of service as :class:`RemoveSlave` does, but keep it; :class:`ActivateSlave` brings it back."""

    address: int


class ActivateSlave(Order):
    """Bring a deactivated slave up again."""

    address: int


class ReparameteriseSlave(Order):
    """Give the slave at ``setup.address`` other parameters: safe outputs for 50 ms, unlock, a new bring-up.

    With the same lengths the slave keeps its process image and its drive plugin. With other lengths it gets a new
    image; for a slave with a drive plugin that order is refused.
    """

    setup: SlaveParams


class SendControl(Order):
    """Global_Control with one or more of SYNC, UNSYNC, FREEZE, UNFREEZE to ``groups`` (1..8; none: to all slaves).

    ``settle``: first one whole Data_Exchange with every slave concerned. ``picture``: afterwards another one, whose
    inputs ``PictureTaken`` reports. The master sends it exactly once and reports ``ControlSent``, or ``ControlFailed``.
    """

    token: int
    groups: tuple[int, ...] = ()
    sync: bool = False
    unsync: bool = False
    freeze: bool = False
    unfreeze: bool = False
    settle: bool = False
    picture: bool = False


class DriveCommand(Order):
    """An order to the drive plugin of the slave at ``address``; the result is a ``DriveEvent`` with ``token``."""

    address: int
    op: str
    args: Mapping[str, object]
    token: int

    @property
    def ends(self) -> bool:
        """Whether this ends an earlier order."""
        return self.op == "cancel"
