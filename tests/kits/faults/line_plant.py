"""A master on a real-time driver, on the simulated kernel of ``kernel_kit``, with the slaves of ``faults.line_wire``.

Faults replace what lies between the driver and the wire: how received octets come to the port, what becomes of a write,
what the line echoes, and the driver's clock.
"""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, Final

import pytest
from faults.line_wire import CHAR_BITS, CONFIG, DATA_EXCHANGE, IDENT, Wire, WireSlave, is_live
from kernel_kit import Driven, Kernel

from dpstack.dp.master.commands import Mode, SetMode, Shutdown
from dpstack.dp.master.events import ForcedClear, MasterStopped, SlaveState, SlaveStateChanged
from dpstack.dp.master.master import Master
from dpstack.dp.master.settings import MasterSettings
from dpstack.dp.slave_params import SlaveParams
from dpstack.drivers.line.echo import Echo
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import Telegram
from dpstack.params import BusParams
from dpstack.phy.patience import ADAPTER
from dpstack.units import NS_PER_MS, NS_PER_S

#: the drivers by the names of the configuration, and those of ``kernel_kit``
DRIVERS: Final = {"asyncio": "asyncio", "process": "plain"}
FIRST: Final = 10  # address of the first slave
SAFE: Final = b"\x04\x7e"
#: octets of an exchange with its pauses, generously
_EXCHANGE_OCTETS: Final = 60
#: pieces of received octets with the times at which the port has them
Pieces = Iterator[tuple[int, bytes]]
#: from octets, and the time at which the first one was over on the wire
Deliver = Callable[[bytes, int], Pieces]


