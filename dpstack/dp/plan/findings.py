"""Findings of a plan (a value is out of bounds, why, and what to do) and notes (legal, but worth knowing)."""

from __future__ import annotations

from collections.abc import Iterable

from dpstack.dp.plan.rotation_time import Case, Figures
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
    yield from _slow_for_auto_clear(figures, data_control_ns)


def _t_tr(figures: Figures) -> Iterable[str]:
    needed, given = figures.t_tr_needed, figures.params.t_tr
    if given >= needed:
        return
    at, normal, others = baud_text(figures.params.baud), figures.rotations[Case.NORMAL], figures.others.count
    beside = f" with {others} other master{'s' * (others > 1)}" if others else ""
    effect = "the others come in between, and its rotation can double" if others else "which costs a token each"
    yield (
        f"t_tr = {given} is too small: the longest normal round takes {normal.work} bit times at {at}{beside}, and "
        f"T_TH = T_TR - T_RR must leave time for a whole hold after it, else a round takes several holds ({effect}); "
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
