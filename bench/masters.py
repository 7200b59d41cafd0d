"""The programs that are measured, each as a process of its own: ``python -m bench.masters KIND PORT ...``.

``asyncio`` and ``process`` are dpstack as a user has it, ``bare`` a loop that writes a request and reads an answer and
knows no protocol, ``pyprofibus`` the other Python stack. All exchange 12 octets each way with slaves from address 3 on.
``bare-ring`` is the bare loop as one of two masters: it waits for its token, and passes it on to ``--other``.
``grid``: bench/grid_loop.py sleeps in a process of its own, as the bus process of ``process``; with a port it exchanges
data, too. ``profirust``: the program of bench/peers/profirust, in place of this one.
One JSON line says when all are in data exchange; the end of standard input ends it in order.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import itertools
import json
import os
import select
import signal
import subprocess
import sys
import termios
import threading
import time
import tty
from collections.abc import Sequence
from time import monotonic_ns
from typing import Any, Final, NamedTuple

FIRST: Final = 3
IDENT: Final = 0x0696
CONFIG: Final = bytes((0xF3, 0x71))
OCTETS: Final = 12
DRIVERS: Final = ("asyncio", "process")
BARE: Final = "bare"
KINDS: Final = (*DRIVERS, BARE, "pyprofibus")
RING_KIND: Final = "bare-ring"
GRID_KIND: Final = "grid"
PROFIRUST: Final = "profirust"
#: in place of the port of ``grid``: its loop only sleeps
NO_PORT: Final = "-"
#: what else the program does that the master serves
APPLICATIONS: Final = ("idle", "block", "burn")
OWN: Final = 2
_TOKEN: Final = bytes((0xDC, OWN, OWN))
#: with a master that has not brought all its slaves up
_PATIENCE_NS: Final = 60_000_000_000
_BLOCK_S: Final = 0.05
#: so long a bare loop waits for an answer or the token, as dpstack does at a pty (phy.patience.HOST)
_RING_PATIENCE_S: Final = 0.05
_BLOCK_EVERY_S: Final = 0.5
#: the application does something so often; it is held up when that is so much later; so many such times are told
_TURN_NS: Final = 50_000_000
_HELD_UP_NS: Final = 20_000_000
_LONGEST: Final = 5
#: s between two looks whether the connectors serve
_LOOK_S: Final = 0.02
#: s between two outputs of a master whose plant is published
_WRITE_S: Final = 0.1


class Line(NamedTuple):
    """A line on which a loop exchanges data."""

    port: str
    baud: int
    slaves: int


class Ended(threading.Event):
    """Set when the one who started this process has had enough."""

    def watch(self) -> None:
        """Read standard input to its end, in a thread."""
        threading.Thread(target=self._wait, daemon=True).start()

    def _wait(self) -> None:
        with contextlib.suppress(OSError, ValueError):
            while os.read(sys.stdin.fileno(), 100):
                pass
        self.set()


def told(**facts: object) -> None:
    print(json.dumps(facts), flush=True)


# --- dpstack ---


async def dpstack_master(args: argparse.Namespace, ended: Ended) -> None:
    """A bus as the README shows it."""
    from dpstack import open_bus

    table: dict[str, Any] = {"ident": IDENT, "config": CONFIG.hex(" ")}
    if args.records:
        table |= {"dpv1": True, "user_prm": "00 00 00"}
    if args.connectors:
        table |= {"inputs": _named("in"), "outputs": _named("out")}
    tables = [{"name": f"s{n}", "address": args.first + n} | table for n in range(args.slaves)]
    keys: dict[str, Any] = {"driver": args.kind}
    if args.hsa is not None:
        keys["hsa"] = args.hsa
    if args.gap is not None:
        keys["gap"] = args.gap
    if args.cycle_ms:
        keys["cycle_ms"] = args.cycle_ms
    events: list[tuple[str, int, str]] = []
    bus = open_bus(
        port=args.port,
        baud=args.baud,
        address=args.address,
        slaves=tables,
        on_event=lambda event: events.append((type(event).__name__, event.t_ns, event.text)),
        **keys,
    )
    async with contextlib.AsyncExitStack() as stack:
        if args.control:
            from dpstack.api.control.handlers import control_run

            await stack.enter_async_context(control_run(bus, args.port))
        await stack.enter_async_context(bus)
        await bus.operate()
        await bus.ready(timeout=_PATIENCE_NS / 1e9)
        ready = monotonic_ns()
        if args.connectors:
            _publish_by_signals(bus, json.loads(args.connectors), events)
            writing = asyncio.create_task(_write(bus))
            stack.callback(writing.cancel)
        if args.cycle_ms:
            asyncio.get_running_loop().add_signal_handler(signal.SIGHUP, lambda: _tell_cycles(bus))
        due = await _due_time(bus) if args.cycle_ms else 0
        told(port=args.port, ready=ready, events=events, due=due)
        events.clear()
        reading = [asyncio.create_task(_read(slave, args.records)) for slave in bus.slaves if args.records]
        held_up = await application(args.app, ended)
        failed = [task.exception() for task in reading if task.done()]
        for task in reading:
            task.cancel()
        states = {slave.name: slave.state.value for slave in bus.slaves}
        end, counted = monotonic_ns(), bus.stats
    lost = {name: state for name, state in states.items() if state != "data_exchange"}
    if lost or failed:
        told(
            lost=lost,
            failed=[str(error) for error in failed],
            ready=ready,
            end=end,
            events=[event for event in events if event[1] <= end],
            held_up=held_up,
            host_us=counted.host_us,
            asked={s.name: (s.link.requests, s.retries, s.timeouts, s.link.late) for s in counted.slaves.values()},
        )


def _named(way: str) -> dict[str, object]:
    return {f"{way}_level": {"at": "i16@0", "scale": 0.1, "unit": "bar"}, f"{way}_open": "bool@4.0"}


async def _due_time(bus: Any) -> int:
    """A due time of the fixed cycle, CLOCK_MONOTONIC in ns: all others are whole cycles away."""
    cycle = await anext(aiter(bus.cycles()))
    return int(cycle.t_ns - cycle.late_ns)


def _tell_cycles(bus: Any) -> None:
    """At SIGHUP: the fixed cycles that began, those of them that were late, those that were left out; and the late and
    missed ones after a round that was not over in time, for instance because the other end of the line was late."""
    book = bus.stats.cycles
    told(
        cycles=(
            book.begun,
            book.begun_late,
            book.left_out,
            sum(count for reason, count in book.reasons.items() if reason.value == "overrun"),
        )
    )


async def _read(slave: Any, octets: int) -> None:
    while True:
        await slave.read(1, 1, octets)


async def _write(bus: Any) -> None:
    """New outputs every tenth of a second, with and without connectors; the slaves of the wire copy them to their
    inputs."""
    for number in itertools.cycle(range(1000)):
        for slave in bus.slaves:
            slave["out_level"] = number / 10
        await asyncio.sleep(_WRITE_S)


async def application(kind: str, ended: Ended) -> list[tuple[int, int]]:
    """The rest of the program, until the end. Returns the longest time (ns) for which it was held up, and when."""
    if kind == "burn":
        threading.Thread(target=_burn, args=(ended,), daemon=True).start()
    held_up: list[tuple[int, int]] = []
    turn = 0
    while not ended.is_set():
        due = monotonic_ns() + _TURN_NS
        await asyncio.sleep(_TURN_NS / 1e9)
        late = monotonic_ns() - due
        if late > _HELD_UP_NS:
            held_up = sorted((*held_up, (due, late)), key=lambda t: -t[1])[:_LONGEST]
        turn += 1
        if kind == "block" and turn % round(_BLOCK_EVERY_S * 1e9 / _TURN_NS) == 0:
            # shorter than any watchdog: whatever after_stall says, the bus stays in Operate
            time.sleep(_BLOCK_S)  # noqa: ASYNC251 - an application that blocks is what is measured
    return held_up


def _burn(ended: Ended) -> None:
    number = 1
    while not ended.is_set():
        number = number * 1_103_515_245 % 2_147_483_647


def _publish_by_signals(bus: Any, tables: dict[str, Any], events: list[tuple[str, int, str]]) -> None:
    """SIGUSR1 begins the connectors of ``tables``, SIGUSR2 ends them; a line says when that is done, with the remarks
    of the connectors that have come among ``events`` meanwhile."""
    from dpstack import publish

    loop = asyncio.get_running_loop()
    ends: list[asyncio.Event] = []
    tasks: set[asyncio.Task[None]] = set()

    async def published(end: asyncio.Event) -> None:
        async with publish(bus, **tables) as publishing:
            while len(publishing.connectors) < len(tables):  # noqa: ASYNC110  they tell nobody
                await asyncio.sleep(_LOOK_S)
            told(connectors=publishing.connectors)
            await end.wait()
        told(
            connectors=(),
            remarks=[text for name, _, text in events if name == "Notice" and text.startswith("connectors: ")],
        )
        events.clear()

    def begin() -> None:
        ends.append(asyncio.Event())
        task = loop.create_task(published(ends[-1]))
        tasks.add(task)
        task.add_done_callback(tasks.discard)

    def end() -> None:
        while ends:
            ends.pop().set()

    loop.add_signal_handler(signal.SIGUSR1, begin)
    loop.add_signal_handler(signal.SIGUSR2, end)


def grid_application(args: argparse.Namespace, ended: Ended) -> None:
    """The same program without a bus: a bare loop sleeps on the grid in a process of its own; with a port it exchanges
    data there."""
    words = [sys.executable, "-m", "bench.grid_loop", str(args.cycle_ms)]
    if args.port != NO_PORT:
        words += [args.port, str(args.baud), str(args.slaves)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as loop:
        told(ready=monotonic_ns())
        asyncio.run(application(args.app, ended))
        found, _ = loop.communicate()
    sys.stdout.write(found)
    sys.stdout.flush()


# --- octets only ---


def sd2(to: int, fc: int, data: bytes, saps: bytes = b"", own: int = OWN) -> bytes:
    """An SD2 telegram of the station ``own``; ``saps``: DSAP, SSAP."""
    mark = 0x80 if saps else 0
    body = bytes((to | mark, own | mark, fc)) + saps + data
    return bytes((0x68, len(body), len(body), 0x68)) + body + bytes((sum(body) & 0xFF, 0x16))


def bare_master(args: argparse.Namespace, ended: Ended) -> None:
    """Write a request, read its answer; on a paced wire the idle times of the rules and the token, nothing else."""
    fd = os.open(args.port, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(fd)
    rounds = bare_bring_up(fd, range(FIRST, FIRST + args.slaves))
    told(ready=monotonic_ns())
    turn = 0
    while not ended.is_set():
        exchange_round(fd, rounds[turn], args.baud, args.t_id1)
        turn ^= 1


def exchange_round(fd: int, requests: Sequence[bytes], baud: int, t_id1: int) -> None:
    """Each request and its answer; with ``t_id1`` (bit times) the idle times of the rules, and the token at the end."""
    write, read, clock = os.write, os.read, monotonic_ns
    bit = 1e9 / baud
    idle = round(t_id1 * bit)
    for request in requests:
        write(fd, request)
        got = len(read(fd, 100))
        while got < 9 + OCTETS:
            got += len(read(fd, 100))
        if idle:
            until = clock() + idle
            while clock() < until:
                pass
    if idle:
        write(fd, _TOKEN)
        until = clock() + round(33 * bit) + idle
        while clock() < until:
            pass


def bare_bring_up(fd: int, addresses: Sequence[int], own: int = OWN) -> list[list[bytes]]:
    """Returns the Data_Exchange requests of two rounds, which take turns (FCB). Raises RuntimeError when a slave
    refuses."""
    prm = bytes((0x80, 1, 1, 11)) + IDENT.to_bytes(2, "big") + bytes(1)
    for address in addresses:
        bare_exchange(fd, sd2(address, 0x6D, prm, bytes((61, 62)), own), 1)
        bare_exchange(fd, sd2(address, 0x5D, CONFIG, bytes((62, 62)), own), 1)
        bare_exchange(fd, sd2(address, 0x7D, bytes(OCTETS), own=own), 9 + OCTETS)
    return [[sd2(address, fc, bytes(OCTETS), own=own) for address in addresses] for fc in (0x5D, 0x7D)]


def bare_ring_master(args: argparse.Namespace, ended: Ended) -> None:
    """Wait for the token from the other one, exchange data with every slave, wait T_ID1 before each telegram, pass the
    token on; nothing else. The one with the lower address begins. Raises RuntimeError when a slave does not come up."""
    fd = os.open(args.port, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(fd)
    termios.tcflush(fd, termios.TCIOFLUSH)
    own, other = args.address, args.other
    mine, theirs = bytes((0xDC, own, other)), bytes((0xDC, other, own))
    idle = round(args.t_id1 * 1e9 / args.baud)
    addresses = range(args.first, args.first + args.slaves)
    write, read, clock, ready = os.write, os.read, monotonic_ns, select.select

    def wait_for(octets: int, end: bytes, patience: float) -> bool:
        """So many octets, or more that end so; then the idle time."""
        got = b""
        while len(got) < octets or not got.endswith(end):
            if not ready((fd,), (), (), patience)[0]:
                return False
            got = (got + read(fd, 500))[-500:]
        until = clock() + idle
        while clock() < until:
            pass
        return True

    told(listens=True)
    if own > other and not wait_for(3, mine, _PATIENCE_NS / 1e9):
        raise RuntimeError("no token came")
    rounds = bare_bring_up(fd, addresses, own)
    told(ready=monotonic_ns())
    turn = 0
    patience = 10.0  # the other one brings its slaves up at its first token
    while not ended.is_set():
        write(fd, theirs)
        while not wait_for(3, mine, patience) and not ended.is_set():
            write(fd, theirs)  # lost: once more
        patience = _RING_PATIENCE_S
        for request in rounds[turn]:
            write(fd, request)
            if not wait_for(9 + OCTETS, b"\x16", patience):
                break  # lost: the next one
        turn ^= 1


def bare_exchange(fd: int, request: bytes, octets: int) -> None:
    """One request and its answer of so many octets. Raises RuntimeError when it is another one."""
    os.write(fd, request)
    got = b""
    while len(got) < octets and select.select((fd,), (), (), 5)[0]:
        got += os.read(fd, 100)
        if len(got) >= 6 and got[0] != 0x68:  # RS, which is shorter than what was asked for
            break
    if len(got) != octets:
        raise RuntimeError(f"the wire's slaves refuse: {got.hex(' ') or 'no answer'} to {request.hex(' ')}")
    time.sleep(0.005)


# --- pyprofibus ---


def pyprofibus_master(args: argparse.Namespace, ended: Ended) -> None:
    """Its class 1 master on its serial PHY, run as its documentation shows, except that slaves are added one by one.

    pyprofibus 1.13 takes a short acknowledgement for that of every slave that waits. So of slaves that come up together
    some get no Chk_Cfg, and begin again together a second later, without end if nothing disturbs their rhythm.
    """
    from types import SimpleNamespace

    from pyprofibus.dp import DpCfgDataElement
    from pyprofibus.dp_master import DPM1, DpSlaveDesc
    from pyprofibus.phy_serial import CpPhySerial

    output = bytes(OCTETS)

    def turn() -> None:
        served = master.run()
        if served is not None:
            served.getMasterInData()
            served.setMasterOutData(output)

    with contextlib.redirect_stdout(sys.stderr):
        phy = CpPhySerial(port=args.port)
        phy.setConfig(baudrate=args.baud)
        master = DPM1(phy=phy, masterAddr=OWN)
        master.initialize()
        gsd = SimpleNamespace(getIdentNumber=lambda: IDENT)
        give_up = monotonic_ns() + _PATIENCE_NS
        for n in range(args.slaves):
            # its words are the slave's: input is what the slave takes in
            conf = SimpleNamespace(
                gsd=gsd, addr=FIRST + n, name=f"s{n}", index=n, inputSize=OCTETS, outputSize=OCTETS, diagPeriod=0
            )
            slave = DpSlaveDesc(conf)
            slave.setCfgDataElements([DpCfgDataElement(octet) for octet in CONFIG])
            slave.setWatchdog(1000)
            master.addSlave(slave)
            slave.setMasterOutData(output)
            while not all(slave.isConnected() for slave in master.getSlaveList()):
                turn()
                if monotonic_ns() > give_up or ended.is_set():
                    raise RuntimeError(f"not all slaves came up within {_PATIENCE_NS // 1_000_000_000} s")
    told(ready=monotonic_ns())
    with contextlib.redirect_stdout(sys.stderr):
        while not ended.is_set():
            turn()
        master.destroy()


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("kind", choices=(*KINDS, RING_KIND, GRID_KIND, PROFIRUST))
    parser.add_argument("port")
    parser.add_argument("--baud", type=int, required=True)
    parser.add_argument("--slaves", type=int, default=1)
    parser.add_argument("--address", type=int, default=OWN)
    parser.add_argument("--first", type=int, default=FIRST, help="address of the first slave")
    parser.add_argument("--hsa", type=int)
    parser.add_argument("--other", type=int, default=0, help="the other master of two bare loops")
    parser.add_argument("--gap", type=int)
    parser.add_argument("--cycle-ms", type=float)
    parser.add_argument("--records", type=int, default=0, help="octets of the records read without end, 0: none")
    parser.add_argument("--t-id1", type=int, default=0, help="of the bare loop, in bit times; 0: without any pause")
    parser.add_argument(
        "--connectors", metavar="JSON", help="tables of connectors, which publish from SIGUSR1 to SIGUSR2"
    )
    parser.add_argument("--control", action="store_true", help="with a control socket")
    parser.add_argument("--app", choices=APPLICATIONS, default="idle")
    parser.add_argument("--program", help="of profirust")
    parser.add_argument("--sleep-us", help="of profirust, between two polls")
    args = parser.parse_args()
    ended = Ended()
    ended.watch()
    try:
        match args.kind:
            case "bare":
                bare_master(args, ended)
            case "bare-ring":
                bare_ring_master(args, ended)
            case "grid":
                grid_application(args, ended)
            case "profirust":
                os.execv(args.program, (args.program, args.port, str(args.slaves), args.sleep_us))
            case "pyprofibus":
                pyprofibus_master(args, ended)
            case _:
                asyncio.run(dpstack_master(args, ended))
    except Exception as error:
        told(error=f"{type(error).__name__}: {error}")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
