"""A master for one drive of a configuration: the others are left alone; on leaving, the drive is stopped in order."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from types import TracebackType
from typing import Final

from dpstack.api.bus.open_bus import open_bus
from dpstack.api.config.config import Config
from dpstack.api.slave.drive import Drive
from dpstack.api.streams import OnEvent
from dpstack.errors import DpError, DriveError, DriveFault, SlaveFault
from dpstack.profile import MOVING
from dpstack.sim.world import World

#: a slave that searches for the baud rate takes its time
READY_S: Final = 10.0
_TOLD_S: Final = 2.0


class OneDrive:
    """The first slave of ``config`` under a master of its own (``async with``): :attr:`drive`.

    On leaving, however that comes: its ramp, then the bus's end (safe values, Clear, out of the ring). ``on_stopping``
    is called where there is something to stop.
    """

    def __init__(
        self, config: Config, *, on_event: OnEvent, on_stopping: Callable[[], None], world: World | None = None
    ) -> None:
        self._bus = open_bus(config, on_event=on_event, world=world)
        self._slave = config.slaves[0]
        self._on_stopping = on_stopping
        #: why it did not stop by its ramp
        self.unstopped: DpError | None = None

    async def __aenter__(self) -> OneDrive:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            await self._stop()
        finally:
            await self._bus.close()

    async def come_up(self) -> None:
        """Into the ring, in data exchange, its first status. Raises PortError, BusError, SlaveFault, SlaveTimeout."""
        bus = self._bus
        await bus.open()
        await bus.operate()
        await bus.slave(self._slave.address).ready(READY_S)
        with contextlib.suppress(DriveError):  # a drive without a status can still get commands
            await self.drive.settled(_TOLD_S)

    async def held(self, seconds: float | None) -> None:
        """Until the time in seconds is over.

        Raises DriveFault when a drive that runs now stops by itself, SlaveFault when it is lost.
        """
        running = self.drive.status.running
        with contextlib.suppress(TimeoutError):
            await self._bus.until(lambda: self._is_over(running), seconds)

    # -- the drive -----------------------------------------------------------------------------------------------

    @property
    def drive(self) -> Drive:
        """The drive. Raises UsageError while the baud rate is searched."""
        return self._bus.drive(self._slave.address)

    # -- inside --------------------------------------------------------------------------------------------------

    def _is_over(self, running: bool) -> bool:
        drive = self.drive
        slave = drive.slave
        if slave.fault is not None or not slave.ready_now:
            why = slave.fault.text if slave.fault is not None else f"it is in {slave.state.value}"
            raise SlaveFault(slave.address, f"drive {slave.name}: slave {slave.address} is lost: {why}")
        status = drive.status
        if running and not status.running:
            why = f"fault {status.fault}" if status.fault else f"it reports {status.state}"
            raise DriveFault(drive.name, f"drive {drive.name} stopped by itself: {why}")
        return False

    async def _stop(self) -> None:
        """By its ramp, where it still can."""
        if self._bus.searching or not self._bus.is_open:
            return
        drive = self.drive
        if drive.slave.fault is None and drive.slave.ready_now and drive.status.state in MOVING:
            self._on_stopping()
            try:
                await drive.stop()
            except DpError as error:
                self.unstopped = error
