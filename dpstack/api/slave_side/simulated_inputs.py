"""Inputs of simulated slaves over time: from a recording, or from a function in a thread of its own.

A function is called once in its period, with the outputs of that moment. Its result is taken at the next call. A
function that takes longer misses calls; the line never waits for it. Only in virtual time a call is waited for up to
:data:`PATIENCE_S`, so that results do not depend on the speed of the computer.
"""

from __future__ import annotations

import contextlib
import csv
import math
import queue
import sys
import threading
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple, TextIO

from dpstack.api.config.simulate import SimulateConfig
from dpstack.api.slave_side.virtual_bench import Bench, SimulatedSlave, VirtualBench
from dpstack.api.user_code import load_object
from dpstack.errors import ConfigError, DpError, UsageError
from dpstack.record.reader import Recording
from dpstack.text import brief
from dpstack.trace import Event, Notice, Severity
from dpstack.units import NS_PER_MS, NS_PER_S, ns_to_s, s_to_ns

#: real time for a call of a function in virtual time
PATIENCE_S: Final = 0.1
#: While functions run behind a real port, a thread gives the interpreter up after this time: answers wait for it.
_SWITCH_S: Final = 0.000_5
#: a recording is read on after this time at the earliest, however close its rows are
_LEAST_STEP_NS: Final = NS_PER_MS
#: the last row of a recording that begins again lasts this long
_LAST_S: Final = 0.1
#: the shortest time between two remarks about one source
QUIET_NS: Final = NS_PER_S
#: characters of a message of a function
_SHOWN: Final = 200

Publish = Callable[[Event], None]
#: of a recording: seconds since its first row, and the values of that row by column
_Row = tuple[float, Mapping[str, object]]
Function = Callable[[float, Any], Any]


class SimulatedInputs:
    """The recordings and functions of the slaves of ``bench``. :meth:`start` begins, :meth:`close` ends.

    ``allow_code``: functions may be loaded and called. Raises ConfigError for a recording or a function that cannot be
    used, and for any function without ``allow_code``.
    """

    def __init__(self, bench: Bench, publish: Publish, *, allow_code: bool) -> None:
        self._bench = bench
        bench.is_fed = True
        recordings: dict[tuple[Path, bool], list[SimulatedSlave]] = defaultdict(list)
        functions: list[tuple[SimulatedSlave, SimulateConfig]] = []
        for unit in bench.units.values():
            given = unit.config.simulate
            if given is None:
                continue
            if given.recording is not None:
                recordings[given.recording, given.repeat].append(unit)
            else:
                functions.append((unit, given))
        if functions and not allow_code:
            unit, given = functions[0]
            what = f"function = {given.function!r} runs a program"
            raise given.error("function", what, "give --allow-code (in a test allow_code=True) if you trust it")
        self._recordings = [
            _Playback(path, repeat, units, bench, publish) for (path, repeat), units in recordings.items()
        ]
        self._functions = [_Calls(unit, given, bench, publish) for unit, given in functions]
        self._switch_s: float | None = None

    def close(self) -> None:
        """End the threads."""
        for calls in self._functions:
            calls.stop()
        if self._switch_s is not None:
            sys.setswitchinterval(self._switch_s)

    def start(self, origin_ns: int) -> None:
        """Begin; times of recordings and functions count from ``origin_ns`` on."""
        if self._functions and not isinstance(self._bench, VirtualBench):
            self._switch_s = sys.getswitchinterval()
            sys.setswitchinterval(min(self._switch_s, _SWITCH_S))
        for playback in self._recordings:
            playback.start(origin_ns)
        for calls in self._functions:
            calls.start(origin_ns)


class _StateReporter:
    """Publishes changes of what is wrong with a source, and that it works again, at most one in QUIET_NS."""

    def __init__(self, source: str, bench: Bench, publish: Publish) -> None:
        self._source = source
        self._bench = bench
        self._publish = publish
        self._reported = ""
        self._quiet_until_ns = 0

    def wrong(self, what: str) -> None:
        self._tell(what, what, Severity.WARNING)

    def well(self) -> None:
        self._tell("", "works again", Severity.INFO)

    def _tell(self, state: str, what: str, severity: Severity) -> None:
        if state != self._reported and self._bench.now >= self._quiet_until_ns:
            self._reported = state
            self._quiet_until_ns = self._bench.now + QUIET_NS
            self.say(what, severity)

    def say(self, what: str, severity: Severity = Severity.INFO) -> None:
        """Publish it in any case."""
        self._publish(Notice(t_ns=self._bench.now, source=self._source, message=what, severity=severity))


