"""The plan of a bus before it is switched on: rotation times, watchdogs, T_TR, and values that do not fit together.

Findings of a plan (a value is out of bounds, why, and what to do) and notes (legal, but worth knowing).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

from msgspec import Struct

from dpstack.dp.plan.cycle_check import CyclePlan, Refusal, judge_cycle
from dpstack.dp.plan.rotation_time import ALONE, Case, Figures, OtherMasters, Rotation, rate_offsets
from dpstack.dp.services import planned_prm
from dpstack.dp.slave_params import SlaveParams
from dpstack.params import BusParams
from dpstack.units import NS_PER_MS, baud_text, ms_text


def plan_findings(figures: Figures, watchdogs: dict[int, int], data_control_ns: int) -> Iterable[str]:
    """The values out of bounds; ``watchdogs`` are the effective ones in ms by address, 0 is off."""
    params = figures.params
    at = baud_text(params.baud)
    yield from _t_tr(figures)
    for setup in figures.setups:
        worst = figures.spacing_ns * setup.every + figures.dying_ns
        watchdog = watchdogs[setup.address]
        # what is shorter than the cycle was refused already
        if watchdog and figures.cycle_ns * setup.every <= watchdog * NS_PER_MS < worst:
            yield (
                f"{setup.who}: its watchdog of {watchdog} ms is shorter than {_rounds(setup.every)} can take at {at} "
                f"({ms_text(worst)} with retries{_while_dying(figures.dying_ns)}): it would trip by itself; "
                f"take {_up(3 * worst)} ms or more, or a faster rate"
            )
        max_tsdr = setup.max_tsdr.get(params.baud, 0)
        if max_tsdr + 15 > params.t_sl:
            yield (
                f"{setup.who}: it may take T_SDR {max_tsdr} at {at}, t_sl = {params.t_sl} is too short for it; "
                f"leave t_sl out, or set it to {max_tsdr + 15} or more"
            )
        if setup.min_tsdr > params.min_tsdr and setup.min_tsdr > params.max_tsdr:
            yield f"{setup.who}: its min T_SDR {setup.min_tsdr} lies above max T_SDR {params.max_tsdr} of the bus"
    yield from _slow_publishers(figures, watchdogs)
    yield from _slow_for_auto_clear(figures, data_control_ns)


def _slow_publishers(figures: Figures, watchdogs: dict[int, int]) -> Iterable[str]:
    """Publishers that have their turn less often than the watchdog of a subscriber, its monitoring time, allows."""
    by_address = {setup.address: setup for setup in figures.setups}
    for setup in figures.setups:
        watchdog = watchdogs[setup.address]
        for address in sorted({link.publisher for link in setup.links} & by_address.keys()):
            publisher = by_address[address]
            turn = figures.spacing_ns * publisher.every
            if turn > watchdog * NS_PER_MS:
                yield (
                    f"{setup.who}: its watchdog of {watchdog} ms monitors its links, and {publisher.who} may have its "
                    f"turn only every {ms_text(turn)}: its link would be lost by itself; take {_up(3 * turn)} ms"
                )


def _t_tr(figures: Figures) -> Iterable[str]:
    needed, given = figures.t_tr_needed, figures.params.t_tr
    if given >= needed:
        return
    at, others = baud_text(figures.params.baud), figures.others.count
    beside = f" with {others} other master{'s' * (others > 1)}" if others else ""
    effect = "the others come in between, and its rotation can double" if others else "which costs a token each"
    yield (
        f"t_tr = {given} is too small: the longest normal round and one acyclic service of each master take "
        f"{figures.normal_with_services} bit times at {at}{beside}, and T_TH = T_TR - T_RR must leave time for a whole "
        f"hold after them, else a round takes several holds ({effect}); "
        f"leave t_tr out, or set it to {needed} or more{' on all masters' if others else ''}"
    )


def _slow_for_auto_clear(figures: Figures, data_control_ns: int) -> Iterable[str]:
    for setup in figures.setups:
        turn = figures.spacing_ns * setup.every
        if data_control_ns and not setup.ignore_auto_clear and turn > data_control_ns:
            yield (
                f"{setup.who}: {_rounds(setup.every)} can take {ms_text(turn)}, "
                f"longer than data_control_time_ms = {data_control_ns // NS_PER_MS}: auto_clear would clear by itself; "
                f"take {_up(3 * turn)} or more"
            )


def plan_notes(figures: Figures, watchdogs: dict[int, int]) -> Iterable[str]:
    for setup in figures.setups:
        watchdog = watchdogs[setup.address]
        if not watchdog:
            yield (
                f"{setup.who}: its watchdog is off; when the master stops without an ordered end it keeps its "
                f"last outputs"
            )
        elif setup.watchdog_ms not in (None, watchdog):
            yield (
                f"{setup.who}: its watchdog is {watchdog} ms instead of {setup.watchdog_ms} ms: Set_Prm has no two "
                f"factors that come nearer from above"
            )
        interval, turn = setup.min_slave_interval_ns, figures.work_ns(Case.SHORTEST) * setup.every
        if not figures.cycle_ns and interval > turn:
            shortest = "the shortest rotation" if setup.every == 1 else f"{setup.every} of the shortest rotations"
            yield (
                f"{setup.who}: its Min_Slave_Interval of {ms_text(interval)} is longer than {shortest} would be "
                f"({ms_text(turn)}): the rounds wait for it"
            )


def _while_dying(dying: int) -> str:
    return f", {ms_text(dying)} of it waiting for a slave that dies" if dying else ""


def _rounds(every: int) -> str:
    return "the longest rotation" if every == 1 else f"{every} of the longest rotations"


def _up(ns: int) -> int:
    """Milliseconds, up to the next 10."""
    return -(-ns // (10 * NS_PER_MS)) * 10


_CASES: Final = (Case.SHORTEST, Case.TYPICAL, Case.LONGEST)


class SlavePlan(Struct, frozen=True, kw_only=True):
    """One slave: its time in the shortest rotation, its watchdog, and the text ``on_loss`` for the end of its watchdog.

    With ``every`` n it has its turn in the rounds whose number leaves ``offset`` when divided by n. ``set_prm`` and
    ``chk_cfg`` are the octets that the master will send, in hex; ``....`` for an ident number from the diagnosis.
    """

    #: parameters that the master sends to the slave
    setup: SlaveParams
    #: time of the slave in the shortest rotation, in bit times
    shortest_bits: int
    #: its turn is in the rounds whose number leaves ``offset`` when divided by ``every``
    offset: int
    #: watchdog in ms, 0 is off
    watchdog_ms: int
    #: what the device does when its master falls silent, for people
    on_loss: str
    #: octets of Set_Prm in hex, ``....`` for an ident number that the diagnosis will give
    set_prm: str
    #: octets of Chk_Cfg in hex
    chk_cfg: str


class Plan(Struct, frozen=True, kw_only=True):
    """The plan of one bus at one rate. Rotations in bit times."""

    #: rotation times, hold times and the bus parameters behind them
    figures: Figures
    #: the plan of each slave, in the order of the addresses
    slaves: tuple[SlavePlan, ...]
    #: watchdog of slaves that do not set their own, in ms
    watchdog_ms: int
    #: values out of bounds, one line each with reason and remedy; empty if everything fits
    findings: tuple[str, ...]
    #: remarks about legal values, one line each
    notes: tuple[str, ...] = ()
    #: needs of other masters on the bus; empty without any
    beside: str = ""
    #: judgement of a fixed cycle; None if the bus runs free
    cycle: CyclePlan | None = None

    @property
    def params(self) -> BusParams:
        """bus parameters of the plan"""
        return self.figures.params

    @property
    def rotations(self) -> dict[Case, Rotation]:
        """rotation times in bit times, by case"""
        return self.figures.rotations

    @property
    def refusals(self) -> tuple[Refusal, ...]:
        """The reasons why the bus cannot be opened."""
        return self.cycle.refusals if self.cycle else ()

    def rotation_ns(self, case: Case) -> int:
        """A rotation in nanoseconds."""
        return self.figures.ns(case)

    def as_dict(self) -> dict[str, object]:
        """Plain JSON data in the shape of ``dpstack plan --json``."""
        p = self.params
        names = ("t_sl", "min_tsdr", "max_tsdr", "t_set", "t_qui", "t_tr", "gap", "hsa", "max_retry", "extra_idle")
        parameters: dict[str, int] = {name: getattr(p, name) for name in names}
        parameters |= {"t_id1": p.t_id1, "t_id2": p.t_id2, "t_to": p.t_to, "watchdog_ms": self.watchdog_ms}
        found: dict[str, object] = {
            "baud": p.baud,
            "address": p.address,
            "rotation_us": {case.value: round(self.rotation_ns(case) / 1000, 1) for case in _CASES},
            "acyclic_us": round(p.ns(self.figures.acyclic_bits) / 1000, 1),
            "rotation_bits": {case.value: self.rotations[case].bits for case in _CASES},
            "parameters": parameters,
            "masters": {"others": self.figures.others.count, "t_tr_needed": self.figures.t_tr_needed},
            "slaves": [_slave_dict(s) for s in self.slaves],
            "findings": list(self.findings),
            "notes": [*self.notes, *([self.beside] if self.beside else [])],
        }
        if self.cycle is not None:
            found["cycle"] = self.cycle.as_dict()
        return found


def _slave_dict(slave: SlavePlan) -> dict[str, object]:
    return {
        "address": slave.setup.address,
        "name": slave.setup.name,
        "inputs": slave.setup.input_len,
        "outputs": slave.setup.output_len,
        "bits": slave.shortest_bits,
        "every": slave.setup.every,
        "offset": slave.offset,
        "watchdog_ms": slave.watchdog_ms,
        "on_loss": slave.on_loss,
        "after_return": slave.setup.after_return,
        "set_prm": slave.set_prm,
        "chk_cfg": slave.chk_cfg,
        "slots": [slot.as_dict() for slot in slave.setup.slots.slots],
    }


def make_plan(
    params: BusParams,
    setups: Sequence[SlaveParams],
    *,
    others: OtherMasters = ALONE,
    cycle_ns: int = 0,
    pty: bool = False,
    host_slack_ns: int = 0,
    data_control_ns: int = 0,
    findings: Iterable[str] = (),
    notes: Iterable[str] = (),
    beside: str = "",
    watchdog_ms: int | None = None,
) -> Plan:
    """The whole plan of a bus with ``setups`` at ``params``; ``pty``: the port leads to another process.

    ``others`` are the other masters of the bus. ``cycle_ns`` is the fixed cycle, 0 for none.
    ``host_slack_ns``: greatest delay of a known station's answer after the deadline of the wire (see Patience).
    ``data_control_ns`` is the Data_Control_Time of a bus with auto-clear, else 0.
    ``findings``, ``notes`` and ``beside``: those of the caller; they come first.
    ``watchdog_ms`` is the default watchdog that a running bus uses; None: the recommended one.
    """
    counted = Figures(params, setups, others, cycle_ns, host_slack_ns)
    recommended = counted.watchdog_ms(pty=pty) if watchdog_ms is None else watchdog_ms
    slaves = _slave_plans(counted, recommended)
    watchdogs = {s.setup.address: s.watchdog_ms for s in slaves}
    cycle = judge_cycle(counted) if cycle_ns else None
    return Plan(
        figures=counted,
        slaves=slaves,
        watchdog_ms=recommended,
        findings=(
            *findings,
            *([refusal.text for refusal in cycle.refusals] if cycle else []),
            *(cycle.findings if cycle else ()),
            *plan_findings(counted, watchdogs, data_control_ns),
        ),
        notes=(*notes, *(cycle.notes if cycle else ()), *plan_notes(counted, watchdogs)),
        beside=beside,
        cycle=cycle,
    )


def _slave_plans(counted: Figures, recommended: int) -> tuple[SlavePlan, ...]:
    offsets = rate_offsets(counted.params, counted.setups)
    shortest = counted.rotations[Case.SHORTEST].slaves
    plans = []
    for setup in counted.setups:
        watchdog = setup.watchdog(recommended)
        effective = watchdog.ms if watchdog else 0
        plans.append(
            SlavePlan(
                setup=setup,
                shortest_bits=shortest[setup.address],
                offset=offsets[setup.address],
                watchdog_ms=effective,
                on_loss=_on_loss(setup, effective),
                set_prm=planned_prm(setup, watchdog),
                chk_cfg=setup.config.hex(),
            )
        )
    return tuple(plans)


def _on_loss(setup: SlaveParams, effective: int) -> str:
    if not effective:
        return "goes on with its last outputs: its watchdog is off"
    return f"after {effective} ms: {setup.on_loss or 'as its manual says (usually outputs off)'}"
