"""``picture_of``: state and values of a slave, or of an S7-200 (``picture_of_cpu``), at one moment, made here only, by
the types of the live stream.

Status, statistics, summary and live stream are views of it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, Final

import msgspec
from msgspec import structs

from dpstack.api.slave.quality import seconds
from dpstack.api.slave.slave import sent_outputs
from dpstack.dp.field_map import as_json
from dpstack.dp.master.events import SlaveState
from dpstack.dp.process_image import inputs_are_valid, inputs_limit_ns
from dpstack.plant.items import (
    ClockValues,
    DiagnosisValues,
    DriveNotice,
    DriveValues,
    FaultValues,
    LinkValues,
    QualityValues,
    SentClockValues,
    SlaveClockValues,
    SlaveValues,
    all_of,
    changes_of,
)
from dpstack.plant.judge import JUDGED, clock_remark, drive_level, judged
from dpstack.plant.value_quality import GOOD, Judged, trouble_of
from dpstack.text import iso_time
from dpstack.units import NS_PER_MS, ns_to_s

if TYPE_CHECKING:
    from dpstack.api.bus.parts import BusBase
    from dpstack.api.config.slave import SlaveConfig
    from dpstack.api.ppi.polling import CpuPolling
    from dpstack.api.slave.drive import Drive
    from dpstack.api.slave.slave import Slave
    from dpstack.dp.master.scanner import Found
    from dpstack.dpv1.slave.clock_receiver import PlantClock
    from dpstack.drivers.snapshots import BusSnapshot, ClockSnapshot, SentClock, SlaveSnapshot
    from dpstack.fdl.interface import StationStats


def picture_of(bus: BusBase, slave: Slave) -> SlaveValues:
    """State and values of ``slave`` at this moment, with the verdicts on them."""
    picture = SlavePicture(bus, slave)
    picture.take(bus.snapshot)
    return picture.values


def clock_of(clock: ClockSnapshot | None, started_ns: int) -> ClockValues | None:
    """The time on the bus as the live stream has it; None: nobody sends it."""
    if clock is None:
        return None
    values = ClockValues(masters=[_sent(one, started_ns) for one in clock.others])
    if clock.interval_ns:
        values = structs.replace(
            values,
            interval_s=ns_to_s(clock.interval_ns),
            sent=None if clock.sent is None else _sent(clock.sent, started_ns),
            late_ms=round(clock.lateness.p999_ns / NS_PER_MS, 3),
            late_measured=clock.lateness.answers > 0,
            trouble=clock.trouble or None,
        )
    return structs.replace(values, remark=clock_remark(values))


def _sent(clock: SentClock, started_ns: int) -> SentClockValues:
    return SentClockValues(
        address=clock.master,
        time=iso_time(ns_to_s(clock.time_ns)),
        resolution_ms=clock.resolution_ms,
        synchronised=clock.synchronised,
        summer_time=clock.summer_time,
        at=round(max(0.0, ns_to_s(clock.at_ns - started_ns)), 3),
        values=clock.values,
    )


def _slave_clock(clock: PlantClock | None) -> SlaveClockValues | None:
    """The clock of a simulated slave, if it has a time."""
    if clock is None or clock.master is None:
        return None
    how = "synchronised" if clock.synchronised else "not synchronised"
    return SlaveClockValues(
        master=clock.master,
        synchronised=clock.synchronised,
        resolution_ms=clock.resolution_ms,
        corrected_ms=round(clock.corrected_ns / NS_PER_MS, 3),
        text=f"follows master {clock.master}, {how}",
    )


class Picture(ABC):
    """State and values of a station over time, and the keys that change."""

    def __init__(self) -> None:
        self.values = SlaveValues()
        self._is_new = True

    @abstractmethod
    def take(self, now: BusSnapshot) -> dict[str, Any]:
        """Take the values of this moment. Returns the keys that change, as plain data; the first time all.
        ``now``: the snapshot of the bus."""

    @abstractmethod
    def end(self) -> dict[str, Any]:
        """The bus has ended: nothing is alive. Returns the keys that change."""

    def _put(self, values: SlaveValues) -> dict[str, Any]:
        before, self.values = self.values, values
        if self._is_new:
            self._is_new = False
            self.values = judged(values)
            return all_of(self.values)
        changes = changes_of(before, values)
        if not JUDGED.isdisjoint(changes):
            self.values = judged(values)
            changes |= changes_of(values, self.values)
        return changes


def shown(judged: Judged, before: QualityValues | None, started_ns: int) -> QualityValues:
    """A quality as the live stream has it; one that lasts (``before``) keeps its time."""
    now = structs.replace(judged, since=seconds(judged.since, started_ns)).values
    return now if before is None or (before.reason, before.text) != (now.reason, now.text) else before


class SlavePicture(Picture):
    """State and values of ``slave`` over time; what has not changed since the last time is not made anew."""

    def __init__(self, bus: BusBase, slave: Slave) -> None:
        super().__init__()
        self._bus = bus
        self._slave = slave
        self._seen: object = None
        self._octets: object = None
        self._judged: object = None

    def end(self) -> dict[str, Any]:
        values = structs.replace(self.values, state=SlaveState.OFFLINE.value, inputs_valid=False)
        return self._put(self._with_quality(values, (b"", b"")))

    def take(self, now: BusSnapshot) -> dict[str, Any]:
        bus, slave, values = self._bus, self._slave, self.values
        view, runtime, setup = bus.view, bus.runtime, slave.setup
        snapshot, image = slave.snapshot, view.image(setup)
        found = None if now.found is None else now.found.get(slave.address)
        seen = snapshot, now.mode, found, now.found_all, runtime.not_running
        if seen != self._seen:
            self._seen, self._octets = seen, None
            values = self._with_state(values, snapshot, found)
        ready = values.state == SlaveState.DATA_EXCHANGE.value
        octets = image.inputs, image.outputs
        if octets != self._octets:
            self._octets = octets
            sent = b"" if view.read_only else sent_outputs(setup, image.outputs, now.mode, exchanging=ready)
            withheld = snapshot.withheld
            wanted = image.outputs if withheld is None else withheld
            values = _with_octets(values, slave.config, image.inputs, wanted, sent)
            values = structs.replace(values, withheld=None if withheld is None else True)
        doubted = slave.process_quality.standing
        age_ns = max(0, runtime.now() - image.input_time) if image.input_time else None
        limit_ns = inputs_limit_ns(snapshot.watchdog_ns, bus.poll_interval_ns(setup))
        link, drives = view.link.station(slave.address), bus.drives_at(slave.address)
        several = bool(slave.config.drives)
        values = structs.replace(
            values,
            inputs_valid=inputs_are_valid(exchanging=image.valid and ready, age_ns=age_ns, limit_ns=limit_ns),
            inputs_age_ms=None if age_ns is None else round(ns_to_s(age_ns) * 1000, 1),
            inputs_limit_ms=round(limit_ns / NS_PER_MS, 1),
            drive=_drive_values(bus, drives[0]) if drives and not several else None,
            drives={one.name: _drive_values(bus, one) for one in drives} if several else None,
            exchanges=image.exchanges,
            **_link_counts(link),
            links=_link_values(slave) if setup.links else None,
            clock=_slave_clock(None if bus.bench is None or now.clock is None else bus.bench.clock(slave.address)),
            injected=[] if bus.bench is None else bus.bench.injected(slave.address),
        )
        trouble = trouble_of(values, values.inputs_limit_ms or 0)
        judged = octets, doubted, trouble, slave.config
        if judged != self._judged:
            self._judged = judged
            values = self._with_quality(values, octets)
        return self._put(values)

    def _with_quality(self, values: SlaveValues, octets: tuple[bytes, bytes]) -> SlaveValues:
        """The qualities that are not good; one that lasts keeps its time."""
        slave, started = self._slave, self._bus.started_ns
        judge, config = slave.process_quality, slave.config

        of_all = judge.of_all(values, values.inputs_limit_ms or 0)
        places = judge.places()
        is_good = of_all is GOOD and not places
        before = values.qualities or {}
        qualities = {}
        for (_, fields), image in zip(config.fields, octets, strict=True):
            for name, field in fields.fields.items():
                if is_good and not field.speaks_for_itself:
                    continue
                own = judge.of_field(field, image, of_all, places)
                if own is not of_all and own is not GOOD:
                    qualities[name] = shown(own, before.get(name), started)
        doubts = [structs.replace(one, since=seconds(one.since, started)) for one in judge.doubts()]
        return structs.replace(
            values,
            quality=None if of_all is GOOD else shown(of_all, values.quality, started),
            qualities=qualities or None,
            doubts=doubts or None,
        )

    def _with_state(self, values: SlaveValues, snapshot: SlaveSnapshot, found: Found | None) -> SlaveValues:
        slave = self._slave
        fault, alarms, diagnosis = slave.fault, snapshot.alarms, slave.diagnosis
        return structs.replace(
            values,
            state=slave.state.value,
            fault=None if fault is None else FaultValues(fault.text, fault.kind.value),
            diagnosis=None if diagnosis is None else DiagnosisValues(list(diagnosis.flags), list(slave.block_texts)),
            conspicuous=slave.conspicuous,
            alarms=None if alarms is None else structs.asdict(alarms),
            watchdog_ms=slave.watchdog_ms,
            master=None if found is None else found.master,
        )


#: keys that the polling of a CPU describes
_OF_POLLING: Final = (
    "state",
    "fault",
    "conspicuous",
    "inputs_valid",
    "inputs_age_ms",
    "inputs_limit_ms",
    "exchanges",
)


class CpuPicture(Picture):
    """State and values of a CPU over time."""

    def __init__(self, bus: BusBase, polling: CpuPolling) -> None:
        super().__init__()
        self._bus = bus
        self._polling = polling

    def take(self, now: BusSnapshot) -> dict[str, Any]:
        polling, bus, before = self._polling, self._bus, self.values
        described = polling.described(bus.runtime.now())
        of_all, started = polling.judge_all(described), bus.started_ns
        judged = {name: polling.judge(name, of_all) for name in polling.config.values}
        earlier = before.qualities or {}
        qualities = {
            name: shown(one, earlier.get(name), started)
            for name, one in judged.items()
            if one is not of_all and one is not GOOD
        }
        link = bus.view.link.station(polling.config.address)
        values = structs.replace(  # the verdicts of before stay while nothing changes that they depend on
            before,
            **{key: getattr(described, key) for key in _OF_POLLING},
            fields=_json_values(polling),
            quality=None if of_all is GOOD else shown(of_all, before.quality, started),
            qualities=qualities or None,
            **_link_counts(link),
            watchdog_ms=0,
            injected=[] if bus.bench is None else bus.bench.injected(polling.config.address),
        )
        return self._put(values)

    def end(self) -> dict[str, Any]:
        self._polling.end()
        return self.take(self._bus.snapshot)


def _json_values(polling: CpuPolling) -> dict[str, object]:
    """The values of the last poll as plain data; None for one without."""
    found = {name: polling.value(name) for name in polling.config.values}
    there = as_json({name: value for name, value in found.items() if value is not None})
    return {name: there.get(name) for name in found}


def picture_of_cpu(bus: BusBase, polling: CpuPolling) -> SlaveValues:
    """State and values of a CPU at this moment, with the verdicts on them."""
    picture = CpuPicture(bus, polling)
    picture.take(bus.snapshot)
    return picture.values


def _link_counts(link: StationStats) -> dict[str, Any]:
    """The counters that the link layer has of a station."""
    counts = {key: getattr(link, key) for key in ("retries", "timeouts", "telegrams", "late", "wrong")}
    return {**counts, "bad": dict(link.bad)}


def _link_values(slave: Slave) -> list[LinkValues]:
    return [
        LinkValues(
            publisher=link.publisher,
            name=link.name,
            octets=f"{link.offset}:{link.offset + link.length}",
            to=link.to,
            good=link.good,
            text=link.text,
        )
        for link in slave.links
    ]


def _with_octets(values: SlaveValues, config: SlaveConfig, inputs: bytes, wanted: bytes, sent: bytes) -> SlaveValues:
    """``sent``: the outputs that the slave gets; ``wanted``: those that its application has set, held if the slave
    gets others."""
    named = as_json(config.output_fields.values(wanted))
    held, now = None, named
    if sent != wanted:
        held, there = wanted, len(sent) == len(wanted)
        now = as_json(config.output_fields.values(sent)) if there else dict.fromkeys(named)
    return structs.replace(
        values,
        inputs=inputs.hex(),
        outputs=sent.hex(),
        held=None if held is None else held.hex(),
        fields={**as_json(config.input_fields.values(inputs)), **now},
        held_fields=None if held is None or not named else named,
    )


def _drive_values(bus: BusBase, drive: Drive) -> DriveValues:
    """The status of ``drive``, and its notices with ``t`` in s since the start."""
    status = drive.status
    notices = [DriveNotice(round(ns_to_s(one.t_ns - bus.started_ns), 3), one.text) for one in drive.notices]
    return DriveValues(
        state=str(status.state),
        running=status.running,
        reached=status.reached,
        remote=status.remote,
        setpoint=status.setpoint,
        speed=status.speed,
        frequency_hz=status.frequency_hz,
        speed_rpm=status.speed_rpm,
        current=status.current,
        torque=status.torque,
        warnings=list(status.warnings),
        faults=list(status.faults),
        words=[f"{word:04X}" for word in status.words],
        bits=list(status.bits),
        settings=str(status.settings),
        settings_texts=list(status.settings_texts),
        notices=notices or None,
        level=drive_level(status.state),
    )


def drive_dict(values: DriveValues) -> dict[str, Any]:
    """The status of a drive as plain data, without the verdict; ``notices`` if there were some."""
    found: dict[str, Any] = msgspec.to_builtins(values)
    del found["level"]
    if found["notices"] is None:
        del found["notices"]
    return found
