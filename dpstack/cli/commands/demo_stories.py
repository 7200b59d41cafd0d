"""The programs that ``dpstack demo`` runs, one for each known drive, as a user would write them."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Final

from dpstack.api.slave.drive import Drive
from dpstack.errors import DriveError

_HOLD_S: Final = 0.5
#: Prints one line of a story.
Tell = Callable[[str], None]
#: Injects a fault into the simulated drive by code or name, as ``dpstack ctl PORT trip`` does.
Trip = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Story:
    """``play`` runs the drive in ``telegram`` (None: its default). An exception of it makes the exit code 1."""

    play: Callable[[Drive, Tell, Trip], Awaitable[None]]
    telegram: str | None = None


async def any_drive(drive: Drive, tell: Tell, trip: Trip) -> None:
    await _run(drive, tell, 0.5)
    await _stop(drive, tell)


async def demag(drive: Drive, tell: Tell, trip: Trip) -> None:
    """Parameter 412 leaves the factory as 44; only 1 lets the bus control the drive."""
    mode = await drive.read(412)
    tell(f"parameter 412 (local/remote) is {mode}: its contacts control it")
    _expect(drive, mode == 44, f"412 is {mode} instead of 44")
    await drive.write(412, 1)
    mode = await drive.read(412)
    tell(f"412 written and read back: {mode}, the bus controls it")
    _expect(drive, mode == 1, f"412 is {mode} instead of 1")
    await drive.write("ramp_set_point", 2)
    tell("434 (ramp set point) = 2: the line's set point alone counts")
    await _run(drive, tell, 0.5)
    kilohertz = await drive.read(400)
    tell(f"parameter 400 (switching frequency) read: {kilohertz} kHz")
    await _stop(drive, tell)


async def fuji(drive: Drive, tell: Tell, trip: Trip) -> None:
    """Forward, stop, reverse: the worked run of the manual."""
    await _run(drive, tell, 1.0)
    await _stop(drive, tell)
    await _run(drive, tell, -0.5)
    await _stop(drive, tell)


async def imo(drive: Drive, tell: Tell, trip: Trip) -> None:
    """Write the process data map first, then inject a fault, read its name and acknowledge it."""
    found = await drive.read_map(timeout=60)  # 22 parameters: long at 9.6 kbit/s
    tell(f"P15.02 to P15.23 as delivered carry {found['outputs'] or 'nothing'}: no set frequency")
    _expect(drive, found["outputs"] == "", f"its map is {found['outputs']}")
    found = await drive.write_map(outputs="set_frequency", inputs="frequency current torque fault_code", timeout=60)
    tell(f"PZD2 written: {found['outputs']}; it reports {found['inputs']}")
    await _run(drive, tell, 0.5)
    await _trip(drive, tell, trip, "OL1")
    await _run(drive, tell, -0.3)
    await _stop(drive, tell)


async def keb(drive: Drive, tell: Tell, trip: Trip) -> None:
    """Use its own parameter channel, then inject an overload, read its name from ru.00 and acknowledge it."""
    await drive.write("oP.3", 20.0)
    hertz = await drive.read("oP.3")
    tell(f"oP.3 (digital setpoint) written and read back: {hertz} Hz, 80 counts each")
    _expect(drive, hertz == 20.0, f"oP.3 is {hertz} instead of 20")
    await _run(drive, tell, 0.6)
    await _trip(drive, tell, trip, "E.OL")
    await _run(drive, tell, -0.4)
    await _stop(drive, tell)


async def ls(drive: Drive, tell: Tell, trip: Trip) -> None:
    """Write the process data map over the bus, then inject a fault that the module's history names."""
    await drive.write("dr-03", 2.0)
    tell(f"dr-03 (acceleration time) written and read back: {await drive.read('dr-03')} s")
    found = await drive.write_map(inputs="dr-03 In-90", outputs="dr-04", timeout=60)
    tell(f"Para Status {found['inputs']}, Para Control {found['outputs']}: COM-31.., COM-51.., COM-94 = 1")
    await drive.order("output", number="dr-04", value=1.5)
    await _run(drive, tell, 0.5)
    values = await drive.order("inputs")
    tell(f"mapped inputs: {values}")
    _expect(drive, values == {"dr-03": 2.0, "In-90": 0}, f"mapped inputs are {values}")
    await _trip(drive, tell, trip, "overcurrent")
    await _run(drive, tell, -0.25)
    await _stop(drive, tell)


#: at 9.6 kbit/s the questions of a plugin before its first start take some seconds
_START_S: Final = 30.0
STORIES: Final[dict[str, Story]] = {
    "demag-dedrive": Story(demag, "PPO1"),
    "fuji-frenic": Story(fuji, "PPO3"),
    "imo-hd2": Story(imo),
    "keb-f5": Story(keb),
    "ls-s100": Story(ls, "PPO5"),
}
OTHERS: Final = Story(any_drive)


async def _run(drive: Drive, tell: Tell, speed: float) -> None:
    drive.speed = speed
    await drive.start(timeout=_START_S)
    tell(f"running towards {speed:.0%}")
    await drive.reached()
    actual = drive.status.speed
    _expect(drive, actual is not None and abs(actual - speed) < 0.02, f"reached, but at {actual} instead of {speed}")
    tell(f"{speed:.0%} of the reference reached")
    await asyncio.sleep(_HOLD_S)  # so that the live table shows it


async def _trip(drive: Drive, tell: Tell, trip: Trip, name: str) -> None:
    """Inject a fault, wait until the drive reports it by name, acknowledge it."""
    trip(name)
    async for status in drive.statuses():
        if status.fault and name in status.fault:
            tell(f"tripped: {status.fault}")
            break
    await drive.acknowledge()
    tell("acknowledged")


async def _stop(drive: Drive, tell: Tell) -> None:
    await drive.stop()
    status = drive.status
    _expect(drive, not status.running and abs(status.speed or 0.0) < 0.02, f"stopped, but at {status.speed}")
    tell("ramped down and switched off")


def _expect(drive: Drive, as_told: bool, otherwise: str) -> None:
    if not as_told:
        raise DriveError(drive.name, f"drive {drive.name}: {otherwise}")
