"""The long run on ptys: a bus with a fixed cycle in this process, slaves of octets in another one.

    python -m soak.ptys asyncio|process MINUTES    (in tests/kits)

prints its result as one JSON line. The program sets outputs in every cycle and reads inputs, records, services of
class 2 and the live list; readers follow events and the live stream. Memory is sampled in this process and in the bus
process.
"""

from __future__ import annotations

import asyncio
import json
import os
import struct
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from random import Random
from typing import Any, Final

from process_kit import DRIVERS, Driver
from soak.leftovers import belongings, children_of, handles_of, locks_of, memory, rss_of
from soak.readers import StreamReaders

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.dp.master.events import CyclesMissed, SlaveStateChanged
from dpstack.drivers.process.client import ProcessRuntime
from dpstack.trace import Event

_KITS: Final = Path(__file__).resolve().parents[1]
BAUD: Final = 1_500_000
CYCLE_MS: Final = 20
#: addresses of the slaves; each has a counter three times in its twelve octets, and mirrors it
_SLAVES: Final = (3, 4, 5, 6)
_WORD: Final = struct.Struct(">III")
#: samples of memory and windows of the grid
_SAMPLES: Final = 60
#: memory is compared from this part on
_WARM: Final = 0.3
#: due times of a fixed cycle that pass while both ends are asked for their accounts, on a busy computer
_MOMENT: Final = 20
#: so much may the quickest arrivals differ between the first and the last third
_DRIFT_NS: Final = 1_000_000
#: readers keep the last 1000 events: with so many at the beginning they are full
_FILL: Final = 1000
#: all attempts of a request: the first one and ``max_retry`` 15, each with T_SL of a port, about 50 ms
_ATTEMPTS_MS: Final = 16 * 50


