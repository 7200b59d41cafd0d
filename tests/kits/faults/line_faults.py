"""Faults of the fault matrix between the driver and the wire: delivery, writing, echo, the driver's clock.

The plant is that of ``faults.line_plant``: real line drivers on a simulated kernel, slaves of octets. The keys of a
line are those of ``faults.matrix``, and these:

- ``watchdogs``: ends of slaves' watchdogs while the fault acted
- ``live octets after the watchdog``: Data_Exchange with live outputs on the wire to a slave whose watchdog had acted in
  the stall, before Operate was ordered again; and how many of them a slave took
- ``octets in Clear``: the outputs of the slaves after a stall
- ``data of an earlier exchange``, ``requests skipped by FCB``: inputs and requests that were taken for others
- ``without pause``, ``collisions``: telegrams before the silence that begins a request, or in another telegram
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final

from faults.line_plant import LinePlant, Pieces, nothing
from faults.line_wire import WireSlave, is_live
from faults.matrix import Fault, Row

from dpstack.dp.master.commands import Mode
from dpstack.dp.master.events import Stalled
from dpstack.units import NS_PER_MS, NS_PER_S

End = Callable[[], None]
Begin = Callable[[LinePlant], End]
#: how many rotations a fault acts, and how many stalls there are, by slaves
ROTATIONS: Final = {1: 60, 8: 20, 32: 8}
STALLS: Final = {1: 3, 8: 2, 32: 1}
BEFORE_END: Final = 2
#: calls of the system around which the driver stands still
PLACES: Final = ("octets", "nothing", "write", "woken")


@dataclass(frozen=True, kw_only=True)
class LineFault:
    """``port`` makes the port so from the start, ``begin`` begins the fault and returns what ends it.

    ``echo``: from the start. ``stall_ms``: the driver or its clock stands still for so long, which is a line for each
    value of ``after_stall``. ``exchange_ms``: what the port adds to an exchange. ``least_ms``: the shortest time in
    which the fault acts. ``quick``: in ``make test``.
    """

    name: str
    begin: Begin
    port: Callable[[LinePlant], None] = lambda _plant: None
    echo: bool = False
    stall_ms: int = 0
    exchange_ms: int = 0
    least_ms: int = 0
    quick: bool = False


def always(_plant: LinePlant) -> End:
    """The port itself is the fault."""
    return _nothing


def _nothing() -> None: ...


# --- delivery ---------------------------------------------------------------------------------------------------------


def single_octets(plant: LinePlant) -> None:
    """Every octet comes by itself, when it is over."""

    def deliver(octets: bytes, first_end: int) -> Pieces:
        for number in range(len(octets)):
            yield first_end + number * plant.char_ns, octets[number : number + 1]

    plant.deliver = deliver


def split(plant: LinePlant) -> None:
    """Telegrams come in random pieces, each up to 5 ms late, in order."""
    last = 0

    def deliver(octets: bytes, first_end: int) -> Pieces:
        nonlocal last
        begin = 0
        while begin < len(octets):
            end = min(len(octets), begin + plant.rng.randint(1, 8))
            last = max(last, first_end + (end - 1) * plant.char_ns + plant.rng.randrange(5 * NS_PER_MS))
            yield last, octets[begin:end]
            begin = end

    plant.deliver = deliver


def latency(ms: int, plant: LinePlant) -> None:
    """A latency timer: octets come at multiples of ``ms``, those of several telegrams at once."""
    tick = ms * NS_PER_MS

    def deliver(octets: bytes, first_end: int) -> Pieces:
        for number in range(len(octets)):
            yield -(-(first_end + number * plant.char_ns) // tick) * tick, octets[number : number + 1]

    plant.deliver = deliver


def held_back(ms: int, plant: LinePlant) -> End:
    """Now and then all octets come up to ``ms`` later, merged with those behind them."""
    until, share = 0, 0.5 / len(plant.slaves)

    def deliver(octets: bytes, first_end: int) -> Pieces:
        nonlocal until
        end = first_end + plant.char_ns * (len(octets) - 1)
        if end > until + 3 * ms * NS_PER_MS and plant.rng.random() < share:
            until = end + ms * NS_PER_MS
        yield max(end, until), octets

    plant.deliver = deliver

    def end_fault() -> None:
        nonlocal share
        share = 0.0  # the order of the octets stays

    return end_fault


# --- writing ----------------------------------------------------------------------------------------------------------


def refused(_plant: LinePlant, _octets: bytes) -> int:
    """EAGAIN."""
    raise BlockingIOError


def in_part(plant: LinePlant, octets: bytes) -> int:
    """Only the first octets are taken."""
    return plant.kernel.write(octets[: plant.rng.randrange(1, len(octets))])


def blocks(plant: LinePlant, octets: bytes) -> int:
    """The call takes up to 30 ms, before or after the octets are on the wire."""
    pause, before = plant.rng.randrange(30 * NS_PER_MS), plant.rng.random() < 0.5
    plant.kernel.now += pause * before
    size = plant.kernel.write(octets)
    plant.kernel.now += pause * (not before)
    return size


def writes(spoil: Callable[[LinePlant, bytes], int], share: float, plant: LinePlant) -> End:
    """A ``share`` of the writes ends otherwise."""
    write = plant.kernel.write
    plant.write = lambda octets: spoil(plant, octets) if plant.rng.random() < share else write(octets)

    def end() -> None:
        plant.write = write

    return end


def refuses_for(ms: int, plant: LinePlant) -> End:
    """The port takes nothing for ``ms``."""
    end = writes(refused, 1.0, plant)
    plant.run(ms * NS_PER_MS)
    end()
    return _nothing


def signals(plant: LinePlant) -> End:
    """EINTR: in one call in five a signal handler runs for up to 0.5 ms, and Python makes the call again (PEP 475)."""
    plant.kernel.held_up = lambda _what: plant.rng.randrange(500_000) if plant.rng.random() < 0.2 else 0

    def end() -> None:
        plant.kernel.held_up = lambda _what: 0

    return end


# --- echo -------------------------------------------------------------------------------------------------------------


def echo_begins(plant: LinePlant) -> End:
    """From now on the line echoes."""
    plant.echo = bytes
    return _nothing


def echo_ends(plant: LinePlant) -> End:
    """From now on the line does not echo."""
    plant.echo = nothing
    return _nothing


def echoes(spoil: Callable[[LinePlant, bytes], bytes], plant: LinePlant) -> End:
    """One echo in five is another one."""
    plant.echo = lambda octets: spoil(plant, octets) if plant.rng.random() < 0.2 else octets

    def end() -> None:
        plant.echo = bytes

    return end


def from_the_middle(plant: LinePlant, octets: bytes) -> bytes:
    """The receiver is switched on while the telegram is sent."""
    return octets[plant.rng.randrange(len(octets)) :]


def damaged(plant: LinePlant, octets: bytes) -> bytes:
    """One bit is inverted, past the parity."""
    at = plant.rng.randrange(len(octets))
    return octets[:at] + bytes((octets[at] ^ 1 << plant.rng.randrange(8),)) + octets[at + 1 :]


# --- the driver's clock -----------------------------------------------------------------------------------------------


def stands_still(ms: int, how: str, places: tuple[str, ...], plant: LinePlant) -> End:
    """The driver stands still for ``ms``, at one of ``places``."""
    plant.stall(ms, how, plant.rng.choice(places), plant.rng.randint(1, 9))
    plant.run(10 * NS_PER_S, lambda: plant.stalled)
    return _nothing


def clock_stops(ms: int, plant: LinePlant) -> End:
    """The clock stands still for ``ms`` while the program runs."""
    begin = plant.kernel.now + plant.rng.randrange(plant.rotation_ns)
    plant.kernel.clock_stops = (begin, begin + ms * NS_PER_MS)
    plant.run(begin - plant.kernel.now + ms * NS_PER_MS)
    return _nothing


def _stops(name: str, ms: int, how: str, *, places: tuple[str, ...] = PLACES, quick: bool = False) -> LineFault:
    return LineFault(name=name, begin=partial(stands_still, ms, how, places), stall_ms=ms, quick=quick)


FAULTS: Final = (
    LineFault(name="port: whole telegrams", begin=always),
    LineFault(name="port: single octets", begin=always, port=single_octets, quick=True),
    LineFault(name="port: pieces up to 5 ms late", begin=always, port=split, exchange_ms=5, quick=True),
    *(
        LineFault(
            name=f"port: latency timer {ms} ms{', echo' * echo}",
            begin=always,
            port=partial(latency, ms),
            echo=echo,
            exchange_ms=2 * ms,
            quick=echo,
        )
        for ms, echo in ((1, False), (4, False), (16, False), (16, True))
    ),
    *(
        LineFault(
            name=f"port: held back for {ms} ms{', echo' * echo}",
            begin=partial(held_back, ms),
            echo=echo,
            exchange_ms=ms // 8,
            least_ms=10 * ms,
            quick=echo,
        )
        for ms, echo in ((30, False), (100, False), (100, True))
    ),
    LineFault(
        name="port: a write in ten blocks up to 30 ms", begin=partial(writes, blocks, 0.1), exchange_ms=3, least_ms=1000
    ),
    LineFault(
        name="port: a write in ten takes a part",
        begin=partial(writes, in_part, 0.1),
        exchange_ms=7,
        least_ms=1000,
        quick=True,
    ),
    LineFault(
        name="port: EAGAIN for a write in ten", begin=partial(writes, refused, 0.1), exchange_ms=7, least_ms=1000
    ),
    *(LineFault(name=f"port: EAGAIN for {ms} ms", begin=partial(refuses_for, ms)) for ms in (50, 1000)),
    LineFault(name="port: EINTR", begin=signals),
    LineFault(name="echo", begin=always, echo=True),
    LineFault(name="echo begins", begin=echo_begins, quick=True),
    LineFault(name="echo ends", begin=echo_ends, echo=True, quick=True),
    LineFault(name="echo starts in the middle", begin=partial(echoes, from_the_middle), echo=True, quick=True),
    LineFault(name="echo damaged", begin=partial(echoes, damaged), echo=True, quick=True),
    *(_stops(f"driver stopped for {ms} ms", ms, "stopped", quick=ms == 300) for ms in (10, 30, 100, 300)),
    _stops("driver stopped for 300 ms at the write", 300, "stopped", places=("handed over",)),
    *(
        LineFault(
            name=f"clock stands still for {ms} ms",
            begin=partial(clock_stops, ms),
            stall_ms=ms,
            quick=ms == 300,
        )
        for ms in (10, 30, 100, 300)
    ),
    *(_stops(f"machine and clock stopped for {ms} ms", ms, "machine") for ms in (30, 300)),
    *(_stops(f"computer suspended for {ms} ms", ms, "suspended") for ms in (50, 300)),
    _stops("computer suspended for an hour", 3_600_000, "suspended", quick=True),
)


# --- lines ------------------------------------------------------------------------------------------------------------


def row(fault: LineFault, driver: str, after_stall: str, baud: int, slaves: int, seed: int) -> Row:
    """The figures of one cell."""
    plant = LinePlant(
        driver, baud, slaves, seed, after_stall=after_stall, echo=fault.echo, exchange_ms=fault.exchange_ms
    )
    try:
        fault.port(plant)
        assert plant.start(), f"{fault.name}: no bring-up"
        return _measure(plant, fault, after_stall)
    finally:
        plant.close()


def _measure(plant: LinePlant, fault: LineFault, after_stall: str) -> Row:
    slaves = len(plant.slaves)
    before = plant.counts()
    stalled = _Stalls(plant, fault.stall_ms)
    if fault.stall_ms:
        for _ in range(STALLS[slaves]):
            plant.rotations(4)
            stalled.one(fault.begin)
        back = stalled.back
    else:
        end_fault = fault.begin(plant)
        plant.rotations(max(ROTATIONS[slaves], fault.least_ms * NS_PER_MS // plant.rotation_ns))
        end_fault()
        back = plant.until_well()
        plant.rotations(4)
    counted = plant.counts()
    counted.subtract(before)
    stalls = Counter(
        ("unknown" if s.blocked is None else s.blocked.value) if isinstance(s, Stalled) else "" for s in plant.forced
    )

    end_fault = fault.begin(plant)
    plant.rotations(BEFORE_END)
    plant.end()
    end_fault()
    found: Row = {name: counted.pop(name, 0) for name in ("exchanges", "retries", "wrong data")}
    found["back after"] = "never" if back is None else back
    found |= {name: counted.pop(name) for name in ("dropped", "dropped wrongly") if counted["dropped"]}
    if stalls or fault.stall_ms:
        found[f"stalls (after_stall = {after_stall})"] = _counted(stalls) or "none"
    if counted["watchdogs"] and fault.stall_ms:
        found["live octets after the watchdog"] = f"{stalled.live} sent, {stalled.taken} taken"
    if stalled.in_clear:
        found["octets in Clear"] = _counted(stalled.in_clear)
    found["last octets"] = _counted(Counter(slave.last_octets() for slave in plant.slaves))
    return found | {name: value for name, value in counted.items() if value}


class _Stalls:
    """Stalls one after the other, each followed by the operator's order if the master went to Clear."""

    def __init__(self, plant: LinePlant, ms: int) -> None:
        self._plant = plant
        self._ns = ms * NS_PER_MS
        self.back: int | None = 0
        self.live = self.taken = 0
        self.in_clear: Counter[str] = Counter()

    def one(self, begin: Begin) -> None:
        plant = self._plant
        forced = len(plant.forced)
        marks = [(slave, len(slave.given)) for slave in plant.slaves]
        begin(plant)
        since = plant.kernel.now - self._ns - plant.rotation_ns
        back = plant.until_well()
        self.back = None if back is None or self.back is None else max(back, self.back)
        for slave, mark in marks:
            self._count_live(slave, mark, since)
        if len(plant.forced) > forced:
            plant.run(NS_PER_S, lambda: plant.master.mode is Mode.CLEAR)
            plant.rotations(2)
            self.in_clear.update("live" if is_live(s.outputs) else s.outputs.hex(" ") for s in plant.slaves)
            plant.operate()
        plant.rotations(2)

    def _count_live(self, slave: WireSlave, mark: int, since: int) -> None:
        trips = [trip for trip in slave.trips if trip >= since]
        for at, octets, takes in slave.given[mark:]:
            if trips and at >= trips[0] and is_live(octets):
                self.live += 1
                self.taken += takes


def _counted(counts: Counter[str]) -> str:
    return "; ".join(f"{count} x {name}" for name, count in counts.most_common())


def _cells(number: int, fault: LineFault) -> list[Fault]:
    """Each fault with both drivers, by turns: one at a usual rate with 1 and 8 slaves, the other fast with 32."""
    drivers = ("asyncio", "process") if number % 2 else ("process", "asyncio")
    found = []
    for after_stall in ("safe", "resume") if fault.stall_ms else ("safe",):
        rule = f", after_stall = {after_stall}" if fault.stall_ms else ""
        for driver, baud, stations in zip(drivers, (500_000, 12_000_000), ((1, 8), (32,)), strict=True):
            few = 8 if number % 3 else 1
            found.append(
                Fault(
                    name=f"{fault.name}{rule}, {driver} driver",
                    measure=partial(row, fault, driver, after_stall),
                    rates=(baud,),
                    stations=stations,
                    quick=((baud, few),) if fault.quick and few in stations else (),
                )
            )
    return found


LINE_FAULTS: Final = [cells for number, fault in enumerate(FAULTS) for cells in _cells(number, fault)]
