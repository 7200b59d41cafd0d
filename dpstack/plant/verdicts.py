"""Verdicts on a running bus and its slaves, by the counters of the run: the levels and limits of ``dpstack monitor``.

A run knows its own traffic only, and no times of single telegrams: findings about other masters and about T_SDR are
left to the monitor. A verdict speaks about the last minutes, so that it becomes good again behind a fault.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from typing import Final, NamedTuple

from dpstack.monitor.thresholds import Thresholds
from dpstack.monitor.verdict import CRITICAL, UNKNOWN, WARNING, Finding, Verdict, verdict_of
from dpstack.plant.items import SlaveValues
from dpstack.plant.judge import DATA_EXCHANGE, DEACTIVATED, diagnosis_remark
from dpstack.plant.quality import Reason, clean
from dpstack.plant.tree import Change, NodesChanged, PlantTree
from dpstack.trace import Severity

#: s about which a verdict speaks, and s between two samples of the counters within them
WINDOW_S: Final = 300.0
_SAMPLE_S: Final = 30.0
#: losses of one slave that are kept
_MOST_LOSSES: Final = 16
#: reasons of the bus
_MOST_REASONS: Final = 16
#: a bus that has ended in order, or does not run yet, has no fault
_NOT_JUDGED: Final = frozenset({Reason.WAITING, Reason.SEARCHING, Reason.ENDED})
#: conditions of a slave that are judged by its values
_OF_VALUES: Final = ("fault", "diagnosis")
_BEGINS: Final = "the bus begins"
#: s between the end of the master and that of the bus, in an ordered end
_ENDING_S: Final = 1.0


class _Past:
    """The past of one slave: since when it is not in data exchange, and when it left it (s of the stream).

    ``was_alive``: it has been born since the master serves it."""

    def __init__(self, t: float) -> None:
        self.exchanged = self.was_alive = False
        self.away_since = t
        self.losses: deque[float] = deque(maxlen=_MOST_LOSSES)


class _Sample(NamedTuple):
    """Counters at the time ``t`` of the stream: of the bus by key, of slaves by address as :func:`_counters`."""

    t: float
    telegrams: float
    damaged: float
    tokens_lost: float
    slaves: Mapping[int, Sequence[float]]


class Judge:
    """Judges the plant of ``tree``. The caller hands over all changes of the tree (:meth:`take`)."""

    def __init__(self, tree: PlantTree, limits: Thresholds | None = None) -> None:
        self._tree = tree
        self._limits = limits or Thresholds()
        self._samples: deque[_Sample] = deque()
        self._past: dict[int, _Past] = {}
        #: the master has been in the ring and in operate, since the nodes are these
        self._has_run = False
        #: the bus, as :meth:`take` saw it last; and the time of the stream at its death
        self._is_alive, self._died = False, 0.0

    def take(self, changes: Sequence[Change]) -> None:
        """Note losses, and now and then the counters."""
        if any(isinstance(change, NodesChanged) for change in changes):
            self._samples.clear()
            self._past.clear()
            self._has_run = False
        tree = self._tree
        if not tree.is_alive(None):
            self._samples.clear()  # behind a death the counters may begin anew
            if self._is_alive:
                self._is_alive, self._died = False, tree.t
            return
        t, bus, self._is_alive = tree.t, tree.bus_values, True
        runs = bus.in_ring is True and (self._reads_only() or bus.mode == "operate")
        self._has_run = self._has_run or runs
        for address in tree.slaves:
            self._follow(address, t)
        if not self._samples or not 0 <= t - self._samples[-1].t < _SAMPLE_S:
            if self._samples and t < self._samples[-1].t:
                self._samples.clear()
            self._samples.append(self._sample(t))
            while len(self._samples) > 1 and t - self._samples[1].t >= WINDOW_S:
                self._samples.popleft()

    def judge(self) -> tuple[Verdict, dict[int, Verdict]]:
        """The verdict on the bus, and on each slave by address."""
        tree, limits = self._tree, self._limits
        trouble = tree.trouble(None)
        if not tree.is_alive(None):
            reason, note = (Reason.WAITING, "") if trouble is None else trouble
            stopped = reason is Reason.BUS_STALE
            begins = stopped and self._begins()
            text = _BEGINS if begins else reason.with_note(note)
            is_unknown = begins or (stopped and self._ends()) or reason in _NOT_JUDGED
            level = UNKNOWN if is_unknown else CRITICAL
            return Verdict(level, (text,)), dict.fromkeys(tree.slaves, Verdict(UNKNOWN, (text,)))
        now = self._sample(tree.t)
        before = self._samples[0] if self._samples else now
        slaves = {address: self._of_slave(address, before, now) for address in tree.slaves}
        found = list(self._of_bus(before, now))
        for address, described in tree.slaves.items():
            level, reasons = slaves[address]
            if level in (WARNING, CRITICAL):
                found.append((level, f"slave {address} ({clean(described.name)}): {reasons[0]}"))
        doubt = ""
        if self._begins():
            doubt = _BEGINS
        elif now.t - before.t < limits.min_seconds:
            doubt = "the bus runs for too short a time"
        return _short(verdict_of(found, doubt)), slaves

    def lost(self) -> list[int]:
        """The slaves that are lost at this moment, by address: the master serves them, and they are not in data
        exchange with valid inputs. One that begins has :attr:`Thresholds.bring_up_s` for it. None of a dead bus."""
        tree = self._tree
        if not tree.is_alive(None) or not self._is_served():
            return []
        return [address for address in tree.slaves if self._is_lost(address)]

    def _is_lost(self, address: int) -> bool:
        past = self._past.get(address)
        if past is None or self._tree.is_alive(address) or self._tree.slave_values(address).state == DEACTIVATED:
            return False
        return past.was_alive or self._tree.t - past.away_since >= self._limits.bring_up_s

    def _follow(self, address: int, t: float) -> None:
        past = self._past.setdefault(address, _Past(t))
        state = self._tree.slave_values(address).state
        exchanges = state == DATA_EXCHANGE
        if past.exchanged and not exchanges:
            past.away_since = t
            if state != DEACTIVATED and self._is_served():
                past.losses.append(t)
        elif state == DEACTIVATED or not self._is_served():
            past.away_since = t
            past.was_alive = False
        past.was_alive = past.was_alive or self._tree.is_alive(address)
        past.exchanged = exchanges

    def _begins(self) -> bool:
        """Whether the bus has begun, and has not had the time to run."""
        return not self._has_run and self._tree.t < self._limits.bring_up_s

    def _ends(self) -> bool:
        """Whether the master has just gone offline, while its process lives: the end may follow."""
        values, t = self._tree.bus_values, self._tree.t
        return values.mode == "offline" and values.stale is not True and t - self._died < _ENDING_S

    def _reads_only(self) -> bool:
        return self._tree.plant is not None and self._tree.plant.read_only is True

    def _is_served(self) -> bool:
        """Whether the master serves its slaves: else they leave data exchange by order."""
        return self._tree.bus_values.mode in ("clear", "operate")

    def _sample(self, t: float) -> _Sample:
        tree = self._tree
        bus = tree.bus_values
        damaged = sum((bus.bad or {}).values())
        slaves = {address: _counters(tree.slave_values(address)) for address in tree.slaves}
        return _Sample(t, bus.telegrams or 0, damaged, bus.tokens_lost or 0, slaves)

    def _of_bus(self, before: _Sample, now: _Sample) -> Iterator[Finding]:
        values, limits = self._tree.bus_values, self._limits
        if values.in_ring is False and not self._begins():
            yield CRITICAL, "the master is not in the token ring"
        if values.clear is not None:
            why = clean(values.clear.because)
            yield CRITICAL, f"the master went to Clear by itself{': ' if why else ''}{why}"
        elif values.mode != "operate" and not self._reads_only() and not self._begins():
            yield WARNING, f"the master is in {clean(values.mode) or 'an unknown mode'}, not in operate"
        damaged = now.damaged - before.damaged
        whole = now.telegrams - before.telegrams + damaged
        level = _level(damaged / whole, limits.damaged_warning, limits.damaged_critical) if whole > 0 else ""
        if level:
            yield level, f"{_percent(damaged / whole)} of the telegrams are damaged"
        lost = now.tokens_lost - before.tokens_lost
        if lost >= limits.drops_warning:
            yield WARNING, f"tokens were lost: {lost:.0f}"

    def _of_slave(self, address: int, before: _Sample, now: _Sample) -> Verdict:
        values, limits = self._tree.slave_values(address), self._limits
        state, past = values.state, self._past.get(address)
        if state == DEACTIVATED or not self._is_served() or past is None:
            return Verdict(UNKNOWN, ("the master does not exchange data with it",))
        found: list[Finding] = []
        if state != DATA_EXCHANGE and now.t - past.away_since >= limits.bring_up_s:
            why = clean(state) if values.fault is None else clean(values.fault.text)
            found.append((CRITICAL, f"it is not in data exchange: {why or 'unknown'}"))
        losses = sum(now.t - t <= WINDOW_S for t in past.losses)
        level = _level(losses, limits.lost_warning, limits.lost_critical)
        if level:
            found.append((level, f"it left data exchange {'once' if losses == 1 else f'{losses} times'}"))
        then = before.slaves.get(address, ())
        telegrams, retries, timeouts, late, wrong = (
            now - before for now, before in zip(now.slaves[address], then, strict=True)
        ) if then else (0.0,) * 5  # fmt: skip
        # telegrams are requests, repetitions and all that came back; each request has an answer or a timeout
        requests = (telegrams - retries - late - wrong + timeouts) / 2
        enough = requests >= limits.min_requests
        if enough:
            level = _level(retries / requests, limits.retries_warning, limits.retries_critical)
            if level:
                found.append((level, f"{_percent(retries / requests)} of its requests were repeated"))
            if late / requests >= limits.late_warning:
                found.append((WARNING, f"{_percent(late / requests)} of its answers came too late"))
        remark = diagnosis_remark(values, announced=False)
        if remark is not None:
            found.append((WARNING, f"it has a diagnosis: {clean(remark.text)}"))
        found += (
            (WARNING, f"{one.title}: {one.text}" if one.text else one.title)
            for one in self._tree.conditions.of(address)
            if one.active and one.level is not Severity.INFO and one.id.split("/", 2)[2] not in _OF_VALUES
        )
        if enough:
            return _short(verdict_of(found, ""))
        return _short(
            verdict_of(found, f"too few requests: {max(0.0, requests):.0f}, {limits.min_requests:g} are needed")
        )


def _short(verdict: Verdict) -> Verdict:
    return verdict._replace(reasons=verdict.reasons[:_MOST_REASONS])


def _level(value: float, warning: float, critical: float) -> str:
    """The level of ``value``; empty if it is in order."""
    if value <= 0:
        return ""
    return CRITICAL if value >= critical else WARNING if value >= warning else ""


def _counters(values: SlaveValues) -> Sequence[float]:
    counters = values.telegrams, values.retries, values.timeouts, values.late, values.wrong
    return [count or 0 for count in counters]


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %"
