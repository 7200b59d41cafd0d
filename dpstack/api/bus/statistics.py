"""Counters and rotation times of a bus: ``bus.stats``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Final

from msgspec import Struct, field, structs, to_builtins

from dpstack.api.bus.picture import drive_dict, picture_of, picture_of_cpu
from dpstack.dp.master.fixed_cycle import CycleStats
from dpstack.dp.master.slave_reports import AlarmCounts
from dpstack.drivers.snapshots import Counters
from dpstack.fdl.interface import LinkStats, StationStats
from dpstack.plant.items import PPI, QualityValues
from dpstack.plant.value_quality import qualities_of
from dpstack.units import NS_PER_MS, NS_PER_S, NS_PER_US, ns_to_s

if TYPE_CHECKING:
    from dpstack.api.bus.parts import BusBase
    from dpstack.api.ppi.polling import CpuPolling
    from dpstack.api.slave.slave import Slave

#: age (ns) from which counters are stale
STALE_NS: Final = NS_PER_S


class SlaveStats(Struct, frozen=True, kw_only=True):
    """One slave's counters since the start; ``link`` are those of the link layer."""

    #: station address, 0..126
    address: int
    #: name in the configuration
    name: str
    #: state in the words of :class:`SlaveState`
    state: str
    #: successful data exchanges
    exchanges: int
    #: repeated requests
    retries: int
    #: requests given up
    timeouts: int
    #: last valid inputs
    inputs: bytes
    #: the inputs are those of a slave in data exchange, and not too old
    inputs_valid: bool
    #: age of the inputs in seconds; None before the first ones
    inputs_age: float | None
    #: outputs that the slave gets
    outputs: bytes
    #: outputs of the application while they wait for Operate or data exchange, or are withheld; else None
    held: bytes | None
    #: the effective watchdog, 0 when off
    watchdog_ms: int
    #: counters of the link layer for this station
    link: StationStats
    #: address of its master on a read-only bus; None: not known
    master: int | None = None
    #: named inputs, and named outputs that the slave gets; octets as hex
    fields: Mapping[str, object] = field(default_factory=dict)
    #: named outputs of ``held``
    held_fields: Mapping[str, object] = field(default_factory=dict)
    #: ``held`` is not sent until outputs are set anew, because the slave was away (``after_return``)
    withheld: bool = False
    #: units of the named fields that have one
    units: Mapping[str, str] = field(default_factory=dict)
    #: quality of all its values and of its drive; None: good
    quality: QualityValues | None = None
    #: by name those of named values that are not good
    qualities: Mapping[str, QualityValues] = field(default_factory=dict)
    #: counters of its alarms, None for a slave without DP-V1
    alarms: AlarmCounts | None = None
    #: flags and texts of its last diagnosis; empty before the first
    diagnosis: Mapping[str, object] = field(default_factory=dict)
    #: unusual flags and texts of its last diagnosis in one line
    conspicuous: str = ""
    #: status and notices of its drive; empty for other slaves
    drive: Mapping[str, object] = field(default_factory=dict)
    #: the same of each drive by its name, of a slave with several; empty for other slaves
    drives: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    #: ppi of an S7-200, which has no octets of inputs and outputs; empty for slaves
    protocol: str = ""

    def as_dict(self) -> dict[str, object]:
        """As in the summary line of ``run --json``."""
        return {
            "name": self.name,
            "state": self.state,
            "exchanges": self.exchanges,
            "retries": self.retries,
            "timeouts": self.timeouts,
            "inputs": self.inputs.hex(),
            "inputs_valid": self.inputs_valid,
            "inputs_age_ms": None if self.inputs_age is None else round(self.inputs_age * 1000, 1),
            "outputs": self.outputs.hex(),
            **({} if self.held is None else {"held": self.held.hex()}),
            "watchdog_ms": self.watchdog_ms,
            **({"fields": dict(self.fields)} if self.fields else {}),
            **({"held_fields": dict(self.held_fields)} if self.held_fields else {}),
            **({"withheld": True} if self.withheld else {}),
            **({"units": dict(self.units)} if self.units else {}),
            **({} if self.quality is None else {"quality": to_builtins(self.quality)}),
            **({"qualities": to_builtins(self.qualities)} if self.qualities else {}),
            **_link_dict(self.link),
            **({} if self.master is None else {"master": self.master}),
            **({} if self.alarms is None else {"alarms": structs.asdict(self.alarms)}),
            **self.diagnosis,
            **({"drive": dict(self.drive)} if self.drive else {}),
            **({"drives": {name: dict(one) for name, one in self.drives.items()}} if self.drives else {}),
            **({"protocol": self.protocol} if self.protocol else {}),
        }


