"""Scenarios: a TOML file of steps in time that happen to simulated slaves.

A step does what :mod:`dpstack.api.slave_side.fault_steps` lists, or what a command of ``dpstack ctl`` to a simulated
slave does. The whole file is checked before the first step.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

from dpstack.api.config.config import read_tables, read_text
from dpstack.api.control.arguments import time_ns
from dpstack.api.control.commands import SLAVES, Spec
from dpstack.api.control.control_server import Handler
from dpstack.api.injected import ScenarioEvent
from dpstack.api.slave_side.fault_steps import KINDS, OF_CPUS, Deed, End, Kind
from dpstack.api.slave_side.simulated_inputs import SimulatedInputs
from dpstack.api.slave_side.virtual_bench import Bench
from dpstack.errors import ConfigError, DpError
from dpstack.text import brief, did_you_mean, shortened
from dpstack.toml.table import Key, Source, Table
from dpstack.trace import Event
from dpstack.units import ns_to_s, s_to_ns

#: a year in seconds
_LONGEST_S: Final = 365 * 86_400
#: ends everything that earlier steps did to a slave
NORMAL: Final = "normal"
_STEP_KEYS: Final[Mapping[str, Key]] = {
    "at": Key(0, _LONGEST_S, kind=float),
    "slave": Key(read=lambda table, name, _: table.raw(name), kind=str),
    "do": Key(kind=str),
    "for": Key(0.001, _LONGEST_S, kind=float),
}


@dataclass(frozen=True, slots=True)
class Step:
    """``at_ns`` after the start of the scenario; ``for_ns`` None: without an end of its own; ``deed`` None: end all."""

    number: int
    at_ns: int
    for_ns: int | None
    address: int
    do: str
    deed: Deed | None


@dataclass(frozen=True, slots=True)
class Scenario:
    """Checked steps in the order of their times. ``period_ns``: the time from one start to the next; None: once."""

    steps: tuple[Step, ...]
    period_ns: int | None

    @property
    def end_ns(self) -> int:
        """The time at which the last step is over."""
        return max(step.at_ns + (step.for_ns or 0) for step in self.steps)


def load_scenario(path: str | Path, bench: Bench, handlers: Mapping[str, Handler]) -> Scenario:
    """Read a scenario for the slaves of ``bench``; ``handlers``: the commands to them. Raises ConfigError, one line."""
    return parse_scenario(read_text(path, "scenario"), bench, handlers, str(path))


def parse_scenario(text: str, bench: Bench, handlers: Mapping[str, Handler], name: str = "scenario") -> Scenario:
    """Read a scenario from ``text``; otherwise as :func:`load_scenario`."""
    data, source = read_tables(text, name)
    for key in data:
        if key not in ("step", "repeat"):
            near = " (write [[step]])" if key in ("steps", "Step") else ""
            raise source.error((key,), f"unknown table or key {key!r}", f"a scenario has repeat and [[step]]{near}")
    entries = data.get("step", [])
    if not isinstance(entries, list) or not entries:
        what = "no step" if entries == [] else "[step] must be [[step]]"
        raise source.error(("step",), what, 'add [[step]] with at = 5.0, slave = "..." and do = "..."')
    steps = [
        _step(Table(source, ("step", number), entry, f"[[step]] {number + 1}"), number + 1, bench, handlers)
        for number, entry in enumerate(entries)
    ]
    steps.sort(key=lambda step: step.at_ns)
    scenario = Scenario(tuple(steps), None)
    return Scenario(scenario.steps, _period_ns(source, data, scenario.end_ns))


def _period_ns(source: Source, data: Mapping[str, Any], end_ns: int) -> int | None:
    given = data.get("repeat", False)
    if given is False:
        return None
    wanted = end_ns if given is True else None
    if wanted is None:
        table = Table(source, (), data, source.name)
        wanted = s_to_ns(table.number("repeat", 0.001, _LONGEST_S))
    if wanted < max(end_ns, 1_000_000):
        what = f"repeat = {str(given).lower()}, and the last step is over at {ns_to_s(end_ns):g} s"
        raise source.error(("repeat",), what, "give a later time in seconds")
    return wanted


def _step(table: Table, number: int, bench: Bench, handlers: Mapping[str, Handler]) -> Step:
    """One step. Raises ConfigError."""
    if "do" not in table:
        table.fail(None, "no do", f'say what happens, for instance do = "late_answers"; known: {", ".join(_words())}')
    do = table.text("do").strip().lower().replace("-", "_")
    kind = kind_of(table, do, handlers)
    given = table.read({**_STEP_KEYS, **kind.keys})
    for key in ("at", "slave"):
        if key not in given:
            table.fail(
                None, f"no {key}", "add at = 5.0 (seconds)" if key == "at" else "name a slave by name or address"
            )
    if "for" in given and not kind.lasting:
        table.fail("for", f"{do} has no end of its own", "leave for out")
    address = _address(table, given["slave"], bench)
    if address in bench.cpus and do not in (*OF_CPUS, NORMAL):
        what = f"{do} is for DP slaves; {bench.cpus[address].who} is an S7-200"
        table.fail("do", what, f"take {', '.join(OF_CPUS)}")
    deed = None if do == NORMAL else kind.read(table, given, bench, address)
    for_ns = None if "for" not in given else s_to_ns(given["for"])
    return Step(number, s_to_ns(given["at"]), for_ns, address, do, deed)


def read_fault(args: Sequence[str], bench: Bench, address: int) -> tuple[Deed, int | None]:
    """A deed from the words of ``dpstack ctl PORT fault SLAVE KIND KEY=VALUE ...``, and its duration in ns.

    Raises ConfigError.
    """
    word, *options = args
    data: dict[str, object] = {"do": word}
    source, title = Source("fault"), shortened(word, 40)
    do = word.strip().lower().replace("-", "_")
    kind = kind_of(Table(source, (), data, title), do, {})
    for text in options:
        key, equals, value = text.partition("=")
        if not equals:
            raise ConfigError(f"fault: {text!r} is not KEY=VALUE; write for instance by_ms=20 for=3s")
        wanted = kind.keys.get(key)
        is_text = wanted is not None and wanted.read is None and wanted.kind in (str, bytes)
        data[key] = ns_to_s(time_ns(value)) if key == "for" else value if is_text else _value(value)
    table = Table(source, (), data, title)
    given = table.read({"do": _STEP_KEYS["do"], "for": _STEP_KEYS["for"], **kind.keys})
    if "for" in given and not kind.lasting:
        table.fail("for", f"{do} has no end of its own", "leave for out")
    deed = kind.read(table, given, bench, address)
    return deed, None if "for" not in given else s_to_ns(given["for"])


def _value(text: str) -> object:
    """A number, true or false, or a text."""
    for read in (int, float):
        try:
            return read(text)
        except ValueError:
            pass
    return {"true": True, "false": False}.get(text, text)


def _words() -> list[str]:
    commands = [spec.name.replace("-", "_") for spec in SLAVES]
    return [*KINDS, NORMAL, *(word for word in commands if word not in KINDS and word not in _NOT_IN_STEPS)]


#: commands with a step of their own, or of another form
_NOT_IN_STEPS: Final = ("fault", "input", "normal")


def kind_of(table: Table, do: str, handlers: Mapping[str, Handler]) -> Kind:
    """The kind of step ``do``: a fault, "normal", or a command of ``handlers``, all with underscores."""
    if do in KINDS:
        return KINDS[do]
    if do == NORMAL and handlers:
        return Kind({}, _nothing, lasting=False)
    spec = next((spec for spec in SLAVES if spec.name.replace("-", "_") == do and do not in _NOT_IN_STEPS), None)
    if spec is None or spec.name not in handlers:
        words = _words() if handlers else list(KINDS)
        todo = did_you_mean(do, words, f"known: {', '.join(words)}", quoted=True)
        raise table.error("do", f"unknown {'do' if handlers else 'fault'} {do!r}", todo)
    return Kind({"args": Key(read=_args)}, partial(_command, spec, handlers[spec.name]), lasting=False)


def _nothing(_table: Table, _given: Mapping[str, Any], _bench: Bench, _address: int) -> Deed:
    raise AssertionError("it ends what others began")


def _args(table: Table, name: str, _: Key) -> list[str]:
    value = table.raw(name)
    if not isinstance(value, list) or not all(isinstance(one, (str, int, float)) for one in value):
        table.fail(
            name, f"{name} = {brief(value)} is no list", 'write the words of the command, for instance args = ["0.6"]'
        )
    return [("on" if one else "off") if isinstance(one, bool) else str(one) for one in value]


def _command(spec: Spec, handler: Handler, table: Table, given: Mapping[str, Any], bench: Bench, address: int) -> Deed:
    """A command of ``dpstack ctl`` to the slave."""
    args = [str(address), *given.get("args", ())]
    try:
        spec.check(args)
    except DpError as error:
        raise table.error("args", str(error).partition(";")[0], "args has what follows the slave") from None

    def begin() -> None:
        result = handler(list(args))
        assert not inspect.isawaitable(result)

    return Deed(" ".join((spec.name, *args[1:])), begin)


def _address(table: Table, wanted: object, bench: Bench) -> int:
    found = bench.find(wanted)
    if found is not None:
        return found
    names = bench.names()
    known = ", ".join(f"{address} ({name})" for address, name in sorted(names.items())) or "none"
    todo = did_you_mean(str(wanted), names.values(), f"there are: {known}", quoted=True)
    raise table.error("slave", f"no slave {wanted!r}", todo)


#: time after the start in ns, ends (0) before begins (1), what happens
_Moment = tuple[int, int, Callable[[], None]]


class ScenarioRun:
    """Carries out ``scenario`` on ``bench`` and calls ``publish`` for each begin, end and failure of a step."""

    def __init__(self, scenario: Scenario, bench: Bench, publish: Callable[[Event], None]) -> None:
        self._scenario = scenario
        self._bench = bench
        self._publish = publish
        self._round = 0
        #: the number of steps that could not be carried out
        self.failed = 0
        self._open: dict[int, End] = {}  # by the number of the step

    def start(self, origin_ns: int) -> None:
        """Begin; the times of the steps count from ``origin_ns`` on."""
        moments: list[_Moment] = []
        for step in self._scenario.steps:
            moments.append((step.at_ns, 1, partial(self._begin, step)))
            if step.for_ns is not None and step.deed is not None:
                moments.append((step.at_ns + step.for_ns, 0, partial(self._end, step)))
        # at the same time ends come before begins
        moments.sort(key=lambda moment: moment[:2])
        self._wait(origin_ns, moments)

    def _wait(self, origin_ns: int, moments: list[_Moment]) -> None:
        """Wait for the first of ``moments``, or for the end of the round."""
        scenario = self._scenario
        if moments:
            self._bench.call_at(origin_ns + moments[0][0], partial(self._act, origin_ns, moments))
        elif scenario.period_ns is None:
            self._over()
        else:
            next_ns = origin_ns + scenario.period_ns
            self._bench.call_at(next_ns, partial(self._again, next_ns))

    def _act(self, origin_ns: int, moments: list[_Moment]) -> None:
        moments[0][2]()
        self._wait(origin_ns, moments[1:])

    def _over(self) -> None:
        left = sorted(self._open)
        numbers = ", ".join(map(str, left[:-1])) + (f" and {left[-1]}" if left[1:] else "".join(map(str, left)))
        rest = "" if not left else f"; step {numbers} still acts" if len(left) == 1 else f"; steps {numbers} still act"
        count = len(self._scenario.steps)
        if count == 1:
            what = "its step has failed" if self.failed else "its step is over"
        else:
            what = f"all {count} steps are over" + (f", {self.failed} of them failed" if self.failed else "")
        self._tell("over", what + rest)

    def _again(self, origin_ns: int) -> None:
        for step in self._scenario.steps:
            self._end(step)
        self._round += 1
        self._tell("again", f"begins again, round {self._round + 1}")
        self.start(origin_ns)

    def _begin(self, step: Step) -> None:
        deed = step.deed
        if deed is None:
            self._tell("begin", "back to normal", step)
            for other in self._scenario.steps:
                if other.address == step.address:
                    self._end(other)
            return
        try:
            end = deed.begin()
        except (DpError, ValueError) as error:
            self.failed += 1
            self._tell("failed", f"{deed.text}: {error}", step)
            return
        if end is not None:
            self._open[step.number] = end
        self._tell("begin", deed.text, step)

    def _end(self, step: Step) -> None:
        end = self._open.pop(step.number, None)
        if end is not None and step.deed is not None and end():
            self._tell("end", step.deed.text, step)

    def _tell(self, state: str, detail: str, step: Step | None = None) -> None:
        now = self._bench.now
        if step is None:
            self._publish(ScenarioEvent(t_ns=now, step=0, state=state, detail=detail))
            return
        unit = self._bench.station(step.address)
        self._publish(
            ScenarioEvent(
                t_ns=now,
                step=step.number,
                state=state,
                detail=detail,
                do=step.do,
                address=unit.address,
                name=unit.name,
                lasts_s=None if step.for_ns is None else ns_to_s(step.for_ns),
            )
        )


class SimulatedPlant:
    """Scenario, recordings and functions of the slaves of ``bench``; None: no slave is simulated, nothing happens.

    A context manager; :meth:`start` begins. ``scenario``: its file. Raises ConfigError for files and functions that
    cannot be used, and for functions without ``allow_code``.
    """

    def __init__(
        self,
        bench: Bench | None,
        publish: Callable[[Event], None],
        handlers: Mapping[str, Handler],
        *,
        scenario: str | None,
        allow_code: bool,
    ) -> None:
        self._run: ScenarioRun | None = None
        self._inputs: SimulatedInputs | None = None
        if bench is not None:
            if scenario is not None:
                self._run = ScenarioRun(load_scenario(scenario, bench, handlers), bench, publish)
            self._inputs = SimulatedInputs(bench, publish, allow_code=allow_code)

    def __enter__(self) -> SimulatedPlant:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def failed_steps(self) -> int:
        """The number of steps of the scenario that could not be carried out so far."""
        return 0 if self._run is None else self._run.failed

    def close(self) -> None:
        """End the threads of the functions."""
        if self._inputs is not None:
            self._inputs.close()

    def start(self, origin_ns: int) -> None:
        """Begin; all times count from ``origin_ns`` on."""
        if self._inputs is not None:
            self._inputs.start(origin_ns)
        if self._run is not None:
            self._run.start(origin_ns)
