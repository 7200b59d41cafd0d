"""What a bus will do before it is switched on: rotation times, watchdogs, T_TR, and what does not fit together.

Everything is counted from the telegrams as the master really sends them. A master alone on the bus, all slaves in
data exchange: for each slave Data_Exchange, T_SDR, the answer, T_ID1; then the token to itself (33 bits) and T_ID1.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Final

from dpstack.dp.setup import SlaveSetup, watchdog_factors, watchdog_ns
from dpstack.params import BusParams
from dpstack.units import BITS_PER_CHAR, NS_PER_MS, baud_text

TOKEN_OCTETS: Final = 3
SD1_OCTETS: Final = 6
#: SD, LE, LEr, SD, DA, SA, FC, FCS, ED
SD2_FRAME: Final = 9
SC_OCTETS: Final = 1
SAPS: Final = 2
#: FDL status: SD1 both ways
GAP_REQUEST: Final = SD1_OCTETS
GLOBAL_CONTROL: Final = SD2_FRAME + SAPS + 2
#: Slave_Diag without data, and an answer with all 244 octets
DIAG_REQUEST: Final = SD2_FRAME + SAPS
LONGEST_TELEGRAM: Final = SD2_FRAME + 246

#: T_SDR of a usual slave ASIC, for the typical rotation
TYPICAL_TSDR: Final = 60
MIN_WATCHDOG_MS: Final = 200
MIN_WATCHDOG_PTY_MS: Final = 1000
MAX_WATCHDOG_MS: Final = 650_250
MAX_T_TR: Final = 16_777_960


class Case(Enum):
    """Which rotation is meant."""

    SHORTEST = "min"  # every T_SDR at its minimum, nothing but data exchange and token
    TYPICAL = "typical"  # T_SDR 60 bit times, one silent GAP poll when the GAP is on
    NORMAL = "normal"  # the longest without a retry: what T_TR must be enough for
    LONGEST = "max"  # with retries, one diagnosis, one acyclic service, Global_Control, GAP


@dataclass(frozen=True, slots=True)
class Rotation:
    """A rotation in bit times: the sum and what each slave takes of it (T_ID1 after its answer included)."""

    bits: int
    slaves: dict[int, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class SlavePlan:
    """One slave: octets each way, what it takes of the shortest rotation, its watchdog and what then happens."""

    setup: SlaveSetup
    request_octets: int
    answer_octets: int
    shortest_bits: int
    watchdog_ms: int
    on_loss: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """The plan of one bus at one rate. Rotations in bit times.

    ``findings``: one line each, what is out of bounds, why, and what to do; empty when everything fits. ``notes``:
    what is as it is, but worth knowing. ``beside``: what other masters on the bus would need, empty when it is nothing.
    """

    params: BusParams
    rotations: dict[Case, Rotation]
    slaves: tuple[SlavePlan, ...]
    watchdog_ms: int
    findings: tuple[str, ...]
    notes: tuple[str, ...] = ()
    beside: str = ""

    def rotation_ns(self, case: Case) -> int:
        """A rotation in nanoseconds."""
        return self.params.ns(self.rotations[case].bits)

    def as_dict(self) -> dict[str, object]:
        """Plain JSON data in the shape of ``dpstack plan --json``."""
        p = self.params
        names = ("t_sl", "min_tsdr", "max_tsdr", "t_set", "t_qui", "t_tr", "gap", "hsa", "max_retry", "extra_idle")
        parameters: dict[str, int] = {name: getattr(p, name) for name in names}
        parameters |= {"t_id1": p.t_id1, "t_id2": p.t_id2, "t_to": p.t_to, "watchdog_ms": self.watchdog_ms}
        cases = (Case.SHORTEST, Case.TYPICAL, Case.LONGEST)
        return {
            "baud": p.baud,
            "address": p.address,
            "rotation_us": {case.value: round(self.rotation_ns(case) / 1000, 1) for case in cases},
            "rotation_bits": {case.value: self.rotations[case].bits for case in cases},
            "parameters": parameters,
            "slaves": [_slave_dict(s) for s in self.slaves],
            "findings": list(self.findings),
            "notes": [*self.notes, *([self.beside] if self.beside else [])],
        }


def _slave_dict(slave: SlavePlan) -> dict[str, object]:
    return {
        "address": slave.setup.address,
        "name": slave.setup.name,
        "inputs": slave.setup.input_len,
        "outputs": slave.setup.output_len,
        "bits": slave.shortest_bits,
        "watchdog_ms": slave.watchdog_ms,
        "on_loss": slave.on_loss,
    }


def request_octets(setup: SlaveSetup) -> int:
    """Octets of Data_Exchange to ``setup``: SD1 when it has no outputs, else SD2 without SAPs."""
    return SD2_FRAME + setup.output_len if setup.output_len else SD1_OCTETS


def answer_octets(setup: SlaveSetup) -> int:
    """Octets of its answer: SC when it has no inputs, else SD2 without SAPs."""
    return SD2_FRAME + setup.input_len if setup.input_len else SC_OCTETS


def rotation(params: BusParams, setups: Sequence[SlaveSetup], case: Case) -> Rotation:
    """The bus rotation time of a master alone on the bus with every slave of ``setups`` in data exchange."""
    retries = params.max_retry if case is Case.LONGEST else 0
    shares = {
        s.address: _exchange(params, request_octets(s), answer_octets(s), _tsdr(params, s, case), retries)
        for s in setups
    }
    bits = sum(shares.values()) + _chars(TOKEN_OCTETS) + params.t_id1
    gap_poll = _chars(GAP_REQUEST) + max(params.t_sl, params.t_id1) if params.gap else 0
    if case is Case.TYPICAL:
        bits += gap_poll
    elif case in (Case.NORMAL, Case.LONGEST):
        diagnosis = _exchange(params, DIAG_REQUEST, LONGEST_TELEGRAM, params.max_tsdr, retries)
        bits += diagnosis + gap_poll + _chars(GLOBAL_CONTROL) + params.t_id2
        if case is Case.LONGEST:
            bits += _exchange(params, LONGEST_TELEGRAM, DIAG_REQUEST, params.max_tsdr, retries)
    return Rotation(_kept_apart(params, setups, bits), shares)


def _kept_apart(params: BusParams, setups: Sequence[SlaveSetup], bits: int) -> int:
    """Min_Slave_Interval: a round begins with the first token after the longest one; the token goes round till then."""
    interval = max((s.min_slave_interval_ns for s in setups), default=0)
    missing = interval - params.ns(bits)
    if missing <= 0:
        return bits
    hold = _chars(TOKEN_OCTETS) + params.t_id1
    return bits + -(-missing // params.ns(hold)) * hold


def _chars(octets: int) -> int:
    return octets * BITS_PER_CHAR


def _tsdr(params: BusParams, setup: SlaveSetup, case: Case) -> int:
    shortest = max(params.min_tsdr, setup.min_tsdr)
    if case is Case.SHORTEST:
        return shortest
    longest = params.max_tsdr if setup.max_tsdr is None else setup.max_tsdr
    if case is Case.TYPICAL:
        return max(shortest, min(TYPICAL_TSDR, longest))
    return max(shortest, longest)


def _exchange(params: BusParams, request: int, answer: int, tsdr: int, retries: int) -> int:
    """Request, T_SDR, answer, T_ID1; before it ``retries`` times the request with the whole slot time in vain."""
    vain = _chars(request) + max(params.t_sl, params.t_id1)
    return retries * vain + _chars(request) + tsdr + _chars(answer) + params.t_id1


def t_tr_preset(params: BusParams, setups: Sequence[SlaveSetup]) -> int:
    """T_TR in bit times for this configuration: the table's, or what the longest normal round takes if that is more."""
    return min(max(params.t_tr, rotation(params, setups, Case.NORMAL).bits), MAX_T_TR)


