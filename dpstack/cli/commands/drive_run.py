"""Execution and output of the orders of ``dpstack drive``."""

from __future__ import annotations

import dataclasses
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from typing import Any, Final, NamedTuple

from dpstack.api.control.commands import Spec
from dpstack.api.control.drive_check import DriveCheck
from dpstack.api.lists.dump_compare import OnParameter, Readable, check_compare, check_dump, compare, dump
from dpstack.api.lists.parameter_list import SavedParam, label, value_text
from dpstack.cli.commands.lists import tell_comparison, tell_dump
from dpstack.cli.terminal import output
from dpstack.cli.terminal.drawing import progress_bar
from dpstack.cli.terminal.lost_stdout import warn

DUMP_AND_COMPARE: Final = (
    Spec("dump", "FILE", "all declared parameters into a file", "hoist.toml"),
    Spec("compare", "FILE", "where the drive differs from such a file", "hoist.toml"),
)


class Order(NamedTuple):
    word: str
    args: tuple[str, ...]
    options: Mapping[str, object]

    @property
    def words(self) -> tuple[str, ...]:
        """Arguments and options as :data:`Tell` expects them."""
        return (*self.args, *(f"{key}={str(value).lower()}" for key, value in self.options.items()))


#: sends a drive one order with its arguments and options, and returns the answer
Tell = Callable[[str, Sequence[str]], Awaitable[dict[str, Any]]]


def check_orders(drive: DriveCheck, orders: Sequence[Order]) -> None:
    """Check all ``orders`` before the first one moves the drive. Raises UsageError, ConfigError."""
    made = {order.args[0] for order in orders if order.word == "dump"}
    for order in orders:
        match order.word:
            case "dump":
                check_dump(drive, order.args[0], data_set=_data_set(order))
            case "compare":
                if order.args[0] not in made:
                    every = bool(order.options.get("all"))
                    check_compare(drive, order.args[0], data_set=_data_set(order), read_only=every)
            case _:
                drive.order(order.word, order.words)


class Orders:
    """Orders to ``drive``; ``through``: a run, or a master of this command. ``code`` is the exit code so far."""

    def __init__(self, drive: Readable, tell: Tell, orders: Sequence[Order], *, through: str, json: bool) -> None:
        self._drive = drive
        self._order = tell
        self._orders = orders
        self._through = through
        self._json = json
        self.code = 0
        #: the order being carried out
        self.at: Order | None = None

    async def carry_out(self) -> None:
        """Carry out all orders. The first failure ends it and is raised."""
        for order in self._orders:
            self.at = order
            match order.word:
                case "dump":
                    await self._dump(order)
                case "compare":
                    await self._compare(order)
                case _:
                    self._tell(order, await self._order(order.word, order.words))

    def _tell(self, order: Order, told: Mapping[str, Any]) -> None:
        if self._json:
            output.json_line({**told, "through": self._through})
        elif order.word == "status":
            show_status(told)
        elif "parameter" in told:
            found = told["parameter"]
            name = found["name"]
            more = f" ({name})" if name is not None and name.lower() != order.args[0].lower() else ""
            place = label(order.args[0] + more, found["data_set"], None)
            output.line(f"{self._drive.name}: {place} = {value_text(found['value'], found['unit'])}")
        else:
            output.line(f"{self._drive.name}: {status_text(told['status'])}")

    async def _dump(self, order: Order) -> None:
        (path,) = order.args
        async with self._progress() as progress:
            found = await dump(self._drive, path, data_set=_data_set(order), on_parameter=progress)
        if self._json:
            unreadable = [_plain(one) for one in found.unreadable]
            self._json_line("dump", path, parameters=len(found.parameters), unreadable=unreadable)
            return
        tell_dump(self._drive.name, found, path)

    async def _compare(self, order: Order) -> None:
        (path,) = order.args
        everything = bool(order.options.get("all"))
        async with self._progress() as progress:
            found = await compare(
                self._drive, path, data_set=_data_set(order), read_only=everything, on_parameter=progress
            )
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

    @asynccontextmanager
    async def _progress(self) -> AsyncIterator[OnParameter]:
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


def _data_set(order: Order) -> int | None:
    data_set = order.options.get("data_set")
    return data_set if isinstance(data_set, int) else None
