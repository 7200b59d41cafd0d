"""All metrics: name, kind, labels, meaning. The page docs/reference/metrics.md is written from this table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from dpstack.monitor.verdict import VERDICTS
from dpstack.plant import nodes
from dpstack.plant.judge import STATES

GAUGE, COUNTER, HISTOGRAM = "gauge", "counter", "histogram"


@dataclass(frozen=True, slots=True)
class Metric:
    """``name``: as scraped, a counter with ``_total``; a histogram has series ``_bucket``, ``_sum`` and ``_count``."""

    name: str
    kind: str
    labels: tuple[str, ...]
    text: str


MODES: Final = ("offline", "stop", "clear", "operate")
LEVELS: Final = ("warning", "error")
#: counters of the bus by their key in the live stream
BUS_COUNTERS: Final = {
    "rotations": Metric("dpstack_bus_rotations_total", COUNTER, (), "rounds of Data_Exchange with all slaves"),
    "telegrams": Metric("dpstack_bus_telegrams_total", COUNTER, (), "telegrams sent and received, tokens included"),
    "sent": Metric("dpstack_bus_telegrams_sent_total", COUNTER, (), "telegrams sent by this master, tokens included"),
    "retries": Metric("dpstack_bus_retries_total", COUNTER, (), "repeated requests"),
    "timeouts": Metric("dpstack_bus_timeouts_total", COUNTER, (), "requests without an answer"),
    "late": Metric("dpstack_bus_late_total", COUNTER, (), "answers after the slot time"),
    "stray": Metric("dpstack_bus_stray_total", COUNTER, (), "answers without a request"),
    "garbled": Metric("dpstack_bus_garbled_total", COUNTER, (), "answers of which only unreadable octets came"),
    "tokens": Metric("dpstack_bus_tokens_total", COUNTER, (), "tokens received"),
    "tokens_lost": Metric("dpstack_bus_tokens_lost_total", COUNTER, (), "tokens that were lost"),
    "token_retries": Metric("dpstack_bus_token_retries_total", COUNTER, (), "repeated tokens"),
    "gap_polls": Metric("dpstack_bus_gap_polls_total", COUNTER, (), "requests to addresses in the GAP"),
    "cycles": Metric("dpstack_bus_cycles_total", COUNTER, (), "fixed cycles begun; with a fixed cycle only"),
    "missed": Metric("dpstack_bus_cycles_missed_total", COUNTER, (), "fixed cycles missed; with a fixed cycle only"),
    "left_out": Metric("dpstack_bus_cycles_left_out_total", COUNTER, (), "fixed cycles left out; with one only"),
}
#: histograms of the bus by their key in the live stream
BUS_HISTOGRAMS: Final = {
    "rotation": Metric("dpstack_bus_rotation_seconds", HISTOGRAM, (), "time of a rotation: from round to round"),
    "token": Metric("dpstack_bus_token_rotation_seconds", HISTOGRAM, (), "time from token receipt to token receipt"),
    "host": Metric("dpstack_bus_host_delay_seconds", HISTOGRAM, (), "delay of answers by computer, adapter and T_SDR"),
    "late": Metric(
        "dpstack_bus_cycle_lateness_seconds", HISTOGRAM, (), "lateness of fixed cycles; with a fixed cycle only"
    ),
}
_SLAVE: Final = ("address", "slave")
#: counters of a slave by their key in the live stream
SLAVE_COUNTERS: Final = {
    key: Metric(f"dpstack_slave_{key}_total", COUNTER, _SLAVE, text) for key, text in nodes.SLAVE_COUNTERS.items()
}

BUILD: Final = Metric("dpstack_build_info", GAUGE, ("version",), "1; the version of dpstack")
CPU: Final = Metric("dpstack_process_cpu_seconds_total", COUNTER, ("process",), "CPU time, user and system")
MEMORY: Final = Metric("dpstack_process_resident_memory_bytes", GAUGE, ("process",), "resident memory")
OPEN_FDS: Final = Metric("dpstack_process_open_fds", GAUGE, ("process",), "open file descriptors")
MAX_FDS: Final = Metric("dpstack_process_max_fds", GAUGE, ("process",), "file descriptors that may be open")
START: Final = Metric(
    "dpstack_process_start_time_seconds", GAUGE, ("process",), "start of the process, in seconds since 1970"
)
_VALUE: Final = (*_SLAVE, "value", "direction", "unit")
VALUE: Final = Metric(
    "dpstack_slave_value", GAUGE, _VALUE, "a process value of this moment; absent while it is stale or bad; true is 1"
)
VALUE_QUALITY: Final = Metric(
    "dpstack_slave_value_quality", GAUGE, _VALUE, "the quality of a process value: 3 good, 2 uncertain, 1 stale, 0 bad"
)
VALUES_LEFT_OUT: Final = Metric(
    "dpstack_metrics_values_left_out", GAUGE, (), "process values without series, as `most_values` is too small"
)
CONNECTOR_UP: Final = Metric(
    "dpstack_connector_up", GAUGE, ("connector",), "1 while the connector serves; 0: it has ended by a fault"
)
CONNECTOR_CONNECTED: Final = Metric(
    "dpstack_connector_connected",
    GAUGE,
    ("connector",),
    "1 while the connector is connected to its broker; of connectors that have one",
)
CONNECTOR_DROPPED: Final = Metric(
    "dpstack_connector_dropped_total",
    COUNTER,
    ("connector",),
    "changes that the connector dropped, as they were not taken in time",
)
REQUESTS: Final = Metric("dpstack_metrics_requests_total", COUNTER, ("code",), "answers of this server by HTTP status")
REFUSED: Final = Metric(
    "dpstack_metrics_connections_refused_total", COUNTER, (), "connections closed at once: too many are open"
)
STREAM_UP: Final = Metric("dpstack_stream_up", GAUGE, (), "1 while the live stream of the bus comes, and in time")
STREAM_LOST: Final = Metric(
    "dpstack_stream_events_lost_total", COUNTER, (), "events of the bus that the connectors did not get"
)
BUS_UP: Final = Metric("dpstack_bus_up", GAUGE, (), "1 while the bus runs and its stream comes; 0: it is dead")
BUS_INFO: Final = Metric(
    "dpstack_bus_info",
    GAUGE,
    ("port", "baud", "driver", "address", "config_digest"),
    "1; port, bit/s, driver, address of the master, SHA-256 of its configuration",
)
BUS_MODE: Final = Metric("dpstack_bus_mode", GAUGE, ("mode",), f"1 for the mode of the master: {', '.join(MODES)}")
BUS_IN_RING: Final = Metric("dpstack_bus_in_ring", GAUGE, (), "1 while the master is in the token ring")
BUS_MASTERS: Final = Metric("dpstack_bus_masters", GAUGE, (), "number of masters in the token ring")
BUS_CLEAR: Final = Metric("dpstack_bus_clear_forced", GAUGE, (), "1 while the master is in Clear by itself")
BUS_COUNTERS_AGE: Final = Metric("dpstack_bus_counters_age_seconds", GAUGE, (), "age of the counters of the bus")
BUS_PLANNED: Final = Metric(
    "dpstack_bus_planned_rotation_seconds",
    GAUGE,
    ("case",),
    "calculated time of a rotation: min, typical, max (with every repetition)",
)
BUS_DAMAGED: Final = Metric(
    "dpstack_bus_damaged_total", COUNTER, ("cause",), "damaged telegrams and octets outside of telegrams, by cause"
)
BUS_VERDICT: Final = Metric(
    "dpstack_bus_verdict",
    GAUGE,
    ("verdict",),
    f"1 for the verdict on the bus, by the last 5 min: {', '.join(VERDICTS)}",
)
SLAVES: Final = Metric("dpstack_bus_slaves", GAUGE, (), "number of configured slaves")
SLAVE_STATE: Final = Metric(
    "dpstack_slave_state",
    GAUGE,
    (*_SLAVE, "state"),
    f"1 for the state in which the master has the slave: {', '.join(STATES)}",
)
SLAVE_VERDICT: Final = Metric(
    "dpstack_slave_verdict",
    GAUGE,
    (*_SLAVE, "verdict"),
    f"1 for the verdict on the slave, by the last 5 min: {', '.join(VERDICTS)}",
)
EXCHANGING: Final = Metric("dpstack_slave_in_data_exchange", GAUGE, _SLAVE, "1 while the slave is in data exchange")
INPUTS_VALID: Final = Metric("dpstack_slave_inputs_valid", GAUGE, _SLAVE, "1 while the inputs of the slave are valid")
INPUTS_AGE: Final = Metric(
    "dpstack_slave_inputs_age_seconds", GAUGE, _SLAVE, "age of the inputs; while the slave is in data exchange"
)
WATCHDOG: Final = Metric("dpstack_slave_watchdog_seconds", GAUGE, _SLAVE, "watchdog of the slave; 0: off")
FAULT: Final = Metric("dpstack_slave_fault", GAUGE, _SLAVE, "1 while the master has a fault for the slave")
DIAGNOSIS: Final = Metric("dpstack_slave_diagnosis", GAUGE, _SLAVE, "1 while its diagnosis has unusual flags or texts")
CONDITIONS: Final = Metric(
    "dpstack_slave_conditions_active",
    GAUGE,
    (*_SLAVE, "level"),
    "active conditions (faults, diagnoses, alarms) by level: warning, error",
)
SLAVE_DAMAGED: Final = Metric(
    "dpstack_slave_damaged_total", COUNTER, (*_SLAVE, "cause"), "damaged telegrams while its answer was due, by cause"
)

METRICS: Final = (
    BUS_UP,
    STREAM_UP,
    STREAM_LOST,
    BUS_INFO,
    BUS_MODE,
    BUS_IN_RING,
    BUS_MASTERS,
    BUS_CLEAR,
    BUS_VERDICT,
    SLAVES,
    BUS_PLANNED,
    *BUS_HISTOGRAMS.values(),
    *BUS_COUNTERS.values(),
    BUS_DAMAGED,
    BUS_COUNTERS_AGE,
    SLAVE_STATE,
    SLAVE_VERDICT,
    EXCHANGING,
    INPUTS_VALID,
    INPUTS_AGE,
    WATCHDOG,
    FAULT,
    DIAGNOSIS,
    CONDITIONS,
    *SLAVE_COUNTERS.values(),
    SLAVE_DAMAGED,
    VALUE,
    VALUE_QUALITY,
    VALUES_LEFT_OUT,
    CONNECTOR_UP,
    CONNECTOR_CONNECTED,
    CONNECTOR_DROPPED,
    REQUESTS,
    REFUSED,
    CPU,
    MEMORY,
    OPEN_FDS,
    MAX_FDS,
    START,
    BUILD,
)
