"""``dpstack drive``: manual control of one drive, through a running master or as master in the foreground."""

from __future__ import annotations

import argparse
import asyncio
import functools
from collections.abc import Sequence
from typing import Final

from dpstack.api.bus.events_json import DriveEvent, Event, Notice, Severity, severity_of
from dpstack.api.config.config import Config, load_config
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.control.commands import Spec, find_word
from dpstack.api.control.drive_check import DriveCheck
from dpstack.api.control.drive_commands import (
    HALTS,
    LASTING,
    OPTIONS,
    PARAMETERS,
    READ_MANY,
    START,
    WORDS,
    carry_out,
)
from dpstack.api.control.own_master import OneDrive
from dpstack.api.control.remote_drive import RemoteDrive, find_drive
from dpstack.cli import options
from dpstack.cli.commands.drive_run import DUMP_AND_COMPARE, Order, Orders, check_orders, status_text
from dpstack.cli.commands.on_bus import refuse_application_watchdog, tell_simulated
from dpstack.cli.terminal import output
from dpstack.cli.terminal.lost_stdout import warn
from dpstack.cli.terminal.nonblocking_stdout import unhurried
from dpstack.cli.terminal.signals import INTERRUPTED, StopSignal
from dpstack.errors import UsageError

_WORDS: Final = (*(spec for spec in WORDS if spec.name not in (PARAMETERS, READ_MANY)), *DUMP_AND_COMPARE)
_FOR_FILES: Final = frozenset(spec.name for spec in DUMP_AND_COMPARE)
_FOR: Final = {**OPTIONS, "data_set": OPTIONS["data_set"] | _FOR_FILES, "all": frozenset({"compare"})}


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
    slave = _slave_of(config, args.name)
    orders = _orders(args)
    check_orders(DriveCheck(slave, simulated=config.virtual), orders)
    with unhurried(output.missing(args.json)):
        return asyncio.run(_run(config, slave, orders, args))


async def _run(config: Config, slave: SlaveConfig, orders: Sequence[Order], args: argparse.Namespace) -> int:
    with StopSignal() as stop:
        drive = await find_drive(config, slave.name)
        if drive is not None:
            try:
                return await _through_run(config, slave, orders, args, drive, stop)
            finally:
                drive.close()
        code = await _as_master(config, slave, orders, args, stop)
        return INTERRUPTED if stop.hurried else code


async def _through_run(
    config: Config,
    slave: SlaveConfig,
    orders: Sequence[Order],
    args: argparse.Namespace,
    drive: RemoteDrive,
    stop: StopSignal,
) -> int:
    wanted = (slave.address, slave.profile.name if slave.profile is not None else "")
    if (drive.address, drive.kind) != wanted:
        raise UsageError(
            f"{slave.name} is a {wanted[1]} at address {wanted[0]} in {args.config}, but a {drive.kind} at "
            f"{drive.address} for the run on {config.port} (pid {drive.pid}): the file was changed since that run "
            f"began; begin it anew"
        )
    if _FOR_FILES & {order.word for order in orders}:
        await drive.learn()
    work = Orders(drive, drive.order, orders, through="run", json=args.json)
    if not await stop.or_done(work.carry_out()):
        return _cut_short(work)
    if _last_motion(orders) == START and not args.json:
        output.line(
            f"it keeps running under the run on {config.port} (pid {drive.pid}): "
            f"`dpstack drive {args.config} {args.name} stop` stops it, and so does the end of that run"
        )
    return work.code


async def _as_master(
    config: Config, slave: SlaveConfig, orders: Sequence[Order], args: argparse.Namespace, stop: StopSignal
) -> int:
    if config.bus.read_only:
        raise UsageError("the configuration is read only: no drive can be given an order; leave read_only out")
    refuse_application_watchdog(config, "drive")
    tell_simulated(config)
    shown = _Shown(slave.name, json=args.json)
    async with OneDrive(config.only(slave), on_event=shown.event, on_stopping=shown.stopping) as drive:
        if not await stop.or_done(drive.come_up()):
            warn("ended before the drive was in data exchange")
            return 1
        tell = functools.partial(carry_out, drive.drive)
        work = Orders(drive.drive, tell, orders, through="master", json=args.json)
        if not await stop.or_done(work.carry_out()):
            return _cut_short(work)
        if _last_motion(orders) in LASTING:
            shown.hold(running=drive.drive.status.running)
            await stop.or_done(drive.held(args.seconds))
    if drive.unstopped is not None and not stop.hurried:
        warn(f"{drive.unstopped}; its outputs went to their safe values")
    return work.code or int(drive.unstopped is not None)


class _Shown:
    """Output of the master in the foreground about its drive."""

    def __init__(self, name: str, *, json: bool) -> None:
        self._name = name
        self._json = json
        self._holding = False

    def hold(self, *, running: bool) -> None:
        """Show every new status from now on."""
        self._holding = True
        if not running:
            warn(f"{self._name} does not run: `start` starts it, for instance: {self._name} start speed 0.5")
        if not self._json:
            does = "stops the drive by its ramp and ends" if running else "ends"
            output.line(f"master in the foreground until Ctrl-C, which {does}", "bold")

    def stopping(self) -> None:
        if not self._json:
            output.line(f"{self._name}: stopping by its ramp; a second Ctrl-C makes its outputs safe at once")

    def event(self, event: Event) -> None:
        if isinstance(event, Notice) and event.source == "plan":
            return  # `dpstack run` and `dpstack plan` show the findings of the plan
        if severity_of(event) is not Severity.INFO:
            warn(event.text)
        elif isinstance(event, DriveEvent):
            payload = event.payload
            if payload.get("type") == "notice":
                warn(f"drive {self._name}: {payload.get('text')}")
            elif payload.get("type") == "status" and self._holding and payload.get("state") != "offline":
                self._status({key: value for key, value in payload.items() if key != "type"})

    def _status(self, status: dict[str, object]) -> None:
        if self._json:
            output.json_line({"event": "status", "drive": self._name, "status": status})
        else:
            output.line(f"{self._name}: {status_text(status)}")


def _last_motion(orders: Sequence[Order]) -> str:
    """The last order that starts, holds or stops the drive; a set point after a start leaves it started."""
    last = ""
    for order in orders:
        if order.word in HALTS or order.word == START or (order.word in LASTING and last != START):
            last = order.word
    return last


def _cut_short(work: Orders) -> int:
    warn(f"ended before {work.at.word} was done" if work.at is not None else "ended before the first order")
    return 1


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
    given = {
        "data_set": args.data_set,
        "index": args.index,
        "ram": True if args.ram else None,
        "timeout": args.timeout,
        "all": True if args.all else None,
    }
    orders = []
    rest = list(args.orders)
    while rest:
        spec = find_word(rest.pop(0), _WORDS)
        orders.append(_order(spec, rest, given))
    for key, value in given.items():
        if value is not None and not _FOR[key] & {order.word for order in orders}:
            raise UsageError(f"--{key.replace('_', '-')} is for {', '.join(sorted(_FOR[key]))}: leave it out")
    return orders


def _order(spec: Spec, rest: list[str], given: dict[str, object]) -> Order:
    count = len(spec.usage.split())
    if len(rest) < count:
        raise spec.wrong_arguments()
    mine = {key: value for key, value in given.items() if value is not None and spec.name in _FOR[key]}
    taken = [rest.pop(0) for _ in range(count)]
    return Order(spec.name, tuple(taken), mine)
