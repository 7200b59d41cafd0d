"""What listening costs a telegram: cutting, counting, writing and reading pcapng, ``decode --json``, ``monitor FILE``.

The telegrams are those of a realistic bus in virtual time: bring-up, cyclic exchange, diagnosis, DP-V1, an absent
slave. Each figure is CPU time as a multiple of the codec's decode of the same telegrams in the same round. The share of
a processor is what a full bus at 12 Mbit/s needs while it is listened to.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
import zipfile
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from functools import partial
from pathlib import Path
from typing import Final

from bench.acyclic_plant import Answers, RecordDevice, setups
from bench.calibration import Beside
from bench.options import count
from bench.report import Report
from dpstack.capture.cutter import Cutter
from dpstack.capture.listener import Listener
from dpstack.capture.pcapng import Writer
from dpstack.capture.recording import PortAbout, Recording
from dpstack.capture.timing import TAP
from dpstack.capture.transmission import Transmission
from dpstack.cli.main import main
from dpstack.decode.source import read_transmissions
from dpstack.dp.master.commands import Mode, SetMode
from dpstack.dp.master.master import Master
from dpstack.dp.master.settings import MasterSettings
from dpstack.dp.slave.application import SlaveApp
from dpstack.dpv1.master.orders import RecordOrder
from dpstack.dpv1.pdu.read_write import Function
from dpstack.drivers.stack import acyclic_services
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.codec import decode
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.passive.station import PassiveStation
from dpstack.monitor.counters import Counters
from dpstack.params import BusParams
from dpstack.phy.uart import waveform
from dpstack.sim.world import World
from dpstack.trace import WireEntry
from dpstack.units import NS_PER_MS, NS_PER_S, chars_to_ns

_BAUD: Final = 12_000_000
_EPOCH_NS: Final = 1_790_000_000 * NS_PER_S
_SLAVES: Final = 8
_OWN: Final = 2
#: so often one slave in turn has a new diagnosis and is asked for a record
_EVENT_NS: Final = 5 * NS_PER_MS
#: a channel related block: module 1, channel 1, short circuit
_FAULT: Final = bytes((0x81, 0xC1, 0x21))
#: octets of the record; its index is its length
_RECORD: Final = 64
#: samples of a bit in a waveform
_SAMPLES: Final = 8
#: an adapter on USB delivers the octets of so much time together
_BATCH_NS: Final = NS_PER_MS
#: at most so many times the codec's decode of the same telegrams
_GOALS: Final = {"writing pcapng": 1.5, "monitor FILE": 8.0, "decode --json FILE": 25.0}

#: octets and the time at which they arrive
Chunk = tuple[bytes, int]


class _Faulty(RecordDevice):
    """A mirror of PPO1 with records, and with a fault now and then."""

    ext = b""

    def ext_diag(self) -> bytes:
        return self.ext


def traffic(count: int, baud: int = _BAUD) -> list[Transmission]:
    """The first ``count`` transmissions of a bus with one master and eight slaves, of which one is absent."""
    heard: list[Transmission] = []

    def add(entry: WireEntry) -> None:
        heard.append(Transmission(entry.octets, entry.start_ns + _EPOCH_NS, baud))

    world = World(referee=False)
    world.log.listener = add
    params = BusParams.preset(baud, address=_OWN)
    planned = setups(_SLAVES)
    devices = {slave.address: _Faulty(Answers.POLLED) for slave in planned[:-1]}
    for address, device in devices.items():
        world.add(PassiveStation(address, SlaveApp(device, address=address), params))
    master = Master(params, planned, MasterSettings(watchdog_ms=2_000))
    station = ActiveStation(params, [master, acyclic_services(_OWN, master)], window=master.window)
    world.add(station)
    world.command(station, GoOnline())
    world.command(station, SetMode(Mode.OPERATE))
    order = 0
    while len(heard) < count:
        world.run_for(_EVENT_NS)
        order += 1
        address = planned[order % len(devices)].address
        devices[address].ext = b"" if devices[address].ext else _FAULT
        world.command(station, RecordOrder(order, Function.READ, 1, _RECORD, _RECORD, address=address))
    return heard[:count]


def chunks(heard: Sequence[Transmission], batch_ns: int = 0) -> list[Chunk]:
    """The octets as they arrive: each transmission at its end, or all of ``batch_ns`` together."""
    found: list[Chunk] = []
    held = bytearray()
    due = 0
    for one in heard:
        end = (one.t_ns or 0) + chars_to_ns(len(one.octets), one.baud)
        if batch_ns and held and end > due:
            found.append((bytes(held), due))
            held.clear()
        if not held:
            due = -(-end // batch_ns) * batch_ns if batch_ns else end
        held += one.octets
        if not batch_ns:
            found.append((bytes(held), due))
            held.clear()
    if held:
        found.append((bytes(held), due))
    return found


class Work:
    """The measured tasks: each handles all of ``heard`` once."""

    def __init__(self, heard: list[Transmission], folder: Path) -> None:
        self.heard = heard
        self.path = folder / "bus.pcapng"
        self.session = folder / "bus.sr"
        self.write()
        self.record()
        single, batches = chunks(heard), chunks(heard, _BATCH_NS)
        self.tasks: dict[str, Callable[[], object]] = {
            "writing pcapng": self.write,
            "reading pcapng": self.read,
            "counting": self.count,
            "reading pcapng and counting": self.read_and_count,
            "monitor FILE": partial(self.command, "monitor", str(self.path), "--json"),
            "decode --json FILE": partial(self.command, "decode", str(self.path), "--json"),
            "reading a waveform": self.read_waveform,
            "cutting, a telegram a chunk": partial(self.cut, single),
            "cutting, chunks of 1 ms": partial(self.cut, batches),
        }
        self.live: dict[str, Callable[[], object]] = {
            "a telegram a chunk": partial(self.listen, single),
            "chunks of 1 ms": partial(self.listen, batches),
        }

    def decode(self) -> None:
        """The measure of all: the codec's decode."""
        for one in self.heard:
            decode(one.octets)

    def write(self) -> None:
        with self.path.open("wb") as file:
            writer = Writer(file, "bench")
            port = writer.interface("bench", _BAUD, "")
            for octets, t_ns, *_ in self.heard:
                writer.packet(port, t_ns or 0, octets)

    def read(self) -> int:
        with self.path.open("rb") as file:
            return sum(1 for _ in read_transmissions(file, "bench"))

    def record(self) -> None:
        """The bus as a logic analyser records it, in a session file of sigrok."""
        silence = b"1" * (_SAMPLES * 100)
        parts = [waveform(one.octets) for one in self.heard]
        rows = [bytes(level for level in part for _ in range(_SAMPLES)) for part in parts]
        samples = silence + silence.join(rows) + silence
        with zipfile.ZipFile(self.session, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("version", "2")
            rate = f"samplerate={_SAMPLES * _BAUD} Hz"
            archive.writestr("metadata", f"[device 1]\ncapturefile=logic-1\n{rate}\nprobe1=D0\nunitsize=1\n")
            archive.writestr("logic-1-1", samples)

    def read_waveform(self) -> int:
        with self.session.open("rb") as file:
            return sum(1 for _ in read_transmissions(file, "bench"))

    def count(self) -> Counters:
        counters = Counters()
        for one in self.heard:
            counters.add(one)
        return counters

    def read_and_count(self) -> Counters:
        counters = Counters()
        with self.path.open("rb") as file:
            for one in read_transmissions(file, "bench"):
                counters.add(one)
        return counters

    def command(self, *words: str) -> None:
        """A command of ``dpstack``, whose output goes nowhere."""
        with Path(os.devnull).open("w", encoding="utf-8") as nowhere, redirect_stdout(nowhere):
            code = main(words)
        if code not in (0, 1):  # monitor: the verdict is critical
            raise RuntimeError(f"dpstack {' '.join(words)} ended with {code}")

    def cut(self, arrived: Sequence[Chunk]) -> int:
        cutter = Cutter(_BAUD, NS_PER_MS)
        return sum(len(cutter.feed(octets, now)) for octets, now in arrived)

    def listen(self, arrived: Sequence[Chunk]) -> Counters:
        """Listen, count and write, as ``monitor`` and ``capture --write`` together."""
        counters = Counters()
        with self.path.with_name("live.pcapng").open("wb") as file:
            recording = Recording(file, "bench", PortAbout("bench", TAP, paced=True))

            def add(one: Transmission) -> None:
                counters.add(one)
                recording.add(one)

            listener = Listener(0, add, baud=_BAUD, epoch_ns=_EPOCH_NS)
            for octets, now in arrived:
                listener.receive(octets, now - _EPOCH_NS)
        return counters


def run(argv: Sequence[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench listen")
    parser.add_argument("--telegrams", type=int, default=20_000)
    parser.add_argument("--rounds", type=count, default=9, help="interleaved")
    args = parser.parse_args(argv)
    report = Report("listen")
    heard = traffic(args.telegrams)
    with tempfile.TemporaryDirectory() as folder:
        work = Work(heard, Path(folder))
        tasks = {**work.tasks, **work.live}
        for task in tasks.values():  # imports and caches
            task()
        beside = Beside()
        base: list[tuple[float, float]] = []
        times: dict[str, list[float]] = {name: [] for name in tasks}
        for _ in range(args.rounds):
            base.append(beside(partial(_cpu_ns, work.decode, len(heard))))
            for name, task in tasks.items():
                times[name].append(_cpu_ns(task, len(heard)))
    report.calibrated("Python", beside.loops)
    report.in_loops("the codec's decode of a telegram", base)
    for name in work.tasks:
        ratios = [ns / decoding for ns, (decoding, _) in zip(times[name], base, strict=True)]
        report.measured(f"{name}, to the codec's decode", ratios, "", _GOALS.get(name))
    rate = per_second(heard)
    report.exact(f"a full bus at {_BAUD // 1_000_000} Mbit/s", rate, "telegrams/s", more=True)
    for name in work.live:
        share = [ns * rate / NS_PER_S * 100 for ns in times[name]]
        report.measured(f"a full bus heard, counted and written, {name}: share of a processor", share, "%")
    return report


def per_second(heard: Sequence[Transmission]) -> float:
    """Transmissions per second of the bus, once it is in data exchange: of the second half."""
    late = heard[len(heard) // 2 :]
    return (len(late) - 1) * NS_PER_S / ((late[-1].t_ns or 0) - (late[0].t_ns or 0))


def _cpu_ns(work: Callable[[], object], count: int) -> float:
    """CPU time of ``work`` per telegram in ns."""
    begin = time.process_time_ns()
    work()
    return max(1, time.process_time_ns() - begin) / count
