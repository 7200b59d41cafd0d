"""An edge node with store and forward in virtual time: a wire that loses what was not delivered, a real file, and a
host that knows only the specification. A counter of the plant shows what has arrived."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

from edge_node_rig import Rig

from dpstack.bridge.mqtt.edge_node import EdgeNode
from dpstack.bridge.mqtt.history import CHUNK, EARLIEST_MS, Entry, History
from dpstack.bridge.mqtt.history_file import HistoryFile
from dpstack.bridge.mqtt.payload import DataType
from dpstack.bridge.mqtt.plant_node import NodeOptions, Publish
from dpstack.bridge.mqtt.session_file import SessionFile
from dpstack.plant.quality import Reason
from dpstack.plant.tree import PlantTree

#: a folder in memory where there is one: the file writes to the disk each time
MEMORY: Final = "/dev/shm" if os.path.isdir("/dev/shm") else None
COUNTER: Final = {"name": "number", "type": "u32", "at": "u32@4"}

MB: Final = 1_000_000
OFFSET: Final = EARLIEST_MS + 10**11


def entry(
    number: int, *, device: str | None = "valves", at_ms: int | None = None, offset_ms: int = OFFSET, note: str = ""
) -> Entry:
    at = number * 10 if at_ms is None else at_ms
    return Entry(device, "Inputs/number", DataType.UINT64, "bar", at, offset_ms, number, Reason.GOOD, note)


class HistoryRig(Rig):
    """``given``: the numbers that the gateway saw; ``arrived``: those that the host got; ``excused``: those that a
    SIGKILL may have cost. ``held``: the clock, since the start of the computer, at which the plant had a number first
    and last, by number and start; ``offsets``: the offset of the clock at the end of each start."""

    def __init__(self, folder: Path, *, store: int = 10_000_000, memory: int = 20_000, primary_host: str = "") -> None:
        self.store, self.memory = store, memory
        self.boot = 1
        #: messages with the offset of the clock at their time
        self.wire: list[tuple[Publish, float]] = []
        self.given: set[int] = set()
        self.arrived: set[int] = set()
        self.held: dict[tuple[int, int], tuple[float, float]] = {}
        self.offsets: dict[int, float] = {}
        self.unsafe: set[int] = set()
        self.excused: set[int] = set()
        self.dropped = 0
        self.history: History | None = None
        self.file: HistoryFile | None = None
        self.aliases: dict[int, str] = {}
        super().__init__(folder, primary_host=primary_host, interval_s=0.0)
        self.plant["slaves"]["8"]["inputs"].append(COUNTER)
        self.values["8"]["fields"]["number"] = 0

    # --- the gateway ----------------------------------------------------------------------------------------------

    def start(self) -> None:
        if self.numbers is not None:
            self.numbers.close()
        if self.file is not None:
            self.file.close()
        if self.history is not None:
            self.dropped += self.history.dropped
        self.numbers = SessionFile(self.folder)
        self.file = HistoryFile(self.folder, self.store, f"boot {self.boot}")
        self.history = History(self.memory)
        self.tree = PlantTree()
        self.node = EdgeNode(self.setup, self.tree, NodeOptions(tell=self.told.append, history=self.history))

    def close(self) -> None:
        super().close()
        assert self.file is not None
        self.file.close()

    def kill(self) -> None:
        """SIGKILL: memory is gone; the stream of the next process has a beginning of its own."""
        self.excused |= self.unsafe
        self.unsafe.clear()
        self.connection = None
        self.wire.clear()
        self.plant["started"] = self.wall
        self.stream, self.stream_offset = 0.0, self.offset
        self.start()
        self.give_plant()

    def reboot(self, *, off_s: float, wall: float | None) -> None:
        """The computer is off for a while. ``wall``: its clock then, None: it went on."""
        now = self.wall + off_s if wall is None else wall
        self.offsets[self.boot] = self.offset
        self.clock, self.boot = 5.0, self.boot + 1
        self.offset = now - self.clock
        self.kill()

    def count(self) -> None:
        """The plant counts, and the gateway sees it."""
        self.clock += 0.25
        self.stream += 0.25
        number = self.values["8"]["fields"]["number"] = self.values["8"]["fields"]["number"] + 1
        if self.values["8"]["state"] == "data_exchange":
            self.given.add(number)
            self.unsafe.add(number)
        self.give_values()

    def give_values(self) -> None:
        super().give_values()
        held = self.values["8"]["fields"].get("number", 0), self.boot
        self.held[held] = self.held.get(held, (self.clock, 0.0))[0], self.clock

    def step_disk(self) -> None:
        """The work of the thread."""
        history, file = self.history, self.file
        assert history is not None
        assert file is not None
        while new := history.take_new():
            file.append(new, history.offset_ms)
            history.stored()
        if file.count:
            file.append((), history.offset_ms)
        file.delete(history.take_done())
        without = history.take_read_request()
        if without is not None:
            history.give(file.read(CHUNK, without))
        history.displaced += file.displaced
        file.displaced = 0
        pending = any(owner.pending for owner in self.node._owners())
        if self.connection is None or not (history.is_unconfirmed or history.waiting or pending):
            self.unsafe.clear()

    # --- the network ----------------------------------------------------------------------------------------------

    def send(self, message: Publish) -> None:
        self.wire.append((message, self.offset))

    def leave(self) -> None:
        self.deliver()
        super().leave()

    def deliver(self, most: int = 1_000_000) -> None:
        for message, offset in self.wire[:most]:
            super().send(message)
            self._look(offset)
        del self.wire[:most]

    def cut(self) -> None:
        self.wire.clear()
        super().cut()

    def round_trip(self, *, comes_back: bool = True) -> None:
        if self.connection is None:
            return
        number = self.begin_round()
        if comes_back:
            self.end_round(number)
        else:
            self.deliver()

    def begin_round(self) -> int:
        """The request is on the wire behind what was sent."""
        assert self.history is not None
        self._before_request = len(self.wire)
        return self.history.begin_round()

    def end_round(self, number: int) -> None:
        """The broker has read what came before the request, and nothing else is known."""
        assert self.history is not None
        self.deliver(self._before_request)
        self.history.confirm(number)

    def settle(self) -> None:
        """All is delivered: history goes out with its pace."""
        for _ in range(40):
            if self.connection is None:
                self.connect()
            self.pump()
            self.round_trip()
            self.step_disk()
            was_lost = self.values["8"]["state"] != "data_exchange"
            self.values["8"]["state"] = "data_exchange"
            self.wait(0.1)
            assert self.history is not None
            assert self.file is not None
            if not (was_lost or self.history.is_unconfirmed or self.history.waiting or self.file.count):
                break

    # --- the host ---------------------------------------------------------------------------------------------------

    def _look(self, offset: float) -> None:
        """Note the numbers that have arrived; history is in order, and behind the births."""
        kind, device, payload = self.host.messages[-1]
        if device != "valves":
            return
        before = 0.0
        if kind == "DBIRTH":
            self.alias_of_number = self.host.alias("Inputs/number", "valves")
        for metric in payload.metrics:
            if metric.alias != self.alias_of_number or metric.null:
                continue
            number, time = metric.value(8), (metric.timestamp or 0) / 1000
            self.arrived.add(number)
            if metric.historical:
                assert time >= before
                before = time
                # of which start it is, the host cannot know; a jump of the clock of up to 1 s is none
                times = {
                    boot: (time - self.offsets.get(boot, offset), first, last)
                    for (one, boot), (first, last) in self.held.items()
                    if one == number
                }
                # nothing is of the future, where the clock was set back after a restart
                is_now = metric.timestamp == payload.timestamp
                found = any(first - 1.2 < at < last + 1.2 for at, first, last in times.values())
                assert found or is_now, (number, times)

    alias_of_number = -1
    _before_request = 0

    def check_numbers(self) -> None:
        """Each number has arrived, or is counted as dropped, or was in the memory of a process that was killed."""
        assert self.history is not None
        missing = self.given - self.arrived - self.excused
        assert len(missing) <= self.dropped + self.history.dropped, (sorted(missing), self.history.losses)
