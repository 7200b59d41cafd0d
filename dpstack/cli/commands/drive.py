"""``dpstack drive``: manual control of one drive, through a running master or as master in the foreground."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

from dpstack.api.bus.events_json import DriveEvent, Event, Notice, Severity, severity_of
from dpstack.api.bus.open_bus import open_bus
from dpstack.api.config.config import Config, load_config
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.control.commands import Order, find_word
from dpstack.api.control.drive_orders import (
    ARGUMENTS,
    HALTS,
    LASTING,
    OPTIONS,
    PARAMETERS,
    READ_MANY,
    START,
    WORDS,
    carry_out,
)
from dpstack.api.control.remote import RemoteDrive, find_drive
from dpstack.api.slave.drive import Drive
from dpstack.cli import options
from dpstack.cli.commands.drive_run import DUMP_AND_COMPARE, Orders, check_orders, status_text
from dpstack.cli.commands.on_bus import READY_S, refuse_application_watchdog, tell_simulated
from dpstack.cli.terminal import output
from dpstack.cli.terminal.lost_stdout import warn
from dpstack.cli.terminal.nonblocking_stdout import unhurried
from dpstack.cli.terminal.signals import INTERRUPTED, StopSignal
from dpstack.errors import DpError, DriveError, DriveFault, SlaveFault, UsageError
from dpstack.profile import MOVING

_WORDS: Final = (*(spec for spec in WORDS if spec.name not in (PARAMETERS, READ_MANY)), *DUMP_AND_COMPARE)
_FOR_FILES: Final = frozenset(spec.name for spec in DUMP_AND_COMPARE)
#: by option: the words that it is for
_FOR: Final = {**OPTIONS, "data_set": OPTIONS["data_set"] | _FOR_FILES, "all": frozenset({"compare"})}
#: time-out in s of the first status of the drive
_STATUS_S: Final = 2.0


def add_to(parser: argparse.ArgumentParser) -> None:
    parser.epilog = (
        "example: dpstack drive plant.toml hoist status\n"
        "         dpstack drive plant.toml hoist start speed 0.5 reached\n"
        "         dpstack drive plant.toml hoist dump hoist.toml\n\norders, one or several, in turn:\n"
        + "\n".join(f"  {f'{spec.name} {spec.usage}':13} {spec.text}" for spec in _WORDS)
    )
    parser.add_argument("config", metavar="CONFIG", help="configuration file")
    parser.add_argument("name", metavar="NAME", help="the drive, by its name there or its address")
    parser.add_argument("orders", metavar="ORDER", nargs="+", help="what it is to do, see below")
    options.add_other_port(parser)
    parser.add_argument("--data-set", metavar="N", type=options.whole, help="of read, write, dump and compare")
    parser.add_argument("--index", metavar="N", type=options.whole, help="of read and write: the element of an array")
    parser.add_argument("--ram", action="store_true", help="write: do not store it in the EEPROM")
    parser.add_argument("--timeout", metavar="S", type=options.seconds, help="for each order that takes its time")
    parser.add_argument("--all", action="store_true", help="compare: what is read only, too")
    parser.add_argument("--seconds", metavar="S", type=options.seconds, help="in the foreground: end after so long")
    options.run_by(parser, execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 where an order fails or a compare finds a difference."""
    config = load_config(args.config).with_bus(port=args.port, baud=args.baud)
    command = _Command(args, config, _slave_of(config, args.name), _orders(args))
    check_orders(command.slave, command.orders, simulated=config.virtual)
    with unhurried(output.missing(args.json)):
        return asyncio.run(command.run())


@dataclass(frozen=True, slots=True)
class _Command:
    """``orders`` to the drive of ``slave``."""

    args: argparse.Namespace
    config: Config
    slave: SlaveConfig
    orders: Sequence[Order]

    async def run(self) -> int:
        with StopSignal() as stop:
            drive = await find_drive(self.config, self.slave.name)
            if drive is not None:
                with drive.client:
                    return await self._through_run(drive, stop)
            code = await self._as_master(stop)
            return INTERRUPTED if stop.hurried else code

    async def _through_run(self, drive: RemoteDrive, stop: StopSignal) -> int:
        args, slave = self.args, self.slave
        run = f"the run on {self.config.port} (pid {drive.client.pid})"
        kind = "" if slave.profile is None else slave.profile.name
        if (drive.address, drive.kind) != (slave.address, kind):
            raise UsageError(
                f"{slave.name} is a {kind} at address {slave.address} in {args.config}, but a {drive.kind} at "
                f"{drive.address} for {run}: the file was changed since that run began; begin it anew"
            )
        if any(order.word in _FOR_FILES for order in self.orders):
            drive = await drive.listed()
        work = Orders(drive, drive.carry_out, through="run", json=args.json)
        if await work.are_done(self.orders, stop) and _last_motion(self.orders) == START and not args.json:
            output.line(
                f"it keeps running under {run}: "
                f"`dpstack drive {args.config} {args.name} stop` stops it, and so does the end of that run"
            )
        return work.code

    async def _as_master(self, stop: StopSignal) -> int:
        config, args = self.config, self.args
        if config.bus.read_only:
            raise UsageError("the configuration is read only: no drive can be given an order; leave read_only out")
        refuse_application_watchdog(config, "drive")
        tell_simulated(config)
        async with OneDrive(config, self.slave, json=args.json) as master:
            if not await stop.or_done(master.come_up()):
                warn("ended before the drive was in data exchange")
                return 1
            work = Orders(master.drive, partial(carry_out, master.drive), through="master", json=args.json)
            if not await work.are_done(self.orders, stop):
                return work.code
            if _last_motion(self.orders) in LASTING:
                await stop.or_done(master.held(args.seconds))
        if master.unstopped is not None and not stop.hurried:
            warn(f"{master.unstopped}; its outputs went to their safe values")
        return work.code or int(master.unstopped is not None)


