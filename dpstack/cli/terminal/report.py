"""Reports of a running bus: events as JSON lines or lines for people, and the summary at the end."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from time import time
from typing import Any, Final

from msgspec import structs

from dpstack.api.bus.bus import Bus, core_of
from dpstack.api.bus.events_json import (
    DRIVE,
    AlarmRaised,
    DriveEvent,
    Event,
    MasterStopped,
    Severity,
    SlaveDiagnosis,
    SlaveState,
    SlaveStateChanged,
    Stalled,
    event_json,
)
from dpstack.api.bus.parts import SEARCHING
from dpstack.api.bus.statistics import BusStats, SlaveStats
from dpstack.api.slave.slave import Slave
from dpstack.api.streams import Flapping
from dpstack.cli.terminal import output
from dpstack.plant.items import QualityValues
from dpstack.plant.quality import Quality
from dpstack.text import iso_time, some_of
from dpstack.units import baud_text, ms_text, ns_to_s

#: limits, in s and as a part of its time, for the remark on a simulated bus that fell behind real time
_BEHIND_S: Final = 0.1
_BEHIND: Final = 0.02
#: limits, as number and as a part of its requests, for advice on the repetitions of a slave
_REPETITIONS: Final = 10
_REPEATED: Final = 0.05
#: extra_idle_bits for a slave that finds the end of a telegram by a pause (docs/development/foreign.md)
_EXTRA_IDLE_BITS: Final = 60
_STYLES = {Severity.INFO: "", Severity.WARNING: "yellow", Severity.ERROR: "red"}


#: states of the next bring-up after a fault, up to the same fault
_RETRIED: Final = frozenset(
    {SlaveState.DIAGNOSIS, SlaveState.SET_PRM, SlaveState.CHK_CFG, SlaveState.WAIT_READY, SlaveState.FAULT}
)


def event_printer(started_ns: int, *, json: bool) -> Callable[[Event, int], None]:
    """A function that prints the events of simulated slaves or of a segment, with the time since ``started_ns``, and
    the number of equal ones that an event stands for."""

    from dpstack.api.slave_side.repeated_events import times_text
    from dpstack.api.slave_side.virtual_bench import sim_event_json  # here, as a run has other events

    def show(event: Event, times: int) -> None:
        t = ns_to_s(event.t_ns - started_ns)
        if json:
            output.json_line(sim_event_json(event, t) | ({"times": times} if times > 1 else {}))
        else:
            output.line(f"{t:9.3f} s  {event.text}{times_text(times)}")

    return show


class Reporter:
    """Prints the start line, then every event of ``bus``. ``quiet``: no lines for people."""

    def __init__(self, bus: Bus, *, json: bool, quiet: bool = False) -> None:
        self._bus = bus
        self._json = json
        #: no lines for people, for instance while a live screen shows the events
        self.quiet = quiet
        self._started = False
        #: by address: the last reported diagnosis and drive status
        self._diagnoses: dict[int, str] = {}
        self._drives: dict[tuple[int, object], tuple[str, ...]] = {}
        self._flapping: dict[tuple[int, object], Flapping] = {}
        #: slaves whose fault was reported; the master tries them again and again
        self._retried: set[int] = set()
        #: slaves in data exchange, according to the events
        self._exchanging: set[int] = set()
        #: whether the master has stalled
        self.stalled = False

    def searching(self) -> None:
        """Report that the baud rate is being searched."""
        if not self._json and not self.quiet:
            output.line(f"{SEARCHING} on {self._bus.config.port}")

    def start(self) -> None:
        if self._started:
            return
        self._started = True
        bus = self._bus
        name, rate = core_of(bus).runtime.port_name, bus.params.baud
        if self._json:
            start = {"event": "start", "time": iso_time(time()), "port": name, "baud": rate}
            output.json_line({**start, "driver": bus.driver})
        elif not self.quiet:
            output.line(f"master {bus.params.address} on {name} at {baud_text(rate)}", "bold")

    def event(self, event: Event) -> None:
        self.start()
        self.stalled |= isinstance(event, Stalled)
        if self._json:
            line = event_json(event, self._seconds_of(event))
            if line is not None:
                output.json_line(line)
        elif not self.quiet:
            self._for_people(event)

    def _seconds_of(self, event: Event) -> float:
        return ns_to_s(event.t_ns - core_of(self._bus).started_ns)

    def _for_people(self, event: Event) -> None:
        """Write a line for the event; for diagnoses and drives only if something is new."""
        match event:
            case MasterStopped():
                return
            case SlaveDiagnosis(address=address, diagnosis=diagnosis):
                exchanging = address in self._exchanging
                slaves = [
                    slave for slave in self._bus.slaves if slave.address == address
                ]  # none: it was removed meanwhile
                found = "".join(slave.conspicuous_text(diagnosis, exchanging=exchanging) for slave in slaves)
                if found != self._diagnoses.get(address, ""):
                    self._diagnoses[address] = found
                    text = f"slave {address} ({event.name}): diagnosis {found or 'without findings'}"
                    self._line(event, text, "yellow" if found else "")
                    for slave in slaves:
                        self._values_of(slave, event)
            case AlarmRaised(address=address, texts=texts):
                known = self._diagnoses.get(address, "").split("; ")  # those of the diagnosis that it came in
                self._line(event, structs.replace(event, texts=tuple(t for t in texts if t not in known)).text)
            case DriveEvent(address=address, payload=payload):
                self._drive(address, event, payload)
            case SlaveStateChanged(address=address, state=state):
                if state is SlaveState.DATA_EXCHANGE:
                    self._exchanging.add(address)
                else:
                    self._exchanging.discard(address)
                    self._diagnoses.pop(address, None)  # its next diagnosis is new
                if state in _RETRIED and address in self._retried:
                    return  # another try with the same result
                if state is SlaveState.FAULT:
                    self._retried.add(address)
                else:
                    self._retried.discard(address)
                self._line(event)
            case _:
                self._line(event)

    def _values_of(self, slave: Slave, event: SlaveDiagnosis) -> None:
        """Write a line on the named values that a diagnosis makes bad or uncertain, if there are any."""
        named: dict[tuple[str, str], list[str]] = {}
        for name in (*slave.config.input_fields.fields, *slave.config.output_fields.fields):
            told = slave.value(name)
            if told.quality in (Quality.BAD, Quality.UNCERTAIN):
                named.setdefault((told.quality.value, told.text), []).append(name)
        parts = [f"{some_of(names)} {quality} ({text})" for (quality, text), names in named.items()]
        if parts:
            self._line(event, f"{slave.who}: {'; '.join(parts)}", "yellow")

    def _drive(self, address: int, event: DriveEvent, payload: Mapping[str, object]) -> None:
        match payload.get("type"):
            case "result":
                return
            case "status":
                drive = address, payload.get(DRIVE)
                status = tuple(str(payload.get(key)) for key in ("state", "faults", "warnings"))
                if status == self._drives.get(drive):
                    return
                self._drives[drive] = status
                if payload.get("state") == "offline":
                    return  # the state of its slave is reported anyway
                if drive not in self._flapping:
                    self._flapping[drive] = Flapping(self._line)
                self._flapping[drive].publish(event)
            case _:
                self._line(event)

    def _line(self, event: Event, text: str = "", style: str | None = None) -> None:
        line = f"{self._seconds_of(event):9.3f} s  {text or event.text}"
        output.line(line, _style(event) if style is None else style)

    def summary(self, stats: BusStats, **more: object) -> None:
        """Write the summary: a JSON line, or tables for people."""
        if self._json:
            output.json_line({"event": "summary", "t": round(stats.seconds, 3), **stats.summary(), **more})
            return
        for flapping in self._flapping.values():
            flapping.report()
        slaves, settings = stats.slaves.values(), self._bus.config.bus
        columns = ("address", "name", "state", "exchanges", "retries", "time-outs", "late", "bad")
        output.table("Slaves", columns, [_slave_row(s) for s in slaves])
        _diagnoses(slaves)
        if not settings.read_only:  # else the master has no mode
            _process_data(slaves)
        output.line(f"{stats.rotations} rotations in {stats.seconds:.3f} s, {_traffic(stats)}")
        for name, us in (("bus rotation time", stats.rotation_us), ("token rotation", stats.token_us)):
            if us["max"]:
                output.line(f"{name} in us: " + ", ".join(f"{key} {value}" for key, value in us.items()))
        _repetitions(slaves, settings.extra_idle_bits)
        _cycles(stats)
        if stats.host_us is not None:
            late = stats.host_us
            output.line(
                f"port and computer cost {late['p50']} us an exchange (p99.9 {late['p999']} us); "
                f"a missing answer is waited for {stats.host_slack_ms:g} ms longer"
            )
        if stats.behind > max(_BEHIND_S, _BEHIND * stats.seconds):
            output.line(
                f"simulated {stats.seconds:.1f} s of bus time in {stats.seconds + stats.behind:.1f} s: "
                "the simulated bus did not keep up with real time",
                "yellow",
            )
        if stats.stale:
            output.line(f"the counters are {stats.age:.1f} s old: the bus process did not go on counting", "yellow")
        if not stats.paced:
            output.line("no wire gave the octets their time here: the times are this computer's, not a bus's")


def _cycles(stats: BusStats) -> None:
    book = stats.cycles
    if book is None:
        return
    late = ", ".join(f"{key} {value}" for key, value in book.late.summary_us().items())
    output.line(f"{book.begun} cycles of {ms_text(book.cycle_ns)}, late in us: {late}")
    if book.missed:
        why = ", ".join(f"{count} {reason.text}" for reason, count in book.reasons.items())
        output.line(f"{book.missed} deadline misses ({book.left_out} cycles left out): {why}", "yellow")
    else:
        output.line("no deadline was missed")


def _style(event: Event) -> str:
    if isinstance(event, DriveEvent) and event.payload.get("type") != "failed":
        return "red" if event.payload.get("faults") else "yellow" if event.payload.get("warnings") else ""
    return _STYLES[event.severity]


def _diagnoses(slaves: Iterable[SlaveStats]) -> None:
    """Write diagnoses, faults and notices of slaves and drives, if there are any."""
    rows: list[tuple[object, ...]] = []
    for s in slaves:
        found = [("diagnosis", s.conspicuous)] if s.conspicuous else []
        for name, drive in {"drive": s.drive, **s.drives}.items():
            for kind in ("fault", "warning"):
                found += [(f"{name} {kind}", str(one)) for one in _list(drive.get(f"{kind}s"))]
            found += [(f"{name} at {one['t']} s", str(one["text"])) for one in _list(drive.get("notices"))]
        rows += [(s.address, s.name, what, text) for what, text in found]
    if rows:
        output.table("Diagnoses and drives", ("address", "name", "what", "text"), rows)


def _repetitions(slaves: Iterable[SlaveStats], extra_idle_bits: int) -> None:
    """Write advice for each slave with many repetitions, by their cause: damaged answers, or none."""
    for s in slaves:
        link = s.link
        if s.retries < max(_REPETITIONS, _REPEATED * link.requests):
            continue
        advice = "check cable, shielding and termination"
        if sum(link.bad.values()) < s.retries // 2 and extra_idle_bits < _EXTRA_IDLE_BITS:
            advice += (
                "; a self-made slave that finds the end of a telegram by a pause misses requests that follow too soon: "
                f"try extra_idle_bits = {_EXTRA_IDLE_BITS} in [bus]"
            )
        output.line(
            f"slave {s.address} ({s.name}): {s.retries} repetitions of {link.requests} requests: {advice}", "yellow"
        )


def _list(found: object) -> list[Any]:
    return list(found) if isinstance(found, (list, tuple)) else []


def _process_data(slaves: Iterable[SlaveStats]) -> None:
    """Write the last process data, marked if they are not those of now."""
    octets = []
    for s in slaves:
        if s.protocol:  # an S7-200 has named values only
            continue
        inputs = _marked(s.inputs, "" if s.inputs_valid else " (not valid)")
        outputs = _marked(s.outputs, "")
        if s.held is not None:
            outputs = f"{_marked(s.outputs, ' ')}({'withheld' if s.withheld else 'not sent'}: {s.held.hex()})"
        octets.append((s.address, s.name, inputs, outputs))
    if octets:
        output.table("Process data", ("address", "name", "inputs", "outputs"), octets)
    named = [
        (s.address, s.name, key, f"{value} {s.units[key]}" if key in s.units else value, _quality(s.qualities.get(key)))
        for s in slaves
        for key, value in s.fields.items()
    ]
    if named:
        columns = 5 if any(row[-1] for row in named) else 4
        rows = [row[:columns] for row in named]
        output.table("Named inputs and outputs", ("address", "name", "field", "value", "quality")[:columns], rows)


def _quality(told: QualityValues | None) -> str:
    """A quality in words; empty for good."""
    return "" if told is None else f"{told.quality}: {told.text}"


def _marked(octets: bytes, mark: str) -> str:
    return octets.hex() + (mark if octets else "")


def _slave_row(s: SlaveStats) -> tuple[object, ...]:
    state = s.state if s.master is None else f"{s.state} (master {s.master})"
    link = s.link
    counters = (s.exchanges, s.retries, s.timeouts, link.late + link.wrong, sum(link.bad.values()))
    return (s.address, s.name, state, *counters)


def _traffic(stats: BusStats) -> str:
    """Telegrams and failures on the bus for people, without zeros."""
    counters = {
        "repeated": stats.retries,
        "given up": stats.timeouts,
        "late": stats.late,
        "stray": stats.link.stray,
        "tokens lost": stats.tokens_lost,
        "tokens repeated": stats.link.token_retries,
        **{f"bad: {cause.replace('_', ' ')}": count for cause, count in stats.bad.items()},
    }
    wrong = [f"{count} {name}" for name, count in counters.items() if count]
    return f"{stats.telegrams} telegrams" + (f" ({', '.join(wrong)})" if wrong else ", none of them failed")


def clear_text(held: Mapping[str, object]) -> str:
    """The line on a master that went to Clear by itself (``held``: see clear_since)."""
    return f"in Clear since {held['since']} s because of a {held['because']}; operate() lets outputs out again"


def not_exchanging(bus: Bus) -> list[str]:
    """One line for each slave that is not in data exchange though it should be."""
    lines = []
    for slave in bus.slaves:
        if not (slave.ready_now or slave.deactivated):
            if slave.fault:
                why = slave.fault.text
            elif not bus.stats.tokens:
                why = "this master did not get the token in that time; another master may have it: run longer"
            else:
                why = f"it is in {slave.state.value}"
            lines.append(f"slave {slave.address} ({slave.name}) is not in data exchange: {why}")
    asked = () if bus.config.bus.read_only else bus.cpus
    lines += [f"{cpu.who} gives no values: {cpu.fault or 'not asked yet'}" for cpu in asked if not cpu.ready_now]
    return lines
