"""``dpstack drive``: manual control of one drive, through a running master or as master in the foreground."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, Final

from dpstack.api.bus.compose import core_of
from dpstack.api.bus.events_json import DRIVE, DriveEvent, Event, Severity
from dpstack.api.bus.opening import open_bus
from dpstack.api.config.config import Config, load_config
from dpstack.api.config.drives_source import DriveConfig
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.control import drive_orders as words
from dpstack.api.control.commands import ParsedCommand, Spec, find_word
from dpstack.api.control.orders import LASTING
from dpstack.api.control.remote import RemoteDrive, find_drive
from dpstack.api.lists.parameter_list import (
    OnParameter,
    Readable,
    SavedParam,
    check_compare,
    check_dump,
    label,
    value_text,
)
from dpstack.api.slave.drive import Drive, declared_parameters
from dpstack.cli import options
from dpstack.cli.commands import on_bus
from dpstack.cli.commands.lists import show_comparison, show_dump
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.cli.terminal.drawing import progress_bar
from dpstack.cli.terminal.nonblocking_stdout import reader_watched, run_unhurried
from dpstack.cli.terminal.signals import INTERRUPTED, StopSignal
from dpstack.errors import DpError, DriveError, DriveFault, SlaveFault, UsageError
from dpstack.plant.orders import HALTS
from dpstack.profile import MOVING, DriveCore, ListedParam

DUMP_AND_COMPARE: Final = (
    Spec("dump", "FILE", "all declared parameters into a file", "hoist.toml"),
    Spec("compare", "FILE", "where the drive differs from such a file", "hoist.toml"),
)
_WORDS: Final = (
    *(spec for spec in words.WORDS if spec.name not in (words.PARAMETERS, words.READ_MANY)),
    *DUMP_AND_COMPARE,
)
_FOR_FILES: Final = frozenset(spec.name for spec in DUMP_AND_COMPARE)
#: by option: the words that it is for
_FOR: Final = {
    **words.OPTIONS,
    "data_set": words.OPTIONS["data_set"] | _FOR_FILES,
    "read_only": frozenset({"compare"}),
}
#: time-out in s of the first status of the drive
_STATUS_S: Final = 2.0


def add_to(parser: Parser) -> None:
    parser.epilog = (
        "example: dpstack drive plant.toml hoist status\n"
        "         dpstack drive plant.toml hoist start speed 0.5 reached\n"
        "         dpstack drive plant.toml hoist dump hoist.toml\n\norders, one or several, in turn:\n"
        + "\n".join(f"  {f'{spec.name} {spec.usage}':13} {spec.text}" for spec in _WORDS)
    )
    parser.value("config", "CONFIG", "configuration file")
    parser.value("name", "NAME", "the drive, by its name there or its address")
    parser.value("orders", "ORDER", "what it is to do, see below", nargs="+")
    options.add_other_port(parser)
    parser.value("--data-set", "N", "of read, write, dump and compare", type=options.whole)
    parser.value("--index", "N", "of read and write: the element of an array", type=options.whole)
    parser.flag("--ram", "write: do not store it in the EEPROM")
    parser.value("--timeout", "S", "for each order that takes its time", type=options.seconds)
    parser.flag("--all", "compare: what is read only, too", dest="read_only")
    parser.value("--seconds", "S", "in the foreground: end after S seconds", type=options.seconds)
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 if an order fails or a compare finds a difference."""
    config = load_config(args.config).with_bus(port=args.port, baud=args.baud)
    command = _Command(args, config, *_drive_of(config, args.name), _orders(args))
    _check_orders(command.slave, command.drive, command.orders, simulated=config.virtual)
    return run_unhurried(command.run(), json=args.json)