class OneDrive:
    """The drive of ``slave`` under a master in the foreground (``async with``), which leaves all other slaves alone.

    On leaving, however that comes, the drive stops by its ramp; then the bus ends (safe values, Clear, out of the
    ring).
    """

    def __init__(self, config: Config, slave: SlaveConfig, *, json: bool) -> None:
        self._bus = open_bus(config.only(slave), on_event=self._on_event)
        self._slave = slave
        self._json = json
        self._holding = False
        #: why it did not stop by its ramp
        self.unstopped: DpError | None = None

    @property
    def drive(self) -> Drive:
        """The drive. Raises UsageError while the baud rate is searched."""
        return self._bus.drive(self._slave.address)

    async def __aenter__(self) -> OneDrive:
        return self

    async def __aexit__(self, *_exc: object) -> None:
        try:
            await self._stop()
        finally:
            await self._bus.close()

    async def come_up(self) -> None:
        """Into the ring, in data exchange, its first status. Raises PortError, BusError, SlaveFault, SlaveTimeout."""
        await self._bus.open()
        await self._bus.operate()
        await self.drive.slave.ready(READY_S)
        with contextlib.suppress(DriveError):  # a drive without a status can still get commands
            await self.drive.settled(_STATUS_S)

    async def held(self, seconds: float | None) -> None:
        """Show every new status until the time in seconds is over.

        Raises DriveFault when a drive that runs now stops by itself, SlaveFault when it is lost.
        """
        name, running = self._slave.name, self.drive.status.running
        self._holding = True
        if not running:
            warn(f"{name} does not run: `start` starts it, for instance: {name} start speed 0.5")
        if not self._json:
            does = "stops the drive by its ramp and ends" if running else "ends"
            output.line(f"master in the foreground until Ctrl-C, which {does}", "bold")
        with contextlib.suppress(TimeoutError):
            await self._bus.until(lambda: self._is_over(running), seconds)

    def _is_over(self, running: bool) -> bool:
        slave, status = self.drive.slave, self.drive.status
        if slave.fault is not None or not slave.ready_now:
            why = slave.fault.text if slave.fault is not None else f"it is in {slave.state.value}"
            raise SlaveFault(slave.address, f"drive {slave.name}: slave {slave.address} is lost: {why}")
        if running and not status.running:
            why = f"fault {status.fault}" if status.fault else f"it reports {status.state}"
            raise DriveFault(slave.name, f"drive {slave.name} stopped by itself: {why}")
        return False

    async def _stop(self) -> None:
        """By its ramp, where it still can."""
        if self._bus.searching or not self._bus.is_open:
            return
        drive = self.drive
        if drive.slave.fault is None and drive.slave.ready_now and drive.status.state in MOVING:
            if not self._json:
                output.line(f"{drive.name}: stopping by its ramp; a second Ctrl-C makes its outputs safe at once")
            try:
                await drive.stop()
            except DpError as error:
                self.unstopped = error

    def _on_event(self, event: Event) -> None:
        name = self._slave.name
        if isinstance(event, Notice) and event.source == "plan":
            return  # `dpstack run` and `dpstack plan` show the findings of the plan
        if severity_of(event) is not Severity.INFO:
            warn(event.text)
        elif isinstance(event, DriveEvent):
            payload = event.payload
            if payload.get("type") == "notice":
                warn(f"drive {name}: {payload.get('text')}")
            elif payload.get("type") == "status" and self._holding and payload.get("state") != "offline":
                status = {key: value for key, value in payload.items() if key != "type"}
                if self._json:
                    output.json_line({"event": "status", "drive": name, "status": status})
                else:
                    output.line(f"{name}: {status_text(status)}")


def _last_motion(orders: Sequence[Order]) -> str:
    """The last order that starts, holds or stops the drive; a set point after a start leaves it started."""
    last = ""
    for order in orders:
        if order.word in HALTS or order.word == START or (order.word in LASTING and last != START):
            last = order.word
    return last


def _slave_of(config: Config, name: str) -> SlaveConfig:
    """Raises UsageError naming the drives there are."""
    drives = [slave for slave in config.slaves if slave.profile is not None]
    slave = config.find(name)
    if slave in drives:
        return slave
    if slave is not None:
        raise UsageError(f"slave {slave.address} ({slave.name}) is no drive; give it `drive = ...` in its table")
    known = ", ".join(f"{slave.name} ({slave.address})" for slave in drives) or "none"
    raise UsageError(f"no drive {name!r} in this configuration; there are: {known}")


def _orders(args: argparse.Namespace) -> list[Order]:
    """The orders of the command line, each with its arguments and options. Raises UsageError."""
    given = {key: getattr(args, key) for key in _FOR}
    given = {key: value for key, value in given.items() if value is not None and value is not False}
    orders = []
    rest = list(args.orders)
    while rest:
        spec = find_word(rest.pop(0), _WORDS)
        count = len(spec.usage.split())
        own = {key: value for key, value in given.items() if spec.name in _FOR[key]}
        orders.append(spec.order(rest[:count], ARGUMENTS, own))
        del rest[:count]
    for key in given:
        if not _FOR[key] & {order.word for order in orders}:
            raise UsageError(f"--{key.replace('_', '-')} is for {', '.join(sorted(_FOR[key]))}: leave it out")
    return orders