# --- recordings -------------------------------------------------------------------------------------------------------
class _Playback:
    """Plays one recording for all ``units`` that name it."""

    def __init__(self, path: Path, repeat: bool, units: list[SimulatedSlave], bench: Bench, publish: Publish) -> None:
        self._repeat = repeat
        self._units = units
        self._bench = bench
        self._reporter = _StateReporter(f"recording {path.name}", bench, publish)
        self._wrong: set[str] = set()  # columns with a value that was reported
        given = units[0].config.simulate
        assert given is not None
        try:
            columns, self._rows = _source_of(path)
        except (UsageError, OSError) as error:
            what, _, todo = str(error).partition("; ")
            raise given.error("recording", what, todo or "correct it") from None
        #: for each slave its inputs by the column of the recording
        self._names = [{f"{unit.name}.{name}": name for name in unit.config.input_fields} for unit in units]
        for unit, names in zip(units, self._names, strict=True):
            if not names.keys() & columns:
                simulate = unit.config.simulate
                assert simulate is not None
                there = ", ".join(sorted(columns)[:8]) or "none"
                wanted = ", ".join(sorted(names)) or f"none, {unit.name} has no named inputs"
                raise simulate.error(
                    "recording", f"{path} has no column of this slave", f"there are: {there}; wanted: {wanted}"
                )

    def start(self, origin_ns: int) -> None:
        self._begin(origin_ns)

    def _begin(self, origin_ns: int) -> None:
        rows = self._rows()
        first = next(rows, None)
        if first is None:
            self._reporter.wrong("it has no rows")
            return
        self._bench.call_at(origin_ns, partial(self._play, origin_ns, rows, first))

    def _play(self, origin_ns: int, rows: Iterator[_Row], row: _Row) -> None:
        """Apply ``row`` and all that are due, and wait for the next one."""
        bench = self._bench
        due: _Row | None = row
        try:
            while due is not None and origin_ns + s_to_ns(due[0]) <= bench.now:
                self._apply(due[1])
                due = next(rows, None)
        except (UsageError, OSError) as error:
            self._reporter.wrong(str(error))
            return
        if due is not None:
            at_ns = max(origin_ns + s_to_ns(due[0]), bench.now + _LEAST_STEP_NS)
            bench.call_at(at_ns, partial(self._play, origin_ns, rows, due))
        elif self._repeat:
            self._begin(bench.now + s_to_ns(_LAST_S))
        else:
            self._reporter.say("is over; the last inputs stay")

    def _apply(self, values: Mapping[str, object]) -> None:
        for unit, names in zip(self._units, self._names, strict=True):
            image = before = unit.inputs
            for column, name in names.items():
                value = values.get(column)
                if value is None or value == "":
                    continue
                try:
                    image = unit.put_input(image, name, _as_field(value))
                except (DpError, ValueError) as error:
                    if column not in self._wrong:
                        self._wrong.add(column)
                        self._reporter.say(f"{error}; left out, and so are others of {column}", Severity.WARNING)
            if image != before or unit.held_inputs is None:
                unit.set_inputs(image)