class LinePlant:
    """``slaves`` of one master. ``exchange_ms``: what the port adds to each exchange, for the watchdogs."""

    def __init__(
        self, driver: str, baud: int, slaves: int, seed: int, *, after_stall: str, echo: bool, exchange_ms: int
    ) -> None:
        self.rng = random.Random(seed)
        self.kernel = kernel = Kernel()
        kernel.far = self._far
        self.wire = Wire(baud, [WireSlave(FIRST + number) for number in range(slaves)])
        self.char_ns = self.wire.ns(CHAR_BITS)
        self.slaves = list(self.wire.slaves.values())
        #: how octets that were on the wire come to the port
        self.deliver: Deliver = self.whole
        #: what the port's own transmission brings back
        self.echo: Callable[[bytes], bytes] = bytes if echo else nothing
        #: what becomes of a write
        self.write: Callable[[bytes], int] = kernel.write
        self.forced: list[ForcedClear] = []
        self.ended = False
        self.rotation_ns = NS_PER_MS
        self._counts: Counter[str] = Counter()
        self._states: dict[int, SlaveState] = {}
        self._number = 0
        self._stall: tuple[str, int, int, str] | None = None
        params = BusParams.preset(baud, address=2, gap=0)
        exchange_ns = exchange_ms * NS_PER_MS + _EXCHANGE_OCTETS * self.char_ns
        watchdog_ms = max(200, -(-4 * slaves * exchange_ns // NS_PER_MS) // 10 * 10)
        setups = [
            SlaveParams(
                address=slave.address,
                name=f"s{slave.address}",
                ident=int.from_bytes(IDENT),
                config=CONFIG,
                safe=SAFE,
                watchdog_ms=watchdog_ms,
            )
            for slave in self.slaves
        ]
        settings = MasterSettings(safe_after_stall=after_stall == "safe", absent_divisor=ADAPTER.unknown_divisor)
        self.master = _Judged(self, params, setups, settings)
        self.station = ActiveStation(params, [self.master], patience=ADAPTER, now=kernel.now)
        self._patch = pytest.MonkeyPatch()
        self.driven = Driven(
            DRIVERS[driver],
            self.station,
            kernel,
            self._patch,
            paced=True,
            echo=Echo.AUTO,
            tune=self.station.set_patience,
        )
        self.driven.runtime._on_events = self._on_events
        self.driven.port._send = self._send
        self.set_outputs()

    # --- the bus ---
    def start(self) -> bool:
        """Up to data exchange with all slaves, in Operate; measures the rotation. False if it does not come."""
        self.driven.runtime.command(GoOnline())
        self.driven.runtime.command(SetMode(Mode.OPERATE))
        tokens, enough = self.wire.tokens, 12 * len(self.slaves)
        if not self.run(60 * NS_PER_S, lambda: self.exchanging and self._counts["exchanges"] >= enough):
            return False
        self.rotation_ns = (tokens[-1] - tokens[-9]) // 8
        return True

    def run(self, ns: int, until: Callable[[], bool] = lambda: False) -> bool:
        """For ``ns`` of true time, or until ``until`` holds, which is asked four times a rotation."""
        end = self.kernel.now + ns
        while self.kernel.now < end:
            self.driven.run(min(end, self.kernel.now + self.rotation_ns // 4))
            for slave in self.slaves:
                slave.elapse(self.kernel.now)
            if until():
                return True
        return False

    def rotations(self, number: int) -> None:
        """Run for so many rotations; the outputs change in every second one."""
        for _ in range(-(-number // 2)):
            self.set_outputs()
            self.run(2 * self.rotation_ns)

    def until_well(self) -> int | None:
        """Rotations until all slaves are in data exchange and each has had an exchange; None: not within 20 s."""
        begin = self.kernel.now
        counts = {slave: len(slave.said) for slave in self.slaves}

        def well() -> bool:
            return self.exchanging and all(len(slave.said) > counts[slave] for slave in self.slaves)

        if not self.run(max(100 * self.rotation_ns, 20 * NS_PER_S), well):
            return None
        return -(-(self.kernel.now - begin) // self.rotation_ns)

    def operate(self) -> None:
        """The operator's order after a stall."""
        self.driven.runtime.command(SetMode(Mode.OPERATE))

    def end(self) -> None:
        """The ordered end of the master, within the time that a program gives it."""
        self.driven.runtime.command(Shutdown())
        self.run(5 * NS_PER_S, lambda: self.ended)

    def close(self) -> None:
        self.driven.close()
        self._patch.undo()

    def set_outputs(self) -> None:
        """New live outputs: a number, and the slave's own address."""
        self._number = self._number % 100 + 1
        for slave in self.slaves:
            self.master.images[slave.address].outputs = bytes((0x80 | self._number, slave.address))

    @property
    def exchanging(self) -> bool:
        """Whether all slaves are in data exchange, to the master and to themselves."""
        handlers = self.master.handlers.values()
        return all(h.state is SlaveState.DATA_EXCHANGE for h in handlers) and all(
            slave.state == DATA_EXCHANGE for slave in self.slaves
        )

    # --- the driver's clock ---
    def stall(self, ms: int, how: str, place: str, number: int) -> None:
        """At the ``number``-th next call ``place`` the driver stands still for ``ms``. ``how``: "stopped" (its clock
        goes on), "machine" (its clock stands still, too), "suspended" (so, and the sleep clock goes on)."""
        self._stall = (place, number, ms * NS_PER_MS, how)
        self.kernel.held_up = self._held_up

    @property
    def stalled(self) -> bool:
        """Whether the stall is over."""
        return self._stall is None

    def _held_up(self, place: str) -> int:
        if self._stall is None or place != self._stall[0]:
            return 0
        _, number, ns, how = self._stall
        if number > 1:
            self._stall = (place, number - 1, ns, how)
            return 0
        self._stall = None
        if how != "stopped":
            self.kernel.behind += ns
        if how == "suspended":
            self.kernel.asleep += ns
        return ns

    # --- port and wire ---
    def whole(self, octets: bytes, first_end: int) -> Pieces:
        """A telegram at once, when its last octet is over."""
        yield first_end + self.char_ns * (len(octets) - 1), octets

    def _send(self, octets: bytes) -> int:
        self.kernel.now += self._held_up("handed over")
        return self.write(octets)

    def _far(self, octets: bytes, now: int) -> None:
        answer, answer_begin = self.wire.transmit(octets, now)
        echo = self.echo(octets)
        arrive = self.kernel.arrive
        if echo:
            for at, piece in self.deliver(echo, now + self.char_ns * (len(octets) - len(echo) + 1)):
                arrive(at, piece)
        if answer:
            for at, piece in self.deliver(answer, answer_begin + self.char_ns):
                arrive(at, piece)

    # --- judging ---
    def counts(self) -> Counter[str]:
        """All counters of this bus."""
        stats = self.station.stats
        found = Counter(self._counts)
        found["retries"] = sum(remote.retries for remote in stats.stations.values())
        found["wrong data"] += sum(self._wrong_outputs(slave) for slave in self.slaves)
        found["watchdogs"] = sum(len(slave.trips) for slave in self.slaves)
        found["requests skipped by FCB"] = sum(slave.skipped for slave in self.slaves)
        found["without pause"] = self.wire.without_pause
        found["collisions"] = self.wire.collisions
        found["tokens lost"] = stats.tokens_lost
        return found

    def _wrong_outputs(self, slave: WireSlave) -> int:
        return sum(is_live(octets) and octets[1] != slave.address for _, octets, _ in slave.given)

    def judge(self, request: Request, outcome: Telegram | Failure) -> None:
        """The end of an exchange as the master sees it, held against the slave's own account."""
        counts = self._counts
        if not request.cyclic:
            return
        if not isinstance(outcome, Telegram):
            counts["given up"] += 1
        elif outcome.data:
            counts["exchanges"] += 1
            said = self.wire.slaves[request.da].said
            if not said or outcome.data != said[-1]:
                counts["data of an earlier exchange" if outcome.data in said else "wrong data"] += 1

    def _on_events(self, events: list[Any]) -> None:
        for event in events:
            if isinstance(event, ForcedClear):
                self.forced.append(event)
            elif isinstance(event, MasterStopped):
                self.ended = True
            elif isinstance(event, SlaveStateChanged):
                was = self._states.get(event.address)
                self._states[event.address] = event.state
                if was is SlaveState.DATA_EXCHANGE and not self.ended:
                    slave = self.wire.slaves[event.address]
                    slave.elapse(self.kernel.now)
                    self._counts["dropped"] += 1
                    self._counts["dropped wrongly"] += slave.state == DATA_EXCHANGE
        self.driven.events += events


def nothing(_octets: bytes) -> bytes:
    """No echo."""
    return b""


class _Judged(Master):
    """A master whose outcomes are held against the slaves' own account."""

    def __init__(self, plant: LinePlant, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._plant = plant
        for handler in self.handlers.values():
            handler.data.done = partial(self._judge, handler.data, handler.data_result)

    def _judge(
        self, request: Request, done: Callable[[Telegram | Failure, int], None], outcome: Telegram | Failure, now: int
    ) -> None:
        self._plant.judge(request, outcome)
        done(outcome, now)

    def result(self, request: Request, outcome: Telegram | Failure, now: int) -> None:
        self._plant.judge(request, outcome)
        super().result(request, outcome, now)
