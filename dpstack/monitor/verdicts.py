"""Verdicts on stations and on the bus: good, warning, critical or unknown, with reasons in a maintainer's words.

Each reason says what was found, against which neighbours or past, and what to look at. No verdict rests on a figure
that the source of the octets cannot time.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from dpstack.dp.pdu.diag_bits import Reaction
from dpstack.dp.pdu.diag_texts import conspicuous_text
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.pdu.requests import SET_PRM_LEN
from dpstack.errors import PduError
from dpstack.monitor.counters import Counters, Master, State, Station
from dpstack.monitor.devices import Devices, KnownDevice
from dpstack.monitor.evidence import finding
from dpstack.monitor.history import History, Past
from dpstack.monitor.thresholds import Thresholds
from dpstack.monitor.timing import Timing
from dpstack.monitor.verdict import CRITICAL, GOOD, UNKNOWN, VERDICTS, WARNING, Finding, Verdict, verdict_of
from dpstack.params import DPV1_STATUS_LEN
from dpstack.text import times_text
from dpstack.units import NS_PER_S, baud_text, bits_to_ns, ns_to_bits

if TYPE_CHECKING:
    from dpstack.dp.pdu.dxb import LinkState
    from dpstack.monitor.clock import SentTime

_LINE: Final = "its connector, its stub and the segment's end"
_SEGMENT: Final = "the termination at both ends and its supply, the cable, its shield, and what switches at that time"


@dataclass(frozen=True, slots=True)
class Heard:
    """All that a verdict is made of. ``seconds``: listened so far; ``silent_s``: without octets at the end."""

    counters: Counters
    history: History
    devices: Devices
    timing: Timing
    thresholds: Thresholds
    seconds: float
    silent_s: float
    now_ns: int
    #: tokens and answers that fit requests have shown that this is PROFIBUS
    is_profibus: bool

    def is_user(self, station: Station) -> bool:
        """Whether a master uses the station, or it was heard: not an address that only GAP polls ask."""
        return station.is_present or self.counters.is_used(station.address)


def judge(heard: Heard) -> tuple[Verdict, dict[int, Verdict]]:
    """The verdict on the bus, and on each station that was heard or is used, by address. Unknown if there is no
    evidence that this is PROFIBUS: stations of other protocols are not judged by its rules."""
    counters = heard.counters
    used = [station for _, station in sorted(counters.stations.items()) if heard.is_user(station)]
    if not heard.is_profibus:  # of what another protocol means, nothing here is a finding
        unknown = Verdict(UNKNOWN, (_bus_doubt(heard),))
        return unknown, {station.address: unknown for station in used}
    stations = {one.address: _verdict(list(_findings(one, used, heard)), _doubt(one, heard)) for one in used}
    found = list(_of_bus(used, heard))
    levels = {verdict.level for verdict in stations.values()}
    for address, verdict in stations.items():
        if verdict.level in (WARNING, CRITICAL):
            role = "master" if address in counters.masters else "station"
            found.append((verdict.level, f"{role} {address}: {verdict.reasons[0]}"))
    doubt = _bus_doubt(heard)
    if not doubt and levels <= {UNKNOWN} and not counters.masters:
        doubt = "no station could be judged"
    return _verdict(found, doubt), stations


def _verdict(found: list[Finding], doubt: str) -> Verdict:
    """As :func:`verdict_of`; a doubt stands behind the findings, too."""
    verdict = verdict_of(found, doubt)
    return Verdict(verdict.level, (*verdict.reasons, doubt)) if found and doubt else verdict


# --- too little heard ---
def _bus_doubt(heard: Heard) -> str:
    counters, limits = heard.counters, heard.thresholds
    if not counters.telegrams:
        noise = sum(counters.damaged.values())
        if noise:
            return f"{noise} transmissions, none of them a telegram: another rate, A and B exchanged, or no PROFIBUS"
        return "nothing was heard: look at power, cable, A and B, the rate, and whether a master runs"
    if not heard.is_profibus:
        return f"{counters.telegrams} {finding(counters).text}"
    if heard.silent_s >= limits.silence_s:
        return f"silent since {heard.silent_s:.1f} s: no master sends any more"
    if round(heard.seconds, 1) < limits.min_seconds:  # as it is printed
        return f"too little was heard: {heard.seconds:.1f} s, {limits.min_seconds:g} s are needed"
    return ""


def _doubt(station: Station, heard: Heard) -> str:
    doubt = _bus_doubt(heard)
    if doubt or station.is_master:
        return doubt
    if station.state == State.UNKNOWN or (station.master is None and station.state == State.DIAGNOSIS):
        return "no master exchanges data with it"
    if station.requests < heard.thresholds.min_requests:
        return f"too little was heard: {station.requests} requests, {heard.thresholds.min_requests:g} are needed"
    return ""


# --- one station ---
def _findings(station: Station, used: list[Station], heard: Heard) -> Iterator[Finding]:
    past = heard.history.of(station.address)
    device = heard.devices.find(station.address, station.ident)
    master = heard.counters.masters.get(station.address)
    if master is not None:
        yield from _of_master(master, heard)
    else:
        yield from _state(station, past, heard)
    yield from _lost(station, heard)
    yield from _retries(station, past, used, heard)
    yield from _answers(station, heard)
    yield from _diagnosis(station, device)
    yield from _links(station)
    yield from _tsdr(station, past, device, heard)


def _of_clock(clock: SentTime) -> Iterator[Finding]:
    value = clock.value
    if value is not None and not value.synchronised:
        from dpstack.dp.pdu.clock import NOT_KEPT  # as below

        yield WARNING, f"sends the time, but {NOT_KEPT}"
    if clock.jumps:
        yield (
            WARNING,
            f"its time jumped {times_text(clock.jumps)}, the last time by {clock.jump_ns / NS_PER_S:+.3f} s, and its "
            "devices jumped with it: look at the clock of that master and at its time server",
        )
    if clock.damaged:
        yield (
            WARNING,
            f"sends {_many(clock.damaged, 'Clock_Value')} without a Time_Event before it or of a wrong length",
        )


def _of_master(master: Master, heard: Heard) -> Iterator[Finding]:
    limits = heard.thresholds
    # the silence of the whole bus is no drop-out of one master
    drops = master.drops - (master.is_silent and heard.silent_s >= limits.silence_s)
    level = _level(drops, limits.drops_warning, limits.drops_critical)
    if level:
        yield (
            level,
            f"dropped out of the token ring {times_text(drops)}: look at its connector, its load, and its bus "
            "parameters (T_SL, T_TR, HSA the same in all masters)",
        )
    if master.is_silent and heard.silent_s < limits.silence_s:
        yield (
            CRITICAL if master.slaves else WARNING,
            "sends nothing any more, while others do: look whether it was switched off, else at its connector",
        )
    if master.clock is not None:
        yield from _of_clock(master.clock)
    if master.mode == "clear" and master.slaves:
        yield WARNING, "is in Clear, the outputs of its slaves are zero: look at its mode switch and its slaves"


def _state(station: Station, past: Past, heard: Heard) -> Iterator[Finding]:
    if station.state in (State.UNKNOWN, State.DATA_EXCHANGE):
        if not station.is_present and station.requests:
            yield CRITICAL, "is asked and never answers: look at its power, its address switch and its connector"
        return
    since_ns = heard.now_ns if past.state != station.state else past.state_since
    if station.master is None and station.state == State.DIAGNOSIS:
        return  # nobody has parameterised it
    if (heard.now_ns - since_ns) / NS_PER_S < heard.thresholds.bring_up_s:
        return
    if station.state == State.OFFLINE:
        yield CRITICAL, "does not answer any more: look at its power, its connector and the cable to it"
        return
    diagnosis = None if station.diagnosis is None else Diagnosis.parse(station.diagnosis)
    refused = [] if diagnosis is None else [flag for flag in diagnosis.findings if flag.bring_up is Reaction.REFUSES]
    why = "; ".join(f"{flag.name}, it {flag.text}: {flag.remedy}" for flag in refused)
    yield (
        CRITICAL,
        f"is not in data exchange, its master brings it up again and again (now {station.state}): "
        f"{why or 'look at its parameters and its configuration in the master'}",
    )


def _lost(station: Station, heard: Heard) -> Iterator[Finding]:
    level = _level(station.lost, heard.thresholds.lost_warning, heard.thresholds.lost_critical)
    if level:
        back = "is back" if station.state == State.DATA_EXCHANGE else "is not back"
        yield (
            level,
            f"left data exchange {times_text(station.lost)}, {back}: look at its supply and its connector, "
            "and whether its master was stopped then",
        )


def _retries(station: Station, past: Past, used: list[Station], heard: Heard) -> Iterator[Finding]:
    limits = heard.thresholds
    deep = sum(station.retry_depth[1:])
    share = _retried(station)
    enough = station.requests >= limits.min_requests
    level = _level(share, limits.retries_warning, limits.retries_critical) if enough else ""
    if not level and deep >= limits.deep_retries_warning:
        level = WARNING
    if not level:
        return
    others = [_retried(one) for one in used if one is not station and one.requests >= limits.min_requests]
    several = past.failing_seconds and past.at_once >= past.failing_seconds / 2
    alone = bool(others) and not several and share >= limits.neighbours * max(others)
    text = f"{_percent(share)} of its requests needed a retry"
    if others:
        most = max(others)
        text += ", its neighbours none" if not most else f", its neighbours {_percent(most)} at most"
    if deep:
        text += f"; {deep} of them needed two or more"
    kind = "damaged" if station.damaged > station.no_answer else "missing"
    kind = "damaged or missing" if station.damaged and station.no_answer else kind
    when = "in bursts" if past.in_bursts(limits.bursts) else "spread over the time"
    if several:
        look = f"together with other stations: look at {_SEGMENT}"
    elif alone or not others:
        look = f"look at {_LINE}"
    else:
        look = f"look at {_LINE}, then at {_SEGMENT}"
    yield level, f"{text}: answers {kind} {when}{', ' if several else ': '}{look}"


def _answers(station: Station, heard: Heard) -> Iterator[Finding]:
    limits = heard.thresholds
    if station.requests < limits.min_requests:
        return
    if station.late and station.late / station.requests >= limits.late_warning:
        yield (
            WARNING,
            f"{_many(station.late, 'answer')} came after the master had given up: look at T_SL against MaxTsdr "
            "of the device, and at repeaters or converters on the way",
        )
    rr = 0 if station.is_cpu else station.rr  # RR of a CPU means that its answer is not ready yet
    refused = station.rs + rr
    if refused and refused / station.requests >= limits.refusals_warning:
        yield (
            WARNING,
            f"refused {refused} requests (RS {station.rs}: service not active; RR {rr}: not ready): look "
            "at the device's own fault display, and whether its master asks more than its GSD file allows",
        )


def _diagnosis(station: Station, device: KnownDevice) -> Iterator[Finding]:
    if station.diagnosis is None or station.state != State.DATA_EXCHANGE:
        return
    diagnosis = Diagnosis.parse(station.diagnosis)
    if diagnosis is None:
        return
    text = conspicuous_text(diagnosis, device.texts, dpv1=_has_messages(station, device), exchanging=True)
    if text:
        yield WARNING, f"reports a diagnosis: {text}: look at the device and what is connected to it"


def _has_messages(station: Station, device: KnownDevice) -> bool:
    """Whether its diagnosis may have alarms and status messages: by the facts about the device, else by DPV1_Enable in
    its last Set_Prm."""
    user = b"" if station.set_prm is None else station.set_prm[SET_PRM_LEN:]
    if device.dpv1 is not None or len(user) < DPV1_STATUS_LEN:
        return device.dpv1 is True
    from dpstack.dp.pdu.dpv1_status import DPV1_ENABLE  # here, as many plants have no DP-V1

    return bool(user[0] & DPV1_ENABLE)


def _links(station: Station) -> Iterator[Finding]:
    """Links of a subscriber without valid data."""
    for one in links_heard(station) if station.state == State.DATA_EXCHANGE else ():
        if not one.status:
            yield (
                WARNING,
                f"has no valid data from publisher {one.publisher} ({one.words}): look at station {one.publisher}, and "
                "whether it is in data exchange",
            )


def links_heard(station: Station) -> Iterator[LinkState]:
    """The links of its last link status message (data exchange broadcast)."""
    diagnosis = None if station.link_status is None else Diagnosis.parse(station.link_status)
    if diagnosis is None:
        return
    from dpstack.dp.pdu.alarm_blocks import Status, parse_block  # here, as few plants have it

    for block in diagnosis.blocks:
        with contextlib.suppress(PduError):
            message = parse_block(block.octets)
            yield from message.links if isinstance(message, Status) else ()


def _tsdr(station: Station, past: Past, device: KnownDevice, heard: Heard) -> Iterator[Finding]:
    """T_SDR against MaxTsdr of the GSD file, T_SL, the station's own past; nothing if the source cannot time it."""
    limits, baud = heard.thresholds, heard.counters.baud
    durations = station.answer_ns
    if not baud or durations.count < limits.min_requests or heard.timing.neighbours(durations) is None:
        return
    p99, most = durations.quantile_ns(0.99), durations.max_ns
    allowed = device.max_tsdr.get(baud)
    if allowed and heard.timing.resolves(p99) and p99 > limits.tsdr_of_max * bits_to_ns(allowed, baud):
        yield (
            WARNING,
            f"answers after {ns_to_bits(p99, baud)} bit times (p99), its GSD file allows {allowed} at "
            f"{baud_text(baud)}: look at repeaters and converters on the way, and at the device's firmware",
        )
    t_sl = heard.devices.t_sl.get(baud)
    if t_sl and heard.timing.resolves(most) and most > limits.tsdr_of_t_sl * bits_to_ns(t_sl, baud):
        yield (
            WARNING,
            f"answers after {ns_to_bits(most, baud)} bit times at most, the master waits T_SL = {t_sl}: look at "
            "T_SL in the master, and at repeaters and converters on the way",
        )
    first, last = past.first_tsdr, past.last_tsdr
    if first and last and heard.timing.resolves(min(first, last)) and last > limits.tsdr_of_past * first:
        yield (
            WARNING,
            f"answers after {ns_to_bits(last, baud)} bit times, in its first minute {ns_to_bits(first, baud)}: "
            "look at the load of the device",
        )


