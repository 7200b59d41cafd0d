"""The summary of a monitored bus as plain data: the last JSON line of ``dpstack monitor``, and the report's figures."""

from __future__ import annotations

import contextlib
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Final

from dpstack.dp.pdu.diag_texts import block_texts
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.pdu.requests import SET_PRM_LEN
from dpstack.errors import PduError
from dpstack.monitor import not_heard
from dpstack.monitor.counters import Master, State, Station
from dpstack.monitor.devices import KnownDevice
from dpstack.monitor.thresholds import limits
from dpstack.monitor.verdict import Verdict
from dpstack.monitor.verdicts import Heard, judge, links_heard
from dpstack.params import DPV1_STATUS_LEN
from dpstack.units import NS_PER_MS, NS_PER_S

if TYPE_CHECKING:
    from dpstack.monitor.clock import SentTime

#: 1980-01-01: no clock of a capture is older
_CLOCK_NS: Final = 315_532_800 * NS_PER_S
#: what no listener at the octets can see, for people
UNSEEN: Final = (
    "voltage levels, edges and reflections (an oscilloscope shows them)",
    "the topology: cable lengths, stubs, terminators, the order of the stations",
    "which station damaged an octet: a damaged answer counts for the station that was asked",
)


def summary(heard: Heard) -> dict[str, object]:
    """The summary with all verdicts; numbers that the source cannot time are None."""
    counters = heard.counters
    bus, stations = judge(heard)
    seconds = heard.seconds
    return {
        "event": "summary",
        "time": time_text(heard.now_ns),
        "baud": counters.baud or None,
        "seconds": round(seconds, 3),
        "telegrams": counters.telegrams,
        "telegrams_per_s": round(counters.telegrams / seconds, 1) if seconds else 0.0,
        "load": round(min(1.0, counters.busy_ns / NS_PER_S / seconds), 4) if seconds else 0.0,
        "damaged": dict(sorted(counters.damaged.items())),
        "unattributed": counters.unattributed,
        "strays": counters.strays,
        "timing": heard.timing.as_dict(),
        "profibus": heard.is_profibus,
        "masters": {str(address): _master(one, heard) for address, one in sorted(counters.masters.items())},
        "stations": {
            str(address): _station(counters.stations[address], verdict, heard) for address, verdict in stations.items()
        },
        "thresholds": {limit.name: getattr(heard.thresholds, limit.name) for limit in limits()},
        "not_heard": not_heard.lines_of(heard),
        "verdict": bus.level,
        "reasons": list(bus.reasons),
    }


