"""Shared parts of the commands that open a bus: port options, baud rate, checks and the control socket."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from typing import TYPE_CHECKING, Final

from msgspec import structs

from dpstack.api.bus.bus import Bus
from dpstack.api.bus.core import BusFailed
from dpstack.api.bus.events_json import AddressCollision, Event, MasterSeen, Notice, RingJoined, Severity
from dpstack.api.config.config import AUTO, Config, make_config
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.control.control_server import ControlServer
from dpstack.cli import options
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.errors import BusError, PortError, UsageError

if TYPE_CHECKING:
    from dpstack.api.commissioning.live_list import MakeBus

#: time-out in s of data exchange: a slave that searches for the baud rate takes its time
READY_S: Final = 10.0
#: text of ``--baud`` of commands that listen first
RATE: Final = "the rate (default auto: found by listening, if a master is on the bus)"


def add_port(parser: Parser) -> None:
    parser.value("--port", "P", "the port", required=True)
    parser.value("--baud", "B|auto", RATE, type=options.baud_or_auto, default=AUTO)
    options.add_own_address(parser, "")


def check_port(args: argparse.Namespace) -> None:
    """Raises UsageError for a port without other stations."""
    if args.port in ("virtual", "pty"):
        raise UsageError(f'{args.command}: nobody is on port "{args.port}"; name the port of a bus')


async def rate_of(args: argparse.Namespace) -> int:
    """The baud rate of the arguments, or the one found by listening. Raises BusError."""
    if args.baud != AUTO:
        return int(args.baud)
    from dpstack.api.bus.find_baud import find_baud  # here, as most rates are given

    report = await find_baud(args.port, naming=0)
    if report.baud is None:
        raise BusError(
            f"{args.port}: {report.text}; on a bus without a master give the rate, for instance --baud 500000"
        )
    if not args.json:
        output.warn(report.text)
    return report.baud


def bus_maker(args: argparse.Namespace, baud: int, **bus: object) -> MakeBus:
    """A function that makes buses without slaves on the port. ``bus``: further keys of [bus]."""

    def make_bus(address: int) -> Bus:
        config = make_config(args.port, baud, address, where=args.command, bus=bus)
        return Bus(config, on_event=once(teller(args)), watched=False)

    return make_bus


def teller(args: argparse.Namespace) -> Callable[[Event], None]:
    """A function that prints warnings and errors of a bus, and the masters whose token the command waits for."""

    def tell(event: Event) -> None:
        if event.severity is not Severity.INFO:
            output.warn(event.text)
        elif isinstance(event, MasterSeen) and event.present and not args.json:
            output.warn(f"master {event.address} is on this bus: {args.command} waits until it is let into the ring")

    return tell


def class2_maker(config: Config, *, slaves: tuple[SlaveConfig, ...] = (), read_only: bool = True) -> MakeBus:
    """A function that makes buses on the port of ``config`` for a master of class 2 beside the other masters. A bus has
    only ``slaves``. On the port "virtual" the slaves of ``config`` are simulated for it, with a warning."""
    warn_of_simulation(config)
    world = None
    if config.virtual:
        from dpstack.api.bus.virtual import World, simulate  # here, as a real port needs neither

        world = World()
        simulate(world, config.slaves, baud=config.baud)

    def make_bus(address: int) -> Bus:
        settings = structs.replace(
            config.bus,
            address=address,
            read_only=read_only,
            cycle_ms=None,
            cycle_freeze=(),
            cycle_sync=(),
            auto_clear=False,
        )
        made = dataclasses.replace(config, bus=settings, slaves=slaves, ppi=())
        return Bus(made, on_event=once(warn_of), world=world)

    return make_bus


def stations_of(config: Config) -> set[int]:
    """The addresses of the master, of all slaves, and of the S7-200 CPUs."""
    return {config.bus.address, *(one.address for one in config.slaves), *(one.address for one in config.ppi)}


def warn_of(event: Event) -> None:
    """Print a warning or error; not the findings of the plan, which `dpstack run` and `dpstack plan` show."""
    if event.severity is not Severity.INFO and not (isinstance(event, Notice) and event.source == "plan"):
        output.warn(event.text)


def once(tell: Callable[[Event], None]) -> Callable[[Event], None]:
    """``tell`` for the events of one bus, without those that are also raised: the command prints the exception."""
    in_ring = False

    def shown(event: Event) -> None:
        nonlocal in_ring
        in_ring = in_ring or isinstance(event, RingJoined)
        # before the ring is joined, a collision is raised as BusError or the next address is tried
        collided = isinstance(event, AddressCollision) and not in_ring
        if not (collided or isinstance(event, BusFailed)):
            tell(event)

    return shown


def slave_of(config: Config, name: str) -> SlaveConfig:
    """The slave ``name`` (or address) of ``config``. Raises UsageError naming the slaves there are."""
    slave = config.find(name)
    if slave is not None:
        return slave
    for cpu in config.ppi:
        if name in (cpu.name, str(cpu.address)):
            raise UsageError(
                f"{cpu.who} is an S7-200, which this command cannot ask: `dpstack ppi` can, or while a run holds the "
                "port `dpstack ctl PORT status`"
            )
    known = ", ".join(f"{slave.address} ({slave.name})" for slave in config.slaves) or "none"
    raise UsageError(f"no slave {name!r} in this configuration; there are: {known}")


def warn_of_simulation(config: Config) -> None:
    """Warn that the slaves of the port "virtual" are simulated for this one command."""
    if config.virtual:
        output.warn(
            'no run on "virtual" has this configuration: its slaves are simulated for this command only; '
            "`dpstack run` with this configuration keeps them, and is asked then"
        )


def refuse_application_watchdog(config: Config, command: str) -> None:
    """Raises ConfigError if ``config`` has an application watchdog: ``command`` never calls ``alive()``."""
    if config.bus.application_watchdog_ms:
        raise config.source.error(
            ("bus", "application_watchdog_ms"),
            "[bus]: application_watchdog_ms is for a program that calls bus.alive(), "
            f"which `dpstack {command}` does not",
            "leave it out of this file, or set it to 0",
        )


@asynccontextmanager
async def reachable(server: ControlServer, *, quiet: bool = False) -> AsyncIterator[str | None]:
    """Open the control socket for ``dpstack ctl``. A failure does not stop the command: its text is the value of
    the context, and is printed unless ``quiet``.
    """
    why = None
    async with AsyncExitStack() as stack:
        try:
            await stack.enter_async_context(server)
            why = server.remark
        except PortError as error:
            why = str(error)
        if why is not None and not quiet:
            output.warn(why)
        yield why
