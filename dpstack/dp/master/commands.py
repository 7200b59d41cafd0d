"""Orders to the DP master and its modes."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum

from dpstack.dp.slave_params import SlaveParams
from dpstack.machine import Order


class Mode(IntEnum):
    """The modes of a class 1 master (values as masters report them)."""

    OFFLINE = 0x00  # not in the ring
    STOP = 0x40  # in the ring, nothing is sent to slaves
    CLEAR = 0x80  # inputs are read, outputs are zero (empty for Fail_Safe slaves)
    OPERATE = 0xC0


class SetMode(Order):
    """Go to ``mode``, up at once; down from Operate through safe values (as at the end) and Clear.

    Each mode reached on the way is told by ``ModeChanged``.
    """

    mode: Mode


class Alive(Order):
    """The application is alive: the application watchdog begins anew. Changes nothing while it is not armed."""


class Shutdown(Order):
    """The end in order: safe values (a cycle, and 50 ms where they are not zeros), Clear twice, out of the ring; then
    ``MasterStopped``."""

    ENDS = True


class AddSlave(Order):
    """Take up one more slave while the bus runs."""

    setup: SlaveParams


class RemoveSlave(Order):
    """Give a slave up: safe outputs for 50 ms, unlock; one that was added at its address meanwhile waits for that."""

    address: int


class DeactivateSlave(Order):
    """Take a slave out of service as :class:`RemoveSlave` does, but keep it: nothing is sent to it until activated."""

    address: int


class ActivateSlave(Order):
    """Bring a deactivated slave up again."""

    address: int


class ReparameteriseSlave(Order):
    """Give the slave at ``setup.address`` other parameters: safe outputs for 50 ms, unlock, a new bring-up.

    Its process image stays the same object where the lengths stay the same, and so does its drive plugin; with other
    lengths they are made anew (a slave with a drive plugin is refused then).
    """

    setup: SlaveParams


class SendControl(Order):
    """Global_Control with one or more of SYNC, UNSYNC, FREEZE, UNFREEZE to ``groups`` (1..8; none: to all slaves).

    ``settle``: first one whole Data_Exchange with every slave concerned. ``picture``: afterwards another one, whose
    inputs come as ``PictureTaken``. Sent exactly once: ``ControlSent``, or ``ControlFailed`` when it never can be.
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
        """``cancel`` takes back an order before."""
        return self.op == "cancel"