def _link_dict(link: StationStats) -> dict[str, object]:
    return {"telegrams": link.telegrams, "late": link.late, "wrong": link.wrong, "bad": dict(link.bad)}


class BusStats(Struct, frozen=True, kw_only=True):
    """Counters of the whole bus. Rotation times in whole microseconds: ``min``, ``p50``, ``p99``, ``p999``, ``max``.

    ``bad``: unreadable octets and telegrams by cause (names of DecoderStats); ``uart_...``: octets that the adapter or
    its driver found damaged.

    ``stale``: the bus does not run, or the counters are older than 1 s.
    """

    #: bus time since the start, in seconds
    seconds: float
    #: False on a port without octet times (pty): the figures are then the computer's
    paced: bool
    #: number of rounds of data exchange
    rotations: int
    #: rotation times in us, from the first Data_Exchange of a round to that of the next: min, p50, p99, p999, max
    rotation_us: dict[str, int]
    #: times in us from token receipt to token receipt, as ``rotation_us``
    token_us: dict[str, int]
    #: counters of each slave, by address
    slaves: dict[int, SlaveStats]
    #: tokens that this station received and used
    tokens: int
    #: times that this station found the bus silent for T_TO and claimed the token
    tokens_lost: int
    #: answers that came after their slot time
    late: int
    bad: dict[str, int]
    #: counters of this station's link layer
    link: LinkStats
    #: statistics of the fixed cycles; None free running
    cycles: CycleStats | None
    #: requests that did not fit between two cycles and were delayed
    held_back: int
    #: requests that fit between no two cycles and were sent all the same
    forced: int
    #: delay of answers by computer, adapter and T_SDR, as ``rotation_us``; None before the first measurement
    host_us: dict[str, int] | None
    #: waiting time beyond the slot time for a known station, in ms
    host_slack_ms: float
    #: age of the counters in seconds: 0 if the bus runs in this process, some 0.1 s with a bus process
    age: float = 0.0
    stale: bool = False
    #: lag of a simulated bus behind real time in s
    behind: float = 0.0

    @property
    def stations(self) -> dict[int, StationStats]:
        """counters of the link layer, by address of the station that got a request"""
        return self.link.stations

    @property
    def telegrams(self) -> int:
        """Number of telegrams sent and received, tokens included."""
        return self.link.sent + self.link.heard

    @property
    def retries(self) -> int:
        """repeated requests to all stations"""
        return sum(station.retries for station in self.stations.values())

    @property
    def timeouts(self) -> int:
        """requests to all stations that were given up"""
        return sum(station.timeouts for station in self.stations.values())

    def _cycle_dict(self) -> dict[str, object]:
        """Keys of the summary about the fixed cycle."""
        stats = self.cycles
        if stats is None:
            return {}
        return {
            "cycle_us": stats.cycle_ns / NS_PER_US,
            "cycles": stats.begun,
            "late_us": stats.late.summary_us(),
            "missed": stats.missed,
            "left_out": stats.left_out,
            "missed_by": {reason.value: count for reason, count in stats.reasons.items()},
            "held_back": self.held_back,
            "forced": self.forced,
        }

    def summary(self) -> dict[str, object]:
        """The summary line of ``run --json``, without ``event`` and ``t``."""
        return {
            "seconds": round(self.seconds, 3),
            "paced": self.paced,
            "rotations": self.rotations,
            "rotation_us": self.rotation_us,
            "token_us": self.token_us,
            **self._cycle_dict(),
            "tokens": self.tokens,
            "tokens_lost": self.tokens_lost,
            "telegrams": self.telegrams,
            "sent": self.link.sent,
            "retries": self.retries,
            "timeouts": self.timeouts,
            "late": self.late,
            "stray": self.link.stray,
            "garbled": self.link.garbled,
            "token_retries": self.link.token_retries,
            "gap_polls": self.link.gap_polls,
            "bad": self.bad,
            "host_us": self.host_us,
            "host_slack_ms": self.host_slack_ms,
            "age_ms": round(self.age * 1000, 1),
            "stale": self.stale,
            "behind_ms": round(self.behind * 1000, 1),
            "slaves": {str(address): slave.as_dict() for address, slave in self.slaves.items()},
        }