@dataclasses.dataclass(frozen=True, slots=True)
class _Command:
    """``orders`` to the drive of ``slave``, or to ``drive``, one of its several."""

    args: argparse.Namespace
    config: Config
    slave: SlaveConfig
    drive: DriveConfig | None
    orders: Sequence[ParsedCommand]

    async def run(self) -> int:
        with StopSignal() as stop:
            drive = await find_drive(self.config, (self.drive or self.slave).name)
            if drive is not None:
                with drive.client:
                    return await self._through_run(drive, stop)
            with reader_watched():
                code = await self._as_master(stop)
            return INTERRUPTED if stop.hurried else code

    async def _through_run(self, drive: RemoteDrive, stop: StopSignal) -> int:
        args, slave = self.args, self.slave
        run = f"the run on {self.config.port} (pid {drive.client.pid})"
        profile = (self.drive or slave).profile
        kind = "" if profile is None else profile.name
        if (drive.address, drive.kind) != (slave.address, kind):
            raise UsageError(
                f"{drive.name} is a {kind} at address {slave.address} in {args.config}, but a {drive.kind} "
                f"at {drive.address} for {run}: the file was changed since that run began; begin it anew"
            )
        if any(order.word in _FOR_FILES for order in self.orders):
            drive = await drive.listed()
        work = _Orders(drive, drive.carry_out, self.orders, "run", args.json)
        if await work.are_done(stop) and _last_motion(self.orders) == words.START and not args.json:
            output.line(
                f"it keeps running under {run}: "
                f"`dpstack drive {args.config} {args.name} stop` stops it, and so does the end of that run"
            )
        return work.code

    async def _as_master(self, stop: StopSignal) -> int:
        config, args = self.config, self.args
        if config.bus.read_only:
            raise UsageError("the configuration is read only: no drive can be given an order; leave read_only out")
        on_bus.refuse_application_watchdog(config, "drive")
        on_bus.warn_of_simulation(config)
        async with OneDrive(config, self.slave, self.drive, json=args.json) as master:
            if not await stop.or_done(master.come_up()):
                output.warn("ended before the drive was in data exchange")
                return 1
            work = _Orders(master.drive, partial(words.carry_out, master.drive), self.orders, "master", args.json)
            if not await work.are_done(stop):
                return work.code
            if _last_motion(self.orders) in LASTING:
                await stop.or_done(master.held(args.seconds))
        if master.unstopped is not None and not stop.hurried:
            output.warn(f"{master.unstopped}; its outputs went to their safe values")
        return work.code or int(master.unstopped is not None)


class OneDrive:
    """The drive of ``slave``, or ``drive``, one of its several, under a master in the foreground (``async with``),
    which leaves all other slaves alone.

    On leaving, however that comes, the drive stops by its ramp; then the bus ends (safe values, Clear, out of the
    ring).
    """

    def __init__(self, config: Config, slave: SlaveConfig, drive: DriveConfig | None, *, json: bool) -> None:
        self._bus = open_bus(config.only(slave), on_event=self._on_event)
        self._slave = slave
        self._name = (drive or slave).name
        self._json = json
        self._holding = False
        #: why it did not stop by its ramp
        self.unstopped: DpError | None = None

    @property
    def drive(self) -> Drive:
        """The drive. Raises UsageError while the baud rate is searched."""
        return self._bus.drive(self._name)

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
        await self.drive.slave.ready(on_bus.READY_S)
        with contextlib.suppress(DriveError):  # a drive without a status can still get commands
            await self.drive.settled(_STATUS_S)

    async def held(self, seconds: float | None) -> None:
        """Show every new status until the time in seconds is over.

        Raises DriveFault when a drive that runs now stops by itself, SlaveFault when it is lost.
        """
        name, running = self._name, self.drive.status.running
        self._holding = True
        if not running:
            output.warn(f"{name} does not run: `start` starts it, for instance: {name} start speed 0.5")
        if not self._json:
            does = "stops the drive by its ramp and ends" if running else "ends"
            output.line(f"master in the foreground until Ctrl-C, which {does}", "bold")
        with contextlib.suppress(TimeoutError):
            await self._bus.until(lambda: self._is_over(running), seconds)

    def _is_over(self, running: bool) -> bool:
        slave, status = self.drive.slave, self.drive.status
        if slave.fault is not None or not slave.ready_now:
            why = slave.fault.text if slave.fault is not None else f"it is in {slave.state.value}"
            raise SlaveFault(slave.address, f"drive {self._name}: slave {slave.address} is lost: {why}")
        if running and not status.running:
            why = f"fault {status.fault}" if status.fault else f"it reports {status.state}"
            raise DriveFault(self._name, f"drive {self._name} stopped by itself: {why}")
        return False

    async def _stop(self) -> None:
        """By its ramp, if it still can."""
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
        name = self._name
        on_bus.warn_of(event)
        if isinstance(event, DriveEvent) and event.severity is Severity.INFO:
            payload = event.payload
            if payload.get(DRIVE, name) != name:
                return  # of another drive in the same slave
            if payload.get("type") == "notice":
                output.warn(f"drive {name}: {payload.get('text')}")
            elif payload.get("type") == "status" and self._holding and payload.get("state") != "offline":
                status = {key: value for key, value in payload.items() if key not in ("type", DRIVE)}
                if self._json:
                    output.json_line({"event": "status", "drive": name, "status": status})
                else:
                    output.line(f"{name}: {_status_text(status)}")


def _last_motion(orders: Sequence[ParsedCommand]) -> str:
    """The last order that starts, holds or stops the drive; a set point after a start leaves it started."""
    last = ""
    for order in orders:
        is_kept = last == words.START and order.word in LASTING
        if order.word in HALTS | LASTING and not is_kept:
            last = order.word
    return last