# --- the bus ---
def _of_bus(used: list[Station], heard: Heard) -> Iterator[Finding]:
    counters, limits = heard.counters, heard.thresholds
    damaged = sum(counters.damaged.values())
    whole = counters.telegrams + damaged
    level = _level(damaged / whole, limits.damaged_warning, limits.damaged_critical) if whole else ""
    if level:
        causes = ", ".join(f"{count} {cause}" for cause, count in sorted(counters.damaged.items()))
        yield level, f"{_percent(damaged / whole)} of all transmissions are damaged ({causes}): look at {_SEGMENT}"
    clocks = [f"master {address}" for address, one in sorted(counters.masters.items()) if one.clock is not None]
    if len(clocks) > 1:
        from dpstack.dp.pdu.clock import several_clocks  # here, as most buses have no clock

        yield WARNING, several_clocks(clocks)
    many = {count: seconds for count, seconds in heard.history.at_once.items() if count >= limits.many_stations}
    if many:
        yield (
            WARNING,
            f"{max(many)} stations failed in the same second, {times_text(sum(many.values()))}: look at {_SEGMENT}",
        )


def _retried(station: Station) -> float:
    """The share of exchanges that needed a repetition, 0..1."""
    exchanges = station.requests - station.repetitions
    return sum(station.retry_depth) / exchanges if exchanges > 0 else 0.0


def _level(value: float, warning: float, critical: float) -> str:
    """The level of ``value``; "" if it is in order, and for 0."""
    if not value:
        return ""
    return CRITICAL if value >= critical else WARNING if value >= warning else ""


def _many(count: int, noun: str) -> str:
    return f"{count} {noun}{'s' * (count != 1)}"


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %"


def worst(levels: Iterable[str]) -> str:
    """The most serious of ``levels``; good without any."""
    return max(levels, key=VERDICTS.index, default=GOOD)
