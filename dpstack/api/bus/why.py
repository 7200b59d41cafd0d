"""Evidence for ``dpstack why``: gathered from a running bus, or by a class 2 look at a bus; it never parameterises."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Final

from msgspec import structs

from dpstack.dp.acyclic.class2 import ReadService, Service, ServiceDone
from dpstack.dp.acyclic.job import Outcome, ServiceFailure
from dpstack.dp.master.bring_ups import DAMAGED, NOTHING, WRONG, History, Step
from dpstack.dp.master.commands import Mode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.scanner import Found
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.errors import DpError
from dpstack.fdl.interface import StationStats
from dpstack.fdl.livelist import ALL_ADDRESSES
from dpstack.params import MAX_STATION
from dpstack.units import NS_PER_S
from dpstack.why.evidence import CLASS2, RUN, Evidence, LineCounters, Neighbour, PublisherLink, Ring
from dpstack.why.facts import Facts, attempts, failures
from dpstack.why.story import Story, tell

if TYPE_CHECKING:
    from dpstack.api.bus.parts import BusBase
    from dpstack.api.slave.slave import Slave

#: asks the addresses for their stations, with identifier octets
Scan = Callable[[list[int]], Awaitable[tuple[Found, ...]]]

#: with more requests than this the counters since the start hide a trouble of now: the bus is watched for this long (s)
_MANY: Final = 2_000
_WATCH_S: Final = 0.5
#: time limit in s of the scan for stations at other addresses, and addresses that it asks in one go
_SCAN_S: Final = 30.0
_SCAN_PART: Final = 16
#: a slave whose answers fail is asked this often at most, until this many good answers came, and for this long
_PROBES: Final = 6
_GOOD: Final = 3
_PROBE_NS: Final = 3 * NS_PER_S
_ASK_NS: Final = 2 * NS_PER_S
#: so long a disturbance of the port explains lost slaves; it is reported once a minute
_LATELY_NS: Final = 90 * NS_PER_S
_FAILED: Final = {
    ServiceFailure.SILENT: NOTHING,
    ServiceFailure.LATE: NOTHING,
    ServiceFailure.UNREADABLE: DAMAGED,
    ServiceFailure.WRONG: WRONG,
}


async def gather(
    bus: BusBase, slave: Slave, scan: Scan | None, *, ask: bool = True, master: int | None = None
) -> Evidence:
    """All that is known about ``slave``; with ``ask`` also its answers to class 2 services, while the bus is in the
    ring. ``master``: the address of its master by the configuration, None: this station.

    ``scan`` is called if nobody, or another device, answers at the address of the slave; None: never.
    """
    own = bus.params.address if master is None else master
    await _caught_up(bus, slave)
    before = evidence = _evidence(bus, slave, await _history(bus, slave), own)
    if Facts(before).unheard and _can_ask(bus):
        await _all_asked(bus, Facts(before))
        before = evidence = _evidence(bus, slave, await _history(bus, slave), own)
    if not ask or slave.deactivated or not bus.is_open or bus.runtime.not_running is not None:
        return evidence
    if attempts(before.link) > _MANY and (Facts(before).exchanging or not bus.snapshot.in_ring):
        await asyncio.sleep(_WATCH_S)
        evidence = _evidence(bus, slave, await _history(bus, slave), own)
    if bus.snapshot.in_ring:
        evidence = await _asked(bus, slave, evidence)
    if attempts(before.link) > _MANY:
        evidence = _counted_since(before, evidence)
    owner = None if evidence.diagnosis is None else evidence.diagnosis.master
    if master is None and evidence.read_only and owner is not None and owner <= MAX_STATION:  # nobody says who it is
        evidence = dataclasses.replace(evidence, ring=dataclasses.replace(evidence.ring, own=owner))
    facts = Facts(evidence)
    lost = not facts.exchanging and (facts.silent_now or facts.garbled_now or facts.wrong_ident is not None)
    if scan is None or not lost or evidence.line.disturbed or not _can_ask(bus):  # a disturbed port finds nobody
        return evidence
    return await _scanned(bus, evidence, scan)


async def _caught_up(bus: BusBase, slave: Slave) -> None:
    """Wait for the next exchange with a slave whose last one is old, though its master says that it exchanges data: the
    program may have stood still until now, and the master with it."""
    if slave.state is not SlaveState.DATA_EXCHANGE or not bus.is_open or bus.runtime.not_running is not None:
        return
    before = _evidence(bus, slave, History(), bus.params.address)
    if before.ring.joined and before.ring.asks and Facts(before).stale:
        with contextlib.suppress(TimeoutError, DpError):  # it stands still indeed, or has ended meanwhile
            await bus.until_round(lambda: bus.view.image(slave.setup).input_time != before.exchanged_ns, _WATCH_S)


async def _all_asked(bus: BusBase, facts: Facts) -> None:
    """Wait until the other slaves in data exchange have been asked since this one fell silent: they may be silent, too,
    and nobody knows it yet."""
    others = [one for one in bus.slaves if one.address in {other.address for other in facts.unheard}]

    def is_asked(one: Slave) -> bool:
        exchanged = bus.view.image(one.setup).input_time
        return one.state is not SlaveState.DATA_EXCHANGE or exchanged > facts.silent_since

    with contextlib.suppress(TimeoutError, DpError):
        await bus.until_round(lambda: all(map(is_asked, others)), _WATCH_S)


def _counted_since(before: Evidence, now: Evidence) -> Evidence:
    """``now`` with the counters of stations and line since ``before``."""
    old = {one.address: one.link for one in before.neighbours}
    neighbours = [
        dataclasses.replace(one, link=_difference(one.link, old[one.address])) if one.address in old else one
        for one in now.neighbours
    ]
    was = before.line
    line = dataclasses.replace(
        now.line,
        heard=now.line.heard - was.heard,
        bad={cause: more for cause, count in now.line.bad.items() if (more := count - was.bad.get(cause, 0)) > 0},
    )
    link = _difference(now.link, before.link)
    return dataclasses.replace(now, since_ns=before.now_ns, neighbours=tuple(neighbours), line=line, link=link)


def _difference(now: StationStats, before: StationStats) -> StationStats:
    bad = {cause: more for cause, count in now.bad.items() if (more := count - before.bad.get(cause, 0)) > 0}
    counters = {
        name: getattr(now, name) - getattr(before, name) for name in StationStats.__struct_fields__ if name != "bad"
    }
    return StationStats(**counters, bad=bad)


def _can_ask(bus: BusBase) -> bool:
    return bus.is_open and bus.runtime.not_running is None and bus.snapshot.in_ring


async def _history(bus: BusBase, slave: Slave) -> History:
    with contextlib.suppress(DpError):  # a bus process that has ended
        return await bus.view.history(slave.address)
    return History()


def untold(bus: BusBase, slave: Slave, master: int, refused: str) -> Story:
    """The story of ``slave`` on a ``bus`` whose ring could not be joined, because of ``refused``."""
    evidence = _evidence(bus, slave, History(), master)
    ring = dataclasses.replace(evidence.ring, joined=False, refused=refused)
    return tell(dataclasses.replace(evidence, ring=ring, state=SlaveState.OFFLINE))


def _evidence(bus: BusBase, slave: Slave, history: History, master: int) -> Evidence:
    setup, view, snapshot = slave.setup, bus.view, bus.snapshot
    counters = view.counters()
    link = counters.link
    texts, device = setup.texts, slave.config.device
    modules = () if texts is None else texts.modules
    bad = counters.decoder.by_cause()
    bad |= {f"uart_{cause}": count for cause, count in counters.damage.items() if count}
    neighbours = [
        Neighbour(
            one.address,
            one.name,
            one.state,
            one.setup.ident,
            link.station(one.address),
            _ident_there(one),
            view.image(one.setup).input_time,
        )
        for one in bus.slaves
        if one is not slave
    ]
    return Evidence(
        setup=setup,
        state=slave.state,
        source=CLASS2 if view.read_only else RUN,
        now_ns=bus.runtime.now(),
        started_ns=bus.started_ns,
        since_ns=bus.started_ns,
        fault=slave.fault,
        diagnosis=slave.diagnosis,
        history=history,
        link=link.station(slave.address),
        neighbours=tuple(neighbours),
        links=tuple(PublisherLink(one.publisher, one.good, one.text) for one in slave.links),
        watchdog_ns=slave.snapshot.watchdog_ns,
        exchanged_ns=view.image(setup).input_time,
        device=device,
        modules=modules,
        expected_prm=slave.config.expected_user_prm,
        rates=slave.config.baud_rates,
        unknown=frozenset(bus.gap_slaves - {one.address for one in bus.slaves}),
        read_only=view.read_only,
        asker=bus.params.address,
        ring=Ring(
            own=master,
            joined=snapshot.in_ring,
            asks=view.read_only or snapshot.mode >= Mode.CLEAR,
            masters=snapshot.las,
            collision=bus.collision or "",
            tokens=link.tokens,
            tokens_lost=link.tokens_lost,
            token_retries=link.token_retries,
        ),
        line=LineCounters(
            baud=bus.params.baud,
            slot_bits=bus.params.t_sl,
            min_tsdr=bus.params.min_tsdr,
            heard=link.heard,
            bad=bad,
            longest_ns=counters.rotation.max_ns,
            planned_ns=bus.rotation_limit_ns,
            paced=bus.runtime.paced,
            disturbed=_disturbed(bus),
        ),
    )


def _disturbed(bus: BusBase) -> str:
    """Acts of other programs at the port, the latest ones."""
    event = bus.disturbed
    return event.what if event is not None and bus.runtime.now() - event.t_ns < _LATELY_NS else ""


def _ident_there(slave: Slave) -> int | None:
    """The ident number of the device that answers at the address of ``slave``; None if nobody has answered."""
    there = slave.state not in (SlaveState.OFFLINE, SlaveState.DEACTIVATED)
    return slave.diagnosis.ident if there and slave.diagnosis is not None else None


async def _asked(bus: BusBase, slave: Slave, before: Evidence) -> Evidence:
    """``before`` with the answers of the slave to Slave_Diag and Get_Cfg, and with the counters after them.

    A slave in data exchange with this master is not asked: Slave_Diag would take its flag for a new diagnosis away. One
    whose answers fail is asked several times, so that its counters say something.
    """
    address = before.setup.address
    steps: list[Step] = []
    facts = Facts(before)
    if before.read_only or (not facts.exchanging and (not facts.answers_now or failures(before.link))):
        good, most = 0, 1 if before.read_only else _GOOD
        until = bus.runtime.now() + _PROBE_NS
        for number in range(_PROBES):
            if good >= most or not _can_ask(bus) or (number and bus.runtime.now() >= until):
                break
            step = await _ask(bus, address, Service.DIAGNOSIS)
            good += step.diagnosis is not None
            _append(steps, step)
    config = None
    facts = Facts(dataclasses.replace(before, asked=tuple(steps)))
    if not facts.silent_now and not facts.garbled_now and (before.read_only or not facts.exchanging) and _can_ask(bus):
        step = await _ask(bus, address, Service.CONFIG)
        config = step.received or None
        steps.append(step)
    after = _evidence(bus, slave, before.history, before.ring.own)
    diagnosis = next((one for step in reversed(steps) if (one := step.diagnosis) is not None), after.diagnosis)
    state = _state_of(facts, diagnosis) if before.read_only else after.state
    return dataclasses.replace(
        after,
        asked=tuple(steps),
        asked_in_vain=max(0, failures(after.link) - failures(before.link)),
        config=config,
        diagnosis=diagnosis,
        state=state,
    )


def _append(steps: list[Step], step: Step) -> None:
    """Put ``step`` at the end; one that is like the last counts there."""
    last = steps[-1] if steps else None
    if last is not None and structs.replace(last, t_ns=0, last_ns=0, times=1) == structs.replace(
        step, t_ns=0, last_ns=0
    ):
        steps[-1] = structs.replace(last, times=last.times + 1, last_ns=step.t_ns)
    else:
        steps.append(step)


def _state_of(facts: Facts, diagnosis: Diagnosis | None) -> SlaveState:
    """The state of a slave that another master may own."""
    if facts.exchanging:
        return SlaveState.DATA_EXCHANGE
    if diagnosis is None or facts.silent_now:
        return SlaveState.OFFLINE
    refuses = diagnosis.prm_fault or diagnosis.cfg_fault or diagnosis.not_supported
    if facts.wrong_ident is not None or facts.owner is not None or refuses:
        return SlaveState.FAULT
    return SlaveState.DIAGNOSIS if diagnosis.prm_req else SlaveState.WAIT_READY


async def _ask(bus: BusBase, address: int, service: Service) -> Step:
    """One class 2 service as a step."""
    token = bus.services.token()
    try:
        await bus.load_layouts()
        done = await bus.services.answer_to(ReadService(token, address, service, None, _ASK_NS), ServiceDone)
    except DpError as error:
        now = bus.runtime.now()
        return Step(now, service.title, b"", str(error), last_ns=now)
    return Step(done.t_ns, service.title, b"", _answered(done.outcome), done.outcome.data, last_ns=done.t_ns)


def _answered(outcome: Outcome) -> str:
    if outcome.failure is None:
        return "DL"
    return outcome.status or _FAILED.get(outcome.failure, outcome.failure.value)


async def _scanned(bus: BusBase, evidence: Evidence, scan: Scan) -> Evidence:
    """``evidence`` with the stations at addresses that the configuration does not have."""
    taken = {one.address for one in evidence.neighbours} | {bus.params.address, evidence.setup.address}
    addresses = [address for address in ALL_ADDRESSES if address not in taken]
    if evidence.read_only:
        addresses += [one.address for one in evidence.neighbours]
    found: list[Found] = []
    unreadable: set[int] = set()
    whole = False
    with contextlib.suppress(TimeoutError, DpError):
        async with asyncio.timeout(_SCAN_S):
            for at in range(0, len(addresses), _SCAN_PART):
                found += await scan(addresses[at : at + _SCAN_PART])
                unreadable |= bus.unreadable
            whole = True
    if not whole and not found:
        return evidence
    return dataclasses.replace(evidence, found=tuple(found), unreadable=frozenset(unreadable))