class FarProcess:
    """The process of ``soak.far_end``."""

    def __init__(self, window_s: float) -> None:
        specs = [f"{address}:0696:f3f1:12:12,records=1" for address in _SLAVES]
        words = [sys.executable, "-m", "soak.far_end", str(CYCLE_MS), str(window_s), *specs]
        self._process = subprocess.Popen(words, cwd=_KITS, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.port: str = self._line()["port"]

    def ask(self, order: str = "count") -> dict[str, Any]:
        """Its account up to now."""
        assert self._process.stdin is not None
        self._process.stdin.write(order + "\n")
        self._process.stdin.flush()
        return self._line()

    def end(self) -> None:
        """End it and wait for its end."""
        self._process.communicate()

    def _line(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        found: dict[str, Any] = json.loads(self._process.stdout.readline())
        return found


class PtyRun(StreamReaders):
    """A bus of ``driver`` for ``seconds``; :attr:`faults` are the differences that were found."""

    LIVE_S = 0.2

    def __init__(self, driver: Driver, seconds: float) -> None:
        super().__init__()
        self.driver = driver
        self.seconds = seconds
        self.random = Random(driver)
        self.faults: list[str] = []
        #: changes of states of slaves, which is the far end's doing only if that stood still
        self.changes: list[str] = []
        self.acts: Counter[str] = Counter()
        self.errors: Counter[str] = Counter()
        self.drift_ns = 0
        self.cycles = self.skipped = 0
        self.samples: list[dict[str, int]] = []
        self.running = self.over = False
        self.far = FarProcess(max(1.0, seconds / _SAMPLES))
        table = {"ident": 0x0696, "config": "F3 F1", "user_prm": "00 00 00", "dpv1": {"response_timeout_ms": 20_000}}
        slaves: list[dict[str, object]] = [{"name": f"s{a}", "address": a, **table} for a in _SLAVES]
        # nobody may be lost to a busy computer: an answer may come 16 times 50 ms late
        self.bus = dpstack.open_bus(
            port=self.far.port,
            baud=BAUD,
            driver=driver,
            slaves=slaves,
            cycle_ms=CYCLE_MS,
            max_retry=15,
            after_stall="resume",
            on_event=self._on_event,
        )

    def _on_event(self, event: Event) -> None:
        if self.running and isinstance(event, SlaveStateChanged):
            self.changes.append(event.text)

    # --- readers and the program ------------------------------------------------------------------------------------

    async def _exchange(self) -> None:
        """Outputs of every cycle; inputs are never torn, never older than those before, and never of the future."""
        count, before = 0, Counter[str]()
        async for cycle in self.bus.cycles():
            if not self.running:  # safe values come back
                break
            self.cycles += 1
            self.skipped += cycle.skipped
            for name, octets in cycle.inputs.items():
                one, two, three = _WORD.unpack(octets)
                if not one == two == three:
                    self.faults.append(f"{name}: torn inputs {octets.hex()}")
                if not before[name] <= one <= count:
                    self.faults.append(f"{name}: inputs {one} after {before[name]}, outputs are at {count}")
                before[name] = one
            count += 1
            for slave in self.bus.slaves:
                slave.outputs = _WORD.pack(count, count, count)

    async def _act_on(self) -> None:
        while not self.over:
            await asyncio.sleep(self.random.choice((0.1, 0.3, 1.0)))
            await self._act()

    async def _act(self) -> None:
        bus, random = self.bus, self.random
        slave = random.choice(bus.slaves)
        class2 = bus.class2
        act = random.choices(("read", "write", "class2", "history", "why", "scan"), (30, 10, 30, 10, 5, 1))[0]
        self.acts[act] += 1
        try:
            match act:
                case "read":
                    await slave.read(1, random.randrange(256), length=32, timeout=60)
                case "write":
                    await slave.write(1, random.randrange(256), bytes(16), timeout=60)
                case "class2":
                    services = (class2.diagnosis, class2.config, class2.inputs, class2.outputs)
                    await random.choice(services)(slave, timeout=60)
                case "history":
                    await core_of(bus).view.history(slave.address)
                case "why":
                    await bus.why(slave)
                case "scan":
                    await bus.scan(addresses=range(10))
        except dpstack.DpError as error:  # a busy computer may make an answer too late: counted, and judged by its kind
            self.errors[f"{act}: {type(error).__name__}"] += 1

    # --- the course -------------------------------------------------------------------------------------------------

    @property
    def bus_process(self) -> int | None:
        runtime = core_of(self.bus).runtime
        return runtime.pid if isinstance(runtime, ProcessRuntime) else None

    def _fill(self) -> None:
        """Fill what keeps the last events with the longest of a usual kind, so that memory does not grow by that."""
        for number in range(1, _FILL + 1):
            reason = f"the round before took {number / 1000:.3f} ms"
            core_of(self.bus).publish(
                CyclesMissed(
                    t_ns=core_of(self.bus).runtime.now(),
                    count=1,
                    missed=number,
                    number=number,
                    late_ns=1,
                    reason=reason,
                )
            )

    def _sample(self) -> None:
        mine, pid = memory(), self.bus_process
        sample = {
            "rss": mine.rss,
            "objects": mine.objects,
            "handles": len(handles_of()),
            "tasks": len(asyncio.all_tasks()),
        }
        if pid is not None:
            sample |= {"bus_rss": rss_of(pid), "bus_handles": len(handles_of(pid))}
        self.samples.append(sample)

    async def run(self) -> dict[str, Any]:
        """The whole course; returns the result."""
        before, began, cpu = belongings(), time.time(), time.process_time()
        bus, far = self.bus, self.far
        async with bus:
            pid = self.bus_process
            self._fill()
            await bus.ready(60)
            await bus.operate()
            self.running = True
            readers = [asyncio.create_task(r()) for r in (self.read_events, self.read_live, self._exchange)]
            far.ask("begin")
            acting = asyncio.create_task(self._act_on())
            begun = self._places()
            for _ in range(_SAMPLES):
                await asyncio.sleep(self.seconds / _SAMPLES)
                self._sample()
            self.over = True
            await acting  # a live list on a busy computer takes a while
            seen = far.ask()
            due = self._places() - begun
            self.running = False
        async with asyncio.timeout(60):
            await asyncio.gather(*readers)
        account = far.ask()
        self._compare(account)
        windows = seen["windows"]
        self._judge_grid(windows, due, seen["places"])
        result = self._result(account, windows)
        del self.bus, bus, readers
        await asyncio.sleep(0.2)  # sockets and timers close in later turns of the loop
        left = belongings().more_than(before)
        if pid is not None:
            left += [f"bus process {pid} runs on"] * (pid in children_of(os.getpid()) or bool(locks_of(pid)))
        far.end()
        return {
            **result,
            "began": int(began),
            "cpu_s": round(time.process_time() - cpu, 1),
            "leftovers": left,
            "faults": self.faults[:50],
        }

    def _compare(self, account: dict[str, Any]) -> None:
        """Our counters against those of the far end."""
        link = core_of(self.bus).view.counters().link
        ours: dict[str, int] = {"sent": link.sent, "heard": link.heard, "tokens": link.tokens}
        theirs: dict[str, int] = {
            "sent": account["telegrams"],
            "heard": account["answers"],
            # the two of a claim are one; the bus may end with a token on the line, before its next hold begins
            "tokens": account["tokens"] - 1 - link.tokens_lost - link.token_retries,
        }
        theirs["tokens"] -= theirs["tokens"] == link.tokens + 1
        late = sum(station.late + station.wrong for station in link.stations.values()) + link.late + link.stray
        for slave in self.bus.slaves:
            key = str(slave.address)
            ours[f"{key} exchanges"] = slave.exchanges
            theirs[f"{key} exchanges"] = account["exchanges"][key]
        for key, mine in ours.items():
            # where an answer came too late, its exchange may count at one end only
            if abs(mine - theirs[key]) > (late if "exchanges" in key else 0):
                self.faults.append(f"{key}: {mine} of ours, {theirs[key]} at the far end")
        still_ms: int = account["stood_still_ms"]
        if self.changes and still_ms < _ATTEMPTS_MS:
            first = "; ".join(self.changes[:3])
            self.faults.append(
                f"{len(self.changes)} changes of states ({first}); the far end stood still for {still_ms} ms"
            )
        if account["junk"] or account["expired"]:
            self.faults.append(f"far end: {account['junk']} octets of no telegram, {account['expired']} watchdogs")
        if set(account["control"]) != {"0200"} or any(any(bytes.fromhex(octets)) for octets in account["outputs"]):
            self.faults.append(f"not in Clear at the end: {account['control']}, {account['outputs']}")

    def _places(self) -> int:
        """The due times of the fixed cycle so far, those of cycles that were left out too."""
        book = core_of(self.bus).view.counters().cycles
        return book.begun + book.left_out

    def _judge_grid(self, windows: list[list[int]], due: int, seen: int) -> None:
        """The quickest arrivals of the first and the last third must have the same delay; a drift would move them.
        Both ends count the same due times, but for those of the moment in which the two are asked."""
        if abs(seen - due) > _MOMENT:
            self.faults.append(f"{due} due times of ours, {seen} at the far end")
        third = max(1, len(windows) // 3)
        first, last = (min(window[2] for window in part) for part in (windows[:third], windows[-third:]))
        self.drift_ns = last - first
        if abs(self.drift_ns) > _DRIFT_NS:
            self.faults.append(f"the grid moved by {self.drift_ns / 1e6} ms in {self.seconds} s")

    def _result(self, account: dict[str, Any], windows: list[list[int]]) -> dict[str, Any]:
        link = core_of(self.bus).view.counters().link
        cycles = self.bus.stats.cycles
        assert cycles is not None
        stations = [link.station(address) for address in _SLAVES]
        warm = self.samples[int(len(self.samples) * _WARM) :]
        return {
            "ptys": self.driver,
            "seconds": self.seconds,
            "telegrams": account["telegrams"] + account["answers"],
            "exchanges": sum(account["exchanges"].values()),
            "repeats": account["repeats"],
            "unanswered": account["late"],
            "ours": {"sent": link.sent, "heard": link.heard, "tokens": link.tokens},
            "tokens_lost": link.tokens_lost,
            "timeouts": sum(station.timeouts for station in stations),
            "retries": sum(station.retries for station in stations),
            "late": sum(station.late for station in stations),
            "cycles": cycles.begun,
            "missed": cycles.missed,
            "left_out": cycles.left_out,
            "rounds_seen": sum(window[0] for window in windows),
            "changes": len(self.changes),
            "stood_still_ms": account["stood_still_ms"],
            "drift_us": self.drift_ns // 1000,
            "rounds_late_ms": round(max(window[3] - window[2] for window in windows) / 1e6, 1),
            "acts": dict(self.acts),
            "errors": dict(self.errors),
            "events": dict(self.events),
            "live_items": self.items,
            "cycles_read": self.cycles,
            "cycles_skipped": self.skipped,
            "growth": {key: warm[-1][key] - warm[0][key] for key in warm[0]},
            "peak": {key: max(sample[key] for sample in warm) for key in warm[0]},
            "samples": self.samples[:: max(1, len(self.samples) // 12)],
        }


class Started:
    """The run of a driver, in a process of its own."""

    def __init__(self, driver: str, minutes: float) -> None:
        words = [sys.executable, "-m", "soak.ptys", driver, str(minutes)]
        self._process = subprocess.Popen(words, cwd=_KITS, stdout=subprocess.PIPE, text=True)

    def result(self) -> dict[str, Any]:
        """Its line of the results file, once it is over. Raises RuntimeError if it failed."""
        out, _ = self._process.communicate()
        if self._process.returncode:
            raise RuntimeError(f"the run on ptys ended with {self._process.returncode}: its error is above")
        found: dict[str, Any] = json.loads(out.splitlines()[-1])
        return found


def start(driver: str, minutes: float) -> Started:
    """Start the run of ``driver``, "asyncio" or "process"."""
    return Started(driver, minutes)


def main() -> int:
    name, minutes = sys.argv[1:]
    (driver,) = (known for known in DRIVERS if known == name)
    print(json.dumps(asyncio.run(PtyRun(driver, 60 * float(minutes)).run())))
    return 0


if __name__ == "__main__":
    sys.exit(main())