def clear_since(bus: BusBase) -> dict[str, object]:
    """``since`` (in s after the start) and ``because`` of a Clear that the master went to by itself; else empty."""
    event = bus.forced_clear
    if event is None:
        return {}
    return {"since": round(ns_to_s(event.t_ns - bus.started_ns), 3), "because": event.why}


def bus_figures(
    bus: BusBase, slaves: Iterable[Slave] = (), counters: Counters | None = None, *, cpus: Iterable[CpuPolling] = ()
) -> BusStats:
    """The counters of this moment, with those of ``slaves`` and ``cpus``. Never waits for a bus process. ``counters``:
    those of the bus if the caller has them; else a copy."""
    view, now = bus.view, bus.runtime.now()
    counters = view.counters() if counters is None else counters
    age_ns = max(0, now - counters.t_ns) if counters.t_ns else 0
    link = counters.link
    bad = counters.decoder.by_cause()
    bad |= {f"uart_{cause}": count for cause, count in counters.damage.items() if count}
    return BusStats(
        seconds=bus.seconds,
        paced=bus.runtime.paced,
        rotations=view.rotations,
        rotation_us=counters.rotation.summary_us(),
        token_us=counters.token_rotation.summary_us(),
        cycles=counters.cycles if counters.cycles.cycle_ns else None,
        held_back=counters.held_back,
        forced=counters.forced,
        slaves={slave.address: _slave_stats(bus, slave, link.station(slave.address)) for slave in slaves}
        | _cpu_stats(bus, cpus, link),
        tokens=link.tokens,
        tokens_lost=link.tokens_lost,
        late=link.late,
        bad=bad,
        link=link,
        host_us=counters.lateness.summary_us() if counters.lateness.count else None,
        host_slack_ms=bus.snapshot.patience.known_ns / NS_PER_MS,
        age=ns_to_s(age_ns),
        behind=ns_to_s(bus.runtime.behind_ns),
        stale=bus.runtime.not_running is not None or age_ns > STALE_NS,
    )


def _cpu_stats(bus: BusBase, cpus: Iterable[CpuPolling], link: LinkStats) -> dict[int, SlaveStats]:
    """The counters of S7-200 CPUs, as those of slaves."""
    return {one.config.address: _stats_of_cpu(bus, one, link.station(one.config.address)) for one in cpus}


def _stats_of_cpu(bus: BusBase, polling: CpuPolling, link: StationStats) -> SlaveStats:
    """The counters of a CPU, as those of a slave."""
    values, config = picture_of_cpu(bus, polling), polling.config
    age_ms = values.inputs_age_ms
    return SlaveStats(
        address=config.address,
        name=config.name,
        state=polling.state.value,
        exchanges=polling.polls,
        retries=link.retries,
        timeouts=link.timeouts,
        inputs=b"",
        inputs_valid=values.inputs_valid is True,
        inputs_age=None if age_ms is None else age_ms / 1000,
        outputs=b"",
        held=None,
        watchdog_ms=0,
        link=link,
        fields=values.fields or {},
        units=config.input_fields.units | config.output_fields.units,
        quality=values.quality,
        qualities=qualities_of(values),
        protocol=PPI,
    )


def _slave_stats(bus: BusBase, slave: Slave, link: StationStats) -> SlaveStats:
    values = picture_of(bus, slave)
    return SlaveStats(
        address=slave.address,
        name=slave.name,
        state=slave.state.value,
        exchanges=values.exchanges or 0,
        retries=link.retries,
        timeouts=link.timeouts,
        inputs=slave.inputs,
        inputs_valid=values.inputs_valid is True,
        inputs_age=slave.inputs_age,
        outputs=slave.outputs_sent,
        held=None if values.held is None else bytes.fromhex(values.held),
        watchdog_ms=slave.watchdog_ms,
        link=link,
        master=values.master,
        fields=values.fields or {},
        held_fields=values.held_fields or {},
        withheld=values.withheld is True,
        units=slave.config.input_fields.units | slave.config.output_fields.units,
        quality=values.quality,
        qualities=qualities_of(values),
        alarms=slave.alarm_counts,
        diagnosis={} if values.diagnosis is None else {"diagnosis": to_builtins(values.diagnosis)},
        conspicuous=values.conspicuous or "",
        drive={} if values.drive is None else drive_dict(values.drive),
        drives={name: drive_dict(one) for name, one in (values.drives or {}).items()},
    )