def _drive_of(config: Config, name: str) -> tuple[SlaveConfig, DriveConfig | None]:
    """The slave of the drive ``name``; the drive if it is one of several. Raises UsageError naming those there are."""
    known = [(one.name, slave, one) for slave in config.slaves for one in slave.drives]
    drives = [*known, *((slave.name, slave, None) for slave in config.slaves if slave.profile is not None)]
    for its_name, slave, drive in drives:
        if name == its_name or (drive is None and name == str(slave.address)):
            return slave, drive
    found = config.find(name)
    if found is not None and found.drives:
        names = ", ".join(one.name for one in found.drives)
        raise UsageError(f"slave {found.address} ({found.name}) has several drives: name one of {names}")
    if found is not None:
        raise UsageError(f"slave {found.address} ({found.name}) is no drive; give it `drive = ...` in its table")
    there = ", ".join(f"{its_name} ({slave.address})" for its_name, slave, _ in drives) or "none"
    raise UsageError(f"no drive {name!r} in this configuration; there are: {there}")


def _orders(args: argparse.Namespace) -> list[ParsedCommand]:
    """The orders of the command line, each with its arguments and options. Raises UsageError."""
    given = {key: getattr(args, key) for key in _FOR}
    given = {key: value for key, value in given.items() if value is not None and value is not False}
    orders = []
    rest = list(args.orders)
    while rest:
        spec = find_word(rest.pop(0), _WORDS)
        count = len(spec.usage.split())
        own = {key: value for key, value in given.items() if spec.name in _FOR[key]}
        orders.append(spec.order(rest[:count], words.ARGUMENTS, own))
        del rest[:count]
    for key in given:
        if not _FOR[key] & {order.word for order in orders}:
            option = "all" if key == "read_only" else key.replace("_", "-")
            raise UsageError(f"--{option} is for {', '.join(sorted(_FOR[key]))}: leave it out")
    return orders


# --- the orders -------------------------------------------------------------------------------------------------------


def _check_orders(
    slave: SlaveConfig, drive: DriveConfig | None, orders: Sequence[ParsedCommand], *, simulated: bool
) -> None:
    """Check all ``orders`` before the first one moves the drive. Raises UsageError, ConfigError."""
    core = core_of(slave, drive, simulated=simulated)
    assert core is not None
    plugin = _Plugin(core)
    made = {order.texts[0] for order in orders if order.word == "dump"}
    for order in orders:
        match order.word:
            case "dump":
                check_dump(plugin, order.texts[0], **order.values)
            case "compare":
                if order.texts[0] not in made:
                    check_compare(plugin, order.texts[0], **order.values)
            case "status":
                pass
            case _:
                plugin.check(order)


class _Plugin:
    """A drive as far as its plugin knows it without a bus: numbers, ranges, names and steps of parameters.

    The plugin is the one that would carry the orders out, so there is no second copy of its rules.
    """

    def __init__(self, core: DriveCore) -> None:
        self._core = core
        self.name = core.name
        self.kind = core.drive

    @property
    def parameters(self) -> tuple[ListedParam, ...]:
        return declared_parameters(self._core)

    def check(self, order: ParsedCommand) -> None:
        """Raises UsageError if the plugin refuses the order before it sends anything."""
        core = self._core
        events: list[dict[str, object]] = []
        with contextlib.suppress(Exception):  # a defect of the plugin is raised where the order is carried out
            given = {key: value for key, value in order.values.items() if key != "timeout"}
            core.command(order.word, given, 1, 0)
            events = core.take_events()
            core.lost(0)  # the order ends, the next one begins with a drive that does nothing
            core.take_events()
        for event in events:
            if event.get("error") == "usage":
                raise UsageError(f"drive {self.name}: {event.get('text')}")


