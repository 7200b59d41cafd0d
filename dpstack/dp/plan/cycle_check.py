"""Check of a fixed cycle against the plan: refusals, misses and their frequency, the baud rate that it needs.

A cycle is possible if the shortest rotation fits into it. Diagnoses, services and GAP polls wait for a cycle with time
to spare. One that never fits is sent after eight rounds and costs whole cycles
(:mod:`dpstack.fdl.active.cycle_window`), so that the part of the cycles that all of them cost has a bound.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from msgspec import Struct

from dpstack.dp.plan.rotation_time import Case, Figures, longest_diagnosis
from dpstack.dp.slave_params import SlaveParams
from dpstack.dp.telegram_times import gap_poll_bits, global_control_bits, request_octets, vain_bits
from dpstack.fdl.events import HELD_BACK_CYCLES
from dpstack.text import TextEnum
from dpstack.units import NS_PER_MS, NS_PER_US, baud_text, ms_text


class CycleVerdict(TextEnum):
    """Judgement of a cycle, worst first."""

    #: shorter than the shortest rotation: refused
    IMPOSSIBLE = "impossible", "impossible, the shortest rotation does not fit"
    #: shorter than the typical one: missed unless the slaves are fast
    POSSIBLE = "possible", "missed, the typical rotation does not fit"
    #: missed now and then on an undisturbed bus
    TYPICAL = "typical", "tight, missed now and then"
    #: missed after repetitions only
    UNDISTURBED = "undisturbed", "kept while nothing is repeated"
    #: kept in the longest rotation too
    ALWAYS = "always", "kept, the longest rotation fits"


class Refusal(Struct, frozen=True):
    """A reason why a bus cannot run like this, and what to do. ``slave``: the address concerned, None: the bus."""

    what: str
    todo: str
    slave: int | None = None

    @property
    def text(self) -> str:
        return f"{self.what}; {self.todo}"


class CyclePlan(Struct, frozen=True):
    """The judgement of one cycle."""

    #: the fixed cycle in ns
    cycle_ns: int
    #: how safely the rotation fits into the cycle
    verdict: CycleVerdict
    #: part of the cycle that the typical rotation takes
    load: float
    #: reasons why the bus cannot be opened with this cycle
    refusals: tuple[Refusal, ...]
    #: further findings, one line each
    findings: tuple[str, ...]
    #: remarks, one line each
    notes: tuple[str, ...]

    def as_dict(self) -> dict[str, object]:
        return {
            "cycle_ms": self.cycle_ns / NS_PER_MS,
            "verdict": self.verdict.value,
            "load_percent": round(100 * self.load, 1),
        }


def least_ns(figures: Figures) -> dict[CycleVerdict, int]:
    """The shortest cycle for each verdict in ns, best first.

    Undisturbed: all slaves need their max T_SDR, and the longest other service fits into the rest.
    """
    params, normal = figures.params, figures.rotations[Case.NORMAL]
    beside = max(
        longest_diagnosis(params, figures.setups),
        figures.acyclic_bits,
        global_control_bits(params),
        gap_poll_bits(params),
    )
    return {
        CycleVerdict.ALWAYS: figures.work_ns(Case.LONGEST),
        CycleVerdict.UNDISTURBED: params.ns(normal.work - normal.beside + beside),
        CycleVerdict.TYPICAL: figures.work_ns(Case.TYPICAL),
        CycleVerdict.POSSIBLE: figures.work_ns(Case.SHORTEST),
    }


def slowest_rates(at_rates: Iterable[Figures], cycle_ns: int) -> dict[CycleVerdict, int | None]:
    """The slowest baud rate at which ``cycle_ns`` is judged so or better, None without one.

    ``at_rates``: the bus at each rate that all its slaves know, from slow to fast.
    """
    found: dict[CycleVerdict, int | None] = dict.fromkeys(list(CycleVerdict)[1:])
    for figures in at_rates:
        for verdict, least in least_ns(figures).items():
            if found[verdict] is None and least <= cycle_ns:
                found[verdict] = figures.params.baud
    return found


def judge_cycle(figures: Figures) -> CyclePlan:
    """Judge the cycle of ``figures``, which has one."""
    cycle = figures.cycle_ns
    fits = (verdict for verdict, least in least_ns(figures).items() if least <= cycle)
    verdict = next(fits, CycleVerdict.IMPOSSIBLE)
    return CyclePlan(
        cycle_ns=cycle,
        verdict=verdict,
        load=figures.work_ns(Case.TYPICAL) / cycle,
        refusals=tuple(_refusals(figures)),
        findings=(_missed(figures, verdict),) if verdict in (CycleVerdict.POSSIBLE, CycleVerdict.TYPICAL) else (),
        notes=tuple(_notes(figures, verdict)),
    )


def token_wait_ns(figures: Figures) -> int:
    """The longest delay of a cycle while the other masters have the token, each for its longest normal round; 0 without
    other masters.
    """
    normal = figures.rotations[Case.NORMAL]
    return figures.params.ns(normal.others + normal.token) if figures.others.count else 0


def cycles_for_a_request(figures: Figures) -> int:
    """The cycles that one request between two cycles costs at most when nothing is repeated, 0 if it always fits.

    Sent at most once in HELD_BACK_CYCLES rounds: so many of HELD_BACK_CYCLES more cycles are left out or begin late.
    """
    cycle = figures.cycle_ns
    spare = max(0, cycle - figures.data_ns(Case.TYPICAL))
    longest = max(takes for _, takes in _beside(figures))
    return max(0, -(-(longest - spare) // cycle))


def _notes(figures: Figures, verdict: CycleVerdict) -> Iterable[str]:
    if verdict is CycleVerdict.UNDISTURBED:
        yield _missed(figures, verdict)
    if verdict in (CycleVerdict.POSSIBLE, CycleVerdict.TYPICAL) and (costs := cycles_for_a_request(figures)):
        turn = HELD_BACK_CYCLES + costs
        yield (
            f"cycle_ms = {figures.cycle_ns / NS_PER_MS:g}: a request that fits between no two cycles goes out after "
            f"every {HELD_BACK_CYCLES}th round at most; such requests cost at most {costs} of {turn} cycles "
            f"({costs / turn:.0%}), and requests that fit into the time of a cycle that is left out go out in it"
        )
    wait = token_wait_ns(figures)
    if wait and verdict is not CycleVerdict.IMPOSSIBLE:
        from dpstack.dp.master.fixed_cycle import tolerance_ns  # here, as few buses have a cycle beside other masters

        cycle, others = figures.cycle_ns, figures.others.count
        whom = "the other master has its normal round" if others == 1 else f"{others} other masters have their rounds"
        missed = "; more than a tenth of it counts as missed, by token" if wait > tolerance_ns(cycle) else ""
        yield (
            f"cycle_ms = {cycle / NS_PER_MS:g}: a cycle begins when the token is there, up to {ms_text(wait)} late "
            f"while {whom}{missed}"
        )


def _refusals(figures: Figures) -> Iterable[Refusal]:
    cycle, shortest = figures.cycle_ns, figures.rotations[Case.SHORTEST]
    least = figures.work_ns(Case.SHORTEST)
    if least > cycle:
        yield _too_short(figures, least, [s for s in figures.setups if s.address in shortest.together])
    for setup in figures.setups:
        turn = cycle * setup.every
        who = setup.who
        if setup.min_slave_interval_ns > turn:
            interval = setup.min_slave_interval_ns
            yield Refusal(
                f"{who}: its Min_Slave_Interval of {ms_text(interval)} is longer than {_turn(cycle, setup)}",
                f"give it every = {-(-interval // cycle)}, or take cycle_ms = {_least(-(-interval // setup.every))}",
                setup.address,
            )
        watchdog = setup.watchdog(0)
        if watchdog is not None and watchdog.ns < turn:
            yield Refusal(
                f"{who}: its watchdog of {watchdog.ms} ms is shorter than {_turn(cycle, setup)}: it would always trip",
                f"take watchdog_ms = {-(-3 * turn // (10 * NS_PER_MS)) * 10} or more",
                setup.address,
            )


def _too_short(figures: Figures, least: int, together: Sequence[SlaveParams]) -> Refusal:
    at, cycle, others = baud_text(figures.params.baud), figures.cycle_ns / NS_PER_MS, figures.others.count
    beside = f" and {others} other master{'s' * (others > 1)}" if others else ""
    slaves = f"{len(together)} slave{'s' * (len(together) != 1)}"
    if len(together) < len(figures.setups):
        names = ", ".join(str(s.address) for s in together)
        what = (
            f"the rate groups do not fit into cycle_ms = {cycle:g}: the fullest cycle has {slaves} ({names}){beside} "
            f"and takes {_least(least)} ms at least at {at}"
        )
    else:
        what = (
            f"cycle_ms = {cycle:g} is shorter than possible: the shortest rotation with {slaves}{beside} takes "
            f"{_least(least)} ms at {at}"
        )
    every = ", a larger every for slaves that need not be in each cycle" if len(together) > 1 else ""
    return Refusal(what, f"take cycle_ms = {_least(least)} or more{every}, or a faster rate")


def _missed(figures: Figures, verdict: CycleVerdict) -> str:
    """The frequency of misses of a possible cycle, and their reasons."""
    cycle, at, least = figures.cycle_ns, baud_text(figures.params.baud), least_ns(figures)
    head = f"cycle_ms = {cycle / NS_PER_MS:g} is"
    if verdict is CycleVerdict.POSSIBLE:
        typical = least[CycleVerdict.TYPICAL]
        return (
            f"{head} shorter than the typical rotation ({ms_text(typical)} at {at}): with slaves that answer after "
            f"60 bit times {_overrun(figures)}; take {_least(typical)} or more, or a faster rate"
        )
    if verdict is CycleVerdict.TYPICAL:
        enough = least[CycleVerdict.UNDISTURBED]
        return (
            f"{head} enough for the typical rotation ({ms_text(least[CycleVerdict.TYPICAL])} at {at}) only: misses are "
            f"to be expected for {', '.join(_costs(figures))}; take {_least(enough)} or more, or a faster rate"
        )
    costs = _costs(figures) or ["several repeated requests in one cycle"]
    return f"{head} kept at {at} while nothing is repeated: misses are to be expected for {', '.join(costs)}"


def _overrun(figures: Figures) -> str:
    """The effect of a typical rotation that is longer than the cycle: with or without its GAP poll."""
    data, cycle = figures.data_ns(Case.TYPICAL), figures.cycle_ns
    if data <= cycle:
        return f"no GAP poll fits beside the data ({ms_text(data)}), and each makes a cycle late"
    return f"the data alone take {ms_text(data)}: cycles begin late and {1 - cycle / data:.0%} are left out"


def _costs(figures: Figures) -> list[str]:
    """The parts of a rotation that do not fit into a cycle, and the cycles that each costs."""
    params, cycle = figures.params, figures.cycle_ns
    slow, usual = figures.data_ns(Case.NORMAL), figures.data_ns(Case.TYPICAL)
    spare = cycle - (usual if slow > cycle else slow)
    vain = max((vain_bits(params, request_octets(s)) for s in figures.setups), default=0)
    pieces = (("repeated request", params.ns(vain) + figures.host_slack_ns), *_beside(figures))
    costs = [f"rounds in which all slaves need their max T_SDR ({ms_text(slow)})"] if slow > cycle else []
    for name, takes in pieces:
        if takes > spare:
            cycles = -(-(takes - spare) // cycle)
            costs.append(f"each {name} that takes long (up to {ms_text(takes)}: {cycles} cycle{'s' * (cycles > 1)})")
    return costs


def _beside(figures: Figures) -> tuple[tuple[str, int], ...]:
    """Name and longest time in ns of the requests between two cycles."""
    params = figures.params
    return (
        ("diagnosis", params.ns(longest_diagnosis(params, figures.setups))),
        ("acyclic service", params.ns(figures.acyclic_bits)),
        ("GAP poll", params.ns(gap_poll_bits(params))),
    )


def _turn(cycle: int, setup: SlaveParams) -> str:
    turn = f"cycle_ms = {cycle / NS_PER_MS:g}"
    return turn if setup.every == 1 else f"{turn} x every = {setup.every} ({ms_text(cycle * setup.every)})"


def _least(ns: int) -> str:
    """Milliseconds for the configuration, up to the next microsecond."""
    return f"{-(-ns // NS_PER_US) / 1000:g}"
