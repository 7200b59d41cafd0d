"""Check, execution and output of the orders of ``dpstack drive``."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from typing import Any, Final

from dpstack.api.bus.remote_plugins import core_of
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.control.commands import Order, Spec
from dpstack.api.lists.dump_compare import OnParameter, Readable, check_compare, check_dump, compare, dump
from dpstack.api.lists.parameter_list import SavedParam, label, value_text
from dpstack.api.slave.drive import declared_parameters
from dpstack.cli.commands.lists import tell_comparison, tell_dump
from dpstack.cli.terminal import output
from dpstack.cli.terminal.drawing import progress_bar
from dpstack.cli.terminal.lost_stdout import warn
from dpstack.cli.terminal.signals import StopSignal
from dpstack.errors import UsageError
from dpstack.profile import DriveCore, ListedParam

DUMP_AND_COMPARE: Final = (
    Spec("dump", "FILE", "all declared parameters into a file", "hoist.toml"),
    Spec("compare", "FILE", "where the drive differs from such a file", "hoist.toml"),
)


def check_orders(slave: SlaveConfig, orders: Sequence[Order], *, simulated: bool) -> None:
    """Check all ``orders`` before the first one moves the drive of ``slave``. Raises UsageError, ConfigError."""
    core = core_of(slave, simulated=simulated)
    assert core is not None
    drive = _Plugin(core)
    made = {order.texts[0] for order in orders if order.word == "dump"}
    for order in orders:
        match order.word:
            case "dump":
                check_dump(drive, order.texts[0], data_set=order.values.get("data_set"))
            case "compare":
                if order.texts[0] not in made:
                    check_compare(drive, order.texts[0], **_chosen(order))
            case "status":
                pass
            case _:
                drive.check(order)


def _chosen(order: Order) -> dict[str, Any]:
    return {"data_set": order.values.get("data_set"), "read_only": order.values.get("all", False)}


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

    def check(self, order: Order) -> None:
        """Raises UsageError where the plugin refuses the order before it sends anything."""
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


class Orders:
    """Carries orders to ``drive`` out and prints the answers; ``through``: a run, or a master of this command."""

    def __init__(
        self, drive: Readable, carry_out: Callable[[Order], Awaitable[dict[str, Any]]], *, through: str, json: bool
    ) -> None:
        self._drive = drive
        self._carry_out = carry_out
        self._through = through
        self._json = json
        self._word = ""  # being carried out
        #: the exit code so far
        self.code = 0

    async def are_done(self, orders: Sequence[Order], stop: StopSignal) -> bool:
        """Carry out all orders; False, after a warning, where a signal ended that. The first failure is raised."""
        if await stop.or_done(self._all(orders)):
            return True
        warn(f"ended before {self._word} was done" if self._word else "ended before the first order")
        self.code = 1
        return False

    async def _all(self, orders: Sequence[Order]) -> None:
        for order in orders:
            self._word = order.word
            match order.word:
                case "dump":
                    await self._dump(order)
                case "compare":
                    await self._compare(order)
                case _:
                    self._tell(order, await self._carry_out(order))

    def _tell(self, order: Order, told: Mapping[str, Any]) -> None:
        if self._json:
            output.json_line({**told, "through": self._through})
        elif order.word == "status":
            show_status(told)
        elif "parameter" in told:
            found = told["parameter"]
            name = found["name"]
            more = f" ({name})" if name is not None and name.lower() != order.texts[0].lower() else ""
            place = label(order.texts[0] + more, found["data_set"], None)
            output.line(f"{self._drive.name}: {place} = {value_text(found['value'], found['unit'])}")
        else:
            output.line(f"{self._drive.name}: {status_text(told['status'])}")

    async def _dump(self, order: Order) -> None:
        path = order.texts[0]
        with self._progress() as progress:
            found = await dump(self._drive, path, data_set=order.values.get("data_set"), on_parameter=progress)
        if self._json:
            unreadable = [_plain(one) for one in found.unreadable]
            self._json_line("dump", path, parameters=len(found.parameters), unreadable=unreadable)
            return
        tell_dump(self._drive.name, found, path)

    async def _compare(self, order: Order) -> None:
        path = order.texts[0]
        with self._progress() as progress:
            found = await compare(self._drive, path, **_chosen(order), on_parameter=progress)
        self.code = self.code or int(bool(found.differences))
        if self._json:
            differences = [{"file": _plain(one.saved), "drive": _plain(one.found)} for one in found.differences]
            skipped = [{**_where(one), "reason": why} for one, why in found.skipped]
            self._json_line("compare", path, same=found.same, differences=differences, skipped=skipped)
            return
        tell_comparison(self._drive.name, found, path)

    def _json_line(self, word: str, path: str, **more: object) -> None:
        drive = self._drive
        head = {"order": word, "drive": drive.name, "address": drive.address, "type": drive.kind, "file": path}
        output.json_line({**head, **more, "through": self._through})

    @contextlib.contextmanager
    def _progress(self) -> Iterator[OnParameter]:
        """A progress bar on a terminal; a warning with the notes of the exception when it is cut short."""
        title = f"parameters of {self._drive.name}"
        try:
            with progress_bar(title) as tell:

                def on_parameter(number: int, count: int, _one: SavedParam) -> None:
                    tell(title, number, count)

                yield on_parameter
        except BaseException as error:
            for note in getattr(error, "__notes__", ()):
                warn(note)
            raise


def show_status(told: Mapping[str, Any]) -> None:
    status = told["status"]
    rows: list[tuple[str, object]] = [
        ("state", status["state"]),
        ("reached", "yes" if status["reached"] else "no"),
        ("set point", f"{status['setpoint']:.2%}"),
    ]
    if status["speed"] is not None:
        rows.append(("speed", _speed_text(status, 2)))
    rows += [
        (name, f"{status[name]:.2%} of the rated one") for name in ("current", "torque") if status[name] is not None
    ]
    rows += [
        ("the bus has the control", "yes" if status["remote"] else "no"),
        ("faults", ", ".join(status["faults"]) or "none"),
        ("warnings", ", ".join(status["warnings"]) or "none"),
        ("status bits", ", ".join(status["bits"]) or "none"),
        ("settings", _settings_text(status)),
        ("words", " ".join(status["words"])),
    ]
    output.table(f"{told['drive']}: {told['type']} at address {told['address']}", ("what", "value"), rows)


def _settings_text(status: Mapping[str, Any]) -> str:
    """A run of an earlier version sends no ``settings``."""
    state = str(status.get("settings", "not told")).replace("_", " ")
    return "; ".join([state, *status.get("settings_texts", ())])


def status_text(status: Mapping[str, Any]) -> str:
    """One line: state, speed, set point, faults and warnings."""
    speed = "" if status["speed"] is None else f" at {_speed_text(status, 1)}"
    wrong = [f"fault {name}" for name in status["faults"]] + [f"warning {name}" for name in status["warnings"]]
    if status.get("settings") == "different":
        wrong.append("its settings are not the expected ones (see status)")
    return ", ".join([f"{status['state']}{speed}", f"set point {status['setpoint']:.1%}", *wrong])


def _speed_text(status: Mapping[str, Any], digits: int) -> str:
    hz = status["frequency_hz"]
    return f"{status['speed']:.{digits}%}" + ("" if hz is None else f" ({hz:.{digits}f} Hz)")


def _plain(one: SavedParam) -> dict[str, object]:
    return {key: value for key, value in dataclasses.asdict(one).items() if value is not None and value is not False}


def _where(one: SavedParam) -> dict[str, object]:
    return {key: value for key, value in _plain(one).items() if key in ("name", "number", "data_set", "index")}