@dataclasses.dataclass(slots=True)
class _Orders:
    """Orders to ``drive``, whose answers are printed; ``through``: ``run``, or ``master`` of this command."""

    drive: Readable
    carry_out: Callable[[ParsedCommand], Awaitable[dict[str, Any]]]
    orders: Sequence[ParsedCommand]
    through: str
    json: bool
    #: the order under way; the exit code so far
    word: str = ""
    code: int = 0

    async def are_done(self, stop: StopSignal) -> bool:
        """Carry out all orders; False, after a warning, if a signal ended that. The first failure is raised."""
        if await stop.or_done(self._all()):
            return True
        output.warn(f"ended before {self.word} was done" if self.word else "ended before the first order")
        self.code = 1
        return False

    async def _all(self) -> None:
        for order in self.orders:
            self.word = order.word
            match order.word:
                case "dump":
                    await self._dump(order)
                case "compare":
                    await self._compare(order)
                case _:
                    self._show(order, await self.carry_out(order))

    def _show(self, order: ParsedCommand, answer: Mapping[str, Any]) -> None:
        if self.json:
            output.json_line({**answer, "through": self.through})
        elif order.word == "status":
            _show_status(answer)
        elif "parameter" in answer:
            found = answer["parameter"]
            name = found["name"]
            more = f" ({name})" if name is not None and name.lower() != order.texts[0].lower() else ""
            place = label(order.texts[0] + more, found["data_set"], None)
            output.line(f"{self.drive.name}: {place} = {value_text(found['value'], found['unit'])}")
        else:
            output.line(f"{self.drive.name}: {_status_text(answer['status'])}")

    async def _dump(self, order: ParsedCommand) -> None:
        with self._progress() as progress:
            found = await self.drive.dump(order.texts[0], **order.values, on_parameter=progress)
        unreadable = [_plain(one) for one in found.unreadable]
        show_dump(self.drive.name, found, self._head(order), unreadable, json=self.json)

    async def _compare(self, order: ParsedCommand) -> None:
        with self._progress() as progress:
            found = await self.drive.compare(order.texts[0], **order.values, on_parameter=progress)
        differences = [{"file": _plain(one.saved), "drive": _plain(one.found)} for one in found.differences]
        skipped = [{**_where(one), "reason": why} for one, why in found.skipped]
        code = show_comparison(self.drive.name, found, self._head(order), differences, skipped, json=self.json)
        self.code = self.code or code

    def _head(self, order: ParsedCommand) -> dict[str, object]:
        drive = self.drive
        head = {"order": order.word, "drive": drive.name, "address": drive.address, "type": drive.kind}
        return {**head, "file": order.texts[0], "through": self.through}

    @contextlib.contextmanager
    def _progress(self) -> Iterator[OnParameter]:
        """A progress bar on a terminal; a warning with the notes of the exception when it is cut short."""
        title = f"parameters of {self.drive.name}"
        try:
            with progress_bar(title) as show:

                def on_parameter(number: int, count: int, _one: SavedParam) -> None:
                    show(title, number, count)

                yield on_parameter
        except BaseException as error:
            for note in getattr(error, "__notes__", ()):
                output.warn(note)
            raise


def _show_status(answer: Mapping[str, Any]) -> None:
    status = answer["status"]
    rows = {
        "state": status["state"],
        "reached": "yes" if status["reached"] else "no",
        "set point": f"{status['setpoint']:.2%}",
    }
    if status["speed"] is not None:
        rows["speed"] = _speed_text(status, 2)
    for name in ("current", "torque"):
        if status[name] is not None:
            rows[name] = f"{status[name]:.2%} of the rated one"
    rows |= {
        "the bus has the control": {True: "yes", False: "no"}.get(status["remote"], "the drive does not say"),
        "faults": ", ".join(status["faults"]) or "none",
        "warnings": ", ".join(status["warnings"]) or "none",
        "status bits": ", ".join(status["bits"]) or "none",
        "settings": _settings_text(status),
        "words": " ".join(status["words"]),
    }
    output.table(f"{answer['drive']}: {answer['type']} at address {answer['address']}", ("what", "value"), rows.items())


def _settings_text(status: Mapping[str, Any]) -> str:
    """A run of an earlier version sends no ``settings``."""
    state = str(status.get("settings", "not known")).replace("_", " ")
    return "; ".join([state, *status.get("settings_texts", ())])


def _status_text(status: Mapping[str, Any]) -> str:
    """One line: state, speed, set point, faults and warnings."""
    speed = "" if status["speed"] is None else f" at {_speed_text(status, 1)}"
    wrong = [f"fault {name}" for name in status["faults"]] + [f"warning {name}" for name in status["warnings"]]
    if status.get("settings") == "different":
        wrong.append("its settings are not the expected ones (see status)")
    return ", ".join([f"{status['state']}{speed}", f"set point {status['setpoint']:.1%}", *wrong])


def _speed_text(status: Mapping[str, Any], digits: int) -> str:
    hz, rpm = status["frequency_hz"], status.get("speed_rpm")
    units = ([] if hz is None else [f"{hz:.{digits}f} Hz"]) + ([] if rpm is None else [f"{rpm:.0f} rpm"])
    return f"{status['speed']:.{digits}%}" + (f" ({', '.join(units)})" if units else "")


def _plain(one: SavedParam) -> dict[str, object]:
    return {key: value for key, value in dataclasses.asdict(one).items() if value is not None and value is not False}


def _where(one: SavedParam) -> dict[str, object]:
    return {key: value for key, value in _plain(one).items() if key in ("name", "number", "data_set", "index")}