def watchdog_ms(params: BusParams, setups: Sequence[SlaveSetup], *, pty: bool = False, host_slack_ns: int = 0) -> int:
    """The recommended watchdog: three times the longest rotation, at least 200 ms (1000 ms on ptys), in 10 ms steps.

    While one slave dies the others wait for its slot time and the host's slack, with every retry: that is part of it.
    """
    dying = (params.max_retry + 1) * (params.ns(params.t_sl) + host_slack_ns) if host_slack_ns else 0
    longest = 3 * (params.ns(rotation(params, setups, Case.LONGEST).bits) + dying)
    steps = -(-longest // (10 * NS_PER_MS))
    least = MIN_WATCHDOG_PTY_MS if pty else MIN_WATCHDOG_MS
    return min(max(least, steps * 10), MAX_WATCHDOG_MS)


def make_plan(
    params: BusParams,
    setups: Iterable[SlaveSetup],
    *,
    pty: bool = False,
    host_slack_ns: int = 0,
    findings: Iterable[str] = (),
    notes: Iterable[str] = (),
    beside: str = "",
) -> Plan:
    """The whole plan of a bus with ``setups`` at ``params``; ``pty`` where another process stands at the other end.

    ``host_slack_ns`` is how much later than the wire's deadline a known station's answer may come (see Patience).
    ``findings``, ``notes`` and ``beside`` are what the caller knows beyond that; they come first.
    """
    slaves = tuple(sorted(setups, key=lambda s: s.address))
    rotations = {case: rotation(params, slaves, case) for case in Case}
    recommended = watchdog_ms(params, slaves, pty=pty, host_slack_ns=host_slack_ns)
    plans = tuple(_slave_plan(s, rotations[Case.SHORTEST], recommended) for s in slaves)
    return Plan(
        params=params,
        rotations=rotations,
        slaves=plans,
        watchdog_ms=recommended,
        findings=(*findings, *_findings(params, plans, rotations)),
        notes=(*notes, *_notes(params, plans)),
        beside=beside,
    )


def _slave_plan(setup: SlaveSetup, shortest: Rotation, recommended: int) -> SlavePlan:
    wanted = recommended if setup.watchdog_ms is None else setup.watchdog_ms
    effective = watchdog_ns(watchdog_factors(wanted)) // NS_PER_MS if wanted else 0
    return SlavePlan(
        setup=setup,
        request_octets=request_octets(setup),
        answer_octets=answer_octets(setup),
        shortest_bits=shortest.slaves[setup.address],
        watchdog_ms=effective,
        on_loss=_on_loss(setup, effective),
    )


def _on_loss(setup: SlaveSetup, effective: int) -> str:
    if not effective:
        return "goes on with its last outputs: its watchdog is off"
    return f"after {effective} ms: {setup.on_loss or 'as its manual says (usually outputs off)'}"


def _findings(params: BusParams, slaves: Sequence[SlavePlan], rotations: dict[Case, Rotation]) -> Iterable[str]:
    at = baud_text(params.baud)
    longest = params.ns(rotations[Case.LONGEST].bits)
    if params.t_tr < rotations[Case.NORMAL].bits:
        yield (
            f"t_tr = {params.t_tr} is too small: the longest normal round takes {rotations[Case.NORMAL].bits} "
            f"bit times at {at}; leave t_tr out, or set it to that or more"
        )
    for slave in slaves:
        setup = slave.setup
        who = f"slave {setup.address} ({setup.name})"
        every = setup.every
        if slave.watchdog_ms and slave.watchdog_ms * NS_PER_MS < longest * every:
            yield (
                f"{who}: its watchdog of {slave.watchdog_ms} ms is shorter than {_rounds(every)} can take at {at} "
                f"({_ms(longest * every)} with retries): it would trip by itself; "
                f"take {_up(3 * longest * every)} ms or more, or a faster rate"
            )
        if setup.max_tsdr is not None and setup.max_tsdr + 15 > params.t_sl:
            yield (
                f"{who}: it may take T_SDR {setup.max_tsdr} at {at}, t_sl = {params.t_sl} is too short for it; "
                f"leave t_sl out, or set it to {setup.max_tsdr + 15} or more"
            )
        if setup.min_tsdr > params.min_tsdr and setup.min_tsdr > params.max_tsdr:
            yield (f"{who}: its min T_SDR {setup.min_tsdr} lies above max T_SDR {params.max_tsdr} of the bus")


def _notes(params: BusParams, slaves: Sequence[SlavePlan]) -> Iterable[str]:
    octets_only = params.ns(sum(s.shortest_bits for s in slaves) + _chars(TOKEN_OCTETS) + params.t_id1)
    for slave in slaves:
        if not slave.watchdog_ms:
            yield (
                f"slave {slave.setup.address} ({slave.setup.name}): its watchdog is off; when the master stops "
                f"without an ordered end it keeps its last outputs"
            )
        interval = slave.setup.min_slave_interval_ns
        if interval > octets_only:
            yield (
                f"slave {slave.setup.address} ({slave.setup.name}): its Min_Slave_Interval of {_ms(interval)} is "
                f"longer than the shortest rotation would be ({_ms(octets_only)}): the rounds wait for it"
            )


def _rounds(every: int) -> str:
    return "the longest rotation" if every == 1 else f"{every} of the longest rotations"


def _ms(ns: int) -> str:
    return f"{ns / NS_PER_MS:.3g} ms" if ns < 100 * NS_PER_MS else f"{ns / NS_PER_MS:.0f} ms"


def _up(ns: int) -> int:
    """Milliseconds, up to the next 10."""
    return -(-ns // (10 * NS_PER_MS)) * 10