def time_text(ns: int) -> str | None:
    """``ns`` since 1970 as JSON lines have it, in ms; None for times before 1980, which count from the begin of a
    waveform, and for those that no calendar has."""
    if ns < _CLOCK_NS:
        return None
    millis = ns // NS_PER_MS
    try:
        time = datetime.fromtimestamp(millis // 1000, UTC).replace(microsecond=millis % 1000 * 1000)
    except (ValueError, OverflowError, OSError):  # a file may claim any time
        return None
    return time.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _master(master: Master, heard: Heard) -> dict[str, object]:
    timing = heard.timing
    return {
        "mode": master.mode,
        "token_us": timing.rotations(master.token_ns),
        "rotation_us": timing.rotations(master.rotation_ns),
        "hold_us": timing.neighbours(master.hold_ns),
        "gap_polls": master.gap_polls,
        "drops": master.drops,
        "in_ring": master.in_ring,
        "silent": master.is_silent,
        "slaves": sorted(master.slaves),
        "clock": None if master.clock is None else _clock(master.clock, heard),
    }


def _clock(clock: SentTime, heard: Heard) -> dict[str, object]:
    value = clock.value
    return {
        "values": clock.values,
        "damaged": clock.damaged,
        "interval_us": heard.timing.rotations(clock.interval_ns),
        "jitter_us": heard.timing.rotations(clock.jitter_ns),
        "jumps": clock.jumps,
        "jump_s": round(clock.jump_ns / NS_PER_S, 3) if clock.jumps else None,
        "time": None if value is None else time_text(value.time_ns),
        "resolution_ms": None if value is None else value.resolution_ms,
        "synchronised": None if value is None else value.synchronised,
    }


def _station(station: Station, verdict: Verdict, heard: Heard) -> dict[str, object]:
    device = heard.devices.find(station.address, station.ident)
    return {
        "role": "master" if station.is_master else "cpu" if station.is_cpu else "slave",
        "name": device.name or None,
        "ident": None if station.ident is None else f"0x{station.ident:04X}",
        "model": device.model or ("S7-200" if station.is_cpu else None),
        "state": station.state,
        "master": station.master,
        # the one whose answer may still come is counted with its end
        "requests": station.requests - (heard.counters.asked is station),
        "answers": station.answers,
        "damaged": station.damaged,
        "no_answer": station.no_answer,
        "repetitions": station.repetitions,
        "retry_depth": _without_zeros(station.retry_depth),
        "repeated_polls": station.repeated_polls,
        "late": station.late,
        "rs": station.rs,
        "rr": station.rr,
        "diagnoses": station.diagnoses,
        "diagnosis": None if station.diagnosis is None else station.diagnosis.hex(),
        "diagnosis_texts": _diagnosis_texts(station, device),
        **_broadcast(station),
        "syncs": station.syncs,
        "lost": station.lost,
        "max_tsdr": device.max_tsdr.get(heard.counters.baud),
        "tsdr_us": heard.timing.neighbours(station.answer_ns),
        "not_heard": not_heard.of_station(station, heard) if heard.is_profibus else [],
        "verdict": verdict.level,
        "reasons": list(verdict.reasons),
    }


def _diagnosis_texts(station: Station, device: KnownDevice) -> list[str] | None:
    """Everything that the last diagnosis reports, one line each; None if none was heard."""
    diagnosis = None if station.diagnosis is None else Diagnosis.parse(station.diagnosis)
    if diagnosis is None:
        return None
    texts = block_texts(diagnosis, device.texts, dpv1=device.dpv1 is not False)
    flags = diagnosis.conspicuous(exchanging=station.state == State.DATA_EXCHANGE)
    return [*(flag.text for flag in flags if not (texts and flag.name == "ext_diag")), *texts]


def _broadcast(station: Station) -> dict[str, object]:
    """Data exchange broadcast: Publisher_Enable and the links in the last Set_Prm, each with its state in the last link
    status message (None: none was heard). Empty for other stations."""
    user = b"" if station.set_prm is None else station.set_prm[SET_PRM_LEN:]
    if len(user) < DPV1_STATUS_LEN:
        return {}
    from dpstack.dp.pdu.dpv1_status import DPV1_ENABLE, PRM_STRUCTURE, PUBLISHER_ENABLE  # here, as the next

    if not user[0] & DPV1_ENABLE:
        return {}
    found: dict[str, object] = {"publisher": True} if user[0] & PUBLISHER_ENABLE else {}
    if user[2] & PRM_STRUCTURE:
        from dpstack.dp.pdu.dxb import links_of  # here, as few plants have it
        from dpstack.dp.pdu.prm_blocks import parse_blocks

        with contextlib.suppress(PduError):
            states = _link_states(station)
            found["links"] = [
                {"publisher": link.publisher, "text": link.text, **states.get(link.publisher, _NO_STATE)}
                for link in links_of(parse_blocks(user[DPV1_STATUS_LEN:]))
            ]
    return {key: value for key, value in found.items() if value}


#: of a link whose state was not heard
_NO_STATE: Final = {"good": None, "state": None}


def _link_states(station: Station) -> dict[int, dict[str, object]]:
    """``good`` and ``state`` of the links, by publisher; of a station that has left data exchange nothing is good."""
    here = station.state == State.DATA_EXCHANGE
    states: dict[int, dict[str, object]] = {}
    for one in links_heard(station):
        text = one.words if here else f"{one.words}; it is not in data exchange now"
        states[one.publisher] = {"good": one.status if here else None, "state": text}
    return states


def _without_zeros(depth: list[int]) -> list[int]:
    """The depths up to the last one that occurred, at least two."""
    size = max((place for place, count in enumerate(depth, 1) if count), default=0)
    return depth[: max(2, size)]