def _as_field(value: object) -> object:
    """A whole number as such, although a table program wrote it as 3.0."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _source_of(path: Path) -> tuple[set[str], Callable[[], Iterator[_Row]]]:
    """The columns of a recording, and its rows. Raises UsageError, OSError."""
    titles: list[str] = []
    if path.suffix.lower() == ".csv" and path.is_file():
        with _opened(path) as file, contextlib.suppress(csv.Error):
            titles = next(csv.reader(file), [])
    if titles[:1] == ["t"]:
        return set(titles[1:]), partial(_written_rows, path)
    recording = Recording(path)
    return set(recording.columns), lambda: ((row.at, row.values) for row in recording.rows())


def _opened(path: Path) -> TextIO:
    return path.open(encoding="utf-8-sig", errors="replace", newline="")


def _written_rows(path: Path) -> Iterator[_Row]:
    """The rows of a CSV file whose first column is t, in seconds. Lines without such a number are left out.

    Raises UsageError if the file is no CSV file any more.
    """
    first: float | None = None
    with _opened(path) as file:
        try:
            for row in csv.DictReader(file):
                t = _number(row["t"])
                if t is not None:
                    first = t if first is None else first
                    yield max(0.0, t - first), {key: value for key, value in row.items() if isinstance(value, str)}
        except csv.Error as error:
            raise UsageError(f"{path}: {error}; the last inputs stay") from None


def _number(text: object) -> float | None:
    try:
        number = float(str(text))
    except ValueError:
        return None
    return number if math.isfinite(number) else None


# --- functions --------------------------------------------------------------------------------------------------------
class _Result(NamedTuple):
    value: object
    error: BaseException | None


class _Calls:
    """Calls the function of one slave in its period."""

    def __init__(self, unit: SimulatedSlave, given: SimulateConfig, bench: Bench, publish: Publish) -> None:
        self._unit = unit
        self._bench = bench
        self._period_ns = given.period_ns
        self._reporter = _StateReporter(f"{unit.who}: function {given.function}", bench, publish)
        assert given.function is not None
        try:
            function = load_object(given.function, given.folder, "function")
        except ConfigError as error:
            what, _, todo = str(error).partition("; ")
            raise given.error("function", what, todo) from None
        if not callable(function):
            raise given.error("function", f"{brief(given.function)} is no function", "name a function")
        self._requests: queue.SimpleQueue[tuple[float, object] | None] = queue.SimpleQueue()
        self._results: queue.SimpleQueue[_Result] = queue.SimpleQueue()
        self._is_running = self._is_overdue = False
        self._thread = threading.Thread(
            target=_work, args=(function, self._requests, self._results), name=f"{given.function}", daemon=True
        )

    def start(self, origin_ns: int) -> None:
        self._thread.start()
        self._bench.call_at(origin_ns, partial(self._tick, origin_ns, 0))

    def stop(self) -> None:
        """End the thread after the call that runs; nobody waits for it."""
        self._requests.put(None)

    def _tick(self, origin_ns: int, number: int) -> None:
        self._take_result()
        bench = self._bench
        if not self._is_running:
            self._is_running = True
            self._requests.put((ns_to_s(bench.now - origin_ns), self._outputs()))
        behind = max(0, bench.now - origin_ns) // self._period_ns
        number = max(number, behind) + 1
        bench.call_at(origin_ns + number * self._period_ns, partial(self._tick, origin_ns, number))

    def _outputs(self) -> object:
        """The named outputs, or the octets if none is named; zeros outside data exchange."""
        unit = self._unit
        octets = unit.app.outputs or bytes(unit.config.params.output_len)
        fields = unit.config.output_fields
        return fields.values(octets) if fields else octets

    def _take_result(self) -> None:
        if not self._is_running:
            return
        waits = isinstance(self._bench, VirtualBench) and not self._is_overdue
        try:
            result = self._results.get(timeout=PATIENCE_S) if waits else self._results.get_nowait()
        except queue.Empty:
            self._is_overdue = True
            self._reporter.wrong("takes longer than its period; the last inputs stay")
            return
        self._is_running = self._is_overdue = False
        if result.error is not None:
            error = result.error
            self._reporter.wrong(f"failed ({type(error).__name__}: {error})"[:_SHOWN] + "; the last inputs stay")
            return
        try:
            self._set(result.value)
        except Exception as error:  # also of a mapping of the user's own
            self._reporter.wrong(f"gave wrong inputs ({error})"[:_SHOWN] + "; the last inputs stay")
            return
        self._reporter.well()

    def _set(self, value: object) -> None:
        unit = self._unit
        if value is None:
            return
        if isinstance(value, (bytes, bytearray)):
            unit.set_inputs(bytes(value))
            return
        if not isinstance(value, Mapping):
            raise TypeError(f"{type(value).__name__}: give a mapping of named inputs, octets, or None")
        unit.set_inputs(unit.inputs_with({str(name): one for name, one in value.items()}))


def _work(
    function: Function,
    requests: queue.SimpleQueue[tuple[float, object] | None],
    results: queue.SimpleQueue[_Result],
) -> None:
    while (request := requests.get()) is not None:
        try:
            results.put(_Result(function(*request), None))
        except BaseException as error:  # whatever a user's function raises ends in a message
            results.put(_Result(None, error))
