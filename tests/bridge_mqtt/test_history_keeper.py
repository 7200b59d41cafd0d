"""Values that could not be delivered on their way between memory and disk: a disk that is full, damaged, read-only or
slow delays nobody, is told, and is tried again."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from far_ends import beside
from history_rig import OFFSET, entry

from dpstack.bridge.mqtt import history_keeper
from dpstack.bridge.mqtt.history import Entry, History
from dpstack.bridge.mqtt.history_file import NAME, HistoryError, HistoryFile
from dpstack.bridge.mqtt.history_keeper import HistoryKeeper
from dpstack.bridge.mqtt.payload import DataType, MetricKind
from dpstack.plant.quality import Value
from dpstack.trace import Severity

NOW = OFFSET + 10**9
KIND = MetricKind("Inputs/number", 7, DataType.UINT64)


@pytest.fixture(autouse=True)
def _threads_end() -> Iterator[None]:
    """The keeper waits for no disk, so its thread may have the file open for a moment more: not in the next test."""
    yield
    for thread in threading.enumerate():
        if thread.name == "dpstack mqtt: history":
            thread.join(30)
            assert not thread.is_alive()


class Bench:
    def __init__(self, folder: Path, *, most: int = 20_000) -> None:
        self.folder = folder
        self.told: list[str] = []
        self.has_told = asyncio.Event()
        self.history = History(most)
        self.has_stored = asyncio.Event()
        self.keeper = HistoryKeeper(self.history, folder, 1, self.tell, self.has_stored.set, retry_s=0.0)

    def tell(self, text: str, severity: Severity) -> None:
        self.told.append(text.replace(str(self.folder), "FOLDER"))
        self.has_told.set()

    async def until_told(self, count: int) -> None:
        async with asyncio.timeout(10):
            while len(self.told) < count:
                self.has_told.clear()
                await self.has_told.wait()

    def keep(self, first: int, last: int) -> None:
        for number in range(first, last + 1):
            self.history.keep(entry(number))

    def historical(self, clock: float) -> list[Value]:
        """The values of the next message with history."""
        found = self.history.next_samples(lambda _: KIND, list, NOW, OFFSET, clock)
        assert found is not None
        return [sample.reading.value for sample in found[1]]

    def stored(self) -> list[Value]:
        file = HistoryFile(self.folder, 1_000_000, "a")
        found = [kept.entry.value for kept in file.read(100_000)]
        file.close()
        return found


@contextmanager
def failing(monkeypatch: pytest.MonkeyPatch, name: str, error: Exception) -> Iterator[None]:
    """A method of the file raises."""

    def fail(*_: object) -> None:
        raise error

    with monkeypatch.context() as patch:
        patch.setattr(HistoryFile, name, fail)
        yield


def no_entry(entry: Entry) -> MetricKind:
    raise AssertionError(entry)


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


async def closed(bench: Bench) -> None:
    """The file is closed: another one may be opened."""
    assert bench.keeper._file is not None
    await bench.keeper._call(bench.keeper._file.close)
    bench.keeper.close()


async def test_a_full_disk_is_told_once_and_what_memory_holds_comes_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(tmp_path, most=10)
    with failing(monkeypatch, "append", HistoryError("database or disk is full")):
        for number in range(1, 20):
            bench.keep(number, number)
            await bench.keeper.step()
    await bench.keeper.step()
    await closed(bench)
    assert bench.told[0] == (
        "values that cannot be delivered are not kept on the disk, as FOLDER/history.sqlite cannot be used: database "
        "or disk is full; it is tried again every 0 s"
    )
    assert bench.told[1] == (
        "1 values that could not be delivered are lost: 1 more than fit in memory while the disk could not take them"
    )
    assert bench.told[2:] == ["values that cannot be delivered are kept again in FOLDER/history.sqlite"]
    assert bench.stored() == list(range(10, 20))
    assert bench.history.dropped == 9


async def test_a_damaged_file_is_moved_aside_and_a_new_one_begins(tmp_path: Path) -> None:
    (tmp_path / NAME).write_bytes(b"SQLite format 3\x00 and so on" * 100)
    bench = Bench(tmp_path)
    bench.keep(1, 3)
    await bench.keeper.step()
    await bench.keeper.step()
    await closed(bench)
    assert bench.told == [
        "FOLDER/history.sqlite cannot be read (file is not a database): it is history.damaged-1.sqlite now, its values "
        "are not sent; a new one begins"
    ]
    assert (tmp_path / "history.damaged-1.sqlite").read_bytes().startswith(b"SQLite format 3\x00 and")
    assert bench.stored() == [1, 2, 3]


async def test_a_fault_of_the_program_in_the_thread_ends_nothing(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    await bench.keeper.step()

    bench.history.next_samples(no_entry, tuple, NOW, OFFSET, 0.0)
    with failing(monkeypatch, "read", KeyError("something")):
        bench.keep(1, 1)
        await bench.keeper.step()
    assert "KeyError" in bench.told[0]
    await bench.keeper.step()
    await closed(bench)


async def test_a_disk_that_could_not_be_read_once_is_read_again(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    bench.keep(1, 3)
    await bench.keeper.step()

    bench.history.next_samples(no_entry, tuple, NOW, OFFSET, 0.0)
    with failing(monkeypatch, "read", HistoryError("disk I/O error")):
        await bench.keeper.step()
    assert bench.history.next_samples(no_entry, tuple, NOW, OFFSET, 1.0) is None
    await bench.keeper.step()
    assert bench.historical(2.0) == [1, 2, 3]
    await closed(bench)


async def test_a_device_that_is_born_while_the_disk_is_read_without_it_gets_its_history(bench: Bench) -> None:
    bench.keep(1, 3)
    await bench.keeper.step()
    history = bench.history
    history.session_began()
    history.next_samples(no_entry, lambda: ["valves"], NOW, OFFSET, 0.0)
    reading = asyncio.create_task(bench.keeper.step())
    await asyncio.sleep(0)
    assert not history.needs_disk  # the thread has it
    history.look_again()
    await reading
    history.next_samples(no_entry, list, NOW, OFFSET, 1.0)
    await bench.keeper.step()
    assert bench.historical(2.0) == [1, 2, 3]
    await closed(bench)


async def test_a_slow_disk_delays_nobody_and_the_end_takes_no_longer_than_its_limit(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    await bench.keeper.step()
    begun, answers, loop = asyncio.Event(), threading.Event(), asyncio.get_running_loop()

    def append(*_: object) -> None:
        loop.call_soon_threadsafe(begun.set)
        assert answers.wait(30)

    monkeypatch.setattr(HistoryFile, "append", append)
    monkeypatch.setattr(history_keeper, "PERIOD_S", 0.001)
    async with asyncio.timeout(10):
        async with beside(bench.keeper.serve()):
            bench.keep(1, 3)
            await begun.wait()
            assert not bench.has_stored.is_set()  # the disk is at work, and this task has its turn
            answers.set()
            await bench.has_stored.wait()
            answers.clear()
            bench.keep(4, 5)
        await bench.keeper.finish(0.01)
    assert bench.told == [
        "2 values that wait in memory are lost: the run ends before FOLDER/history.sqlite has taken them"
    ]
    bench.keeper.close()  # the thread is busy: nobody waits for it
    answers.set()


async def test_an_end_while_the_file_is_opened_opens_it_once_and_loses_nothing(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, answers, loop = asyncio.Event(), threading.Event(), asyncio.get_running_loop()
    opened: list[HistoryFile] = []

    def open_slowly(*arguments: Any) -> HistoryFile:
        loop.call_soon_threadsafe(begun.set)
        assert answers.wait(30)
        opened.append(HistoryFile(*arguments))
        return opened[-1]

    monkeypatch.setattr(history_keeper, "HistoryFile", open_slowly)
    bench.keep(1, 3)
    async with beside(bench.keeper.serve()):
        await begun.wait()
    answers.set()
    await bench.keeper.finish(10)
    await closed(bench)
    assert bench.told == []
    assert len(opened) == 1
    assert bench.stored() == [1, 2, 3]


async def test_a_disk_that_does_not_answer_is_told_and_so_are_the_losses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(tmp_path, most=5)
    answers = threading.Event()
    monkeypatch.setattr(HistoryFile, "append", lambda *_: answers.wait(30))
    monkeypatch.setattr(history_keeper, "_SLOW_S", 0.01)
    bench.keep(1, 2)
    async with beside(bench.keeper.serve()):
        try:
            await bench.until_told(1)
            bench.keep(3, 9)
            await bench.until_told(2)
        finally:
            answers.set()
    assert bench.told[:2] == [
        "FOLDER/history.sqlite: the disk has not answered for 0.01 s; the newest values wait in memory",
        "4 values that could not be delivered are lost: 4 more than fit in memory while the disk could not take them",
    ]
    bench.keeper.close()


async def test_losses_that_were_not_told_yet_are_told_at_the_end(tmp_path: Path) -> None:
    bench = Bench(tmp_path, most=2)
    for last in (4, 9):
        bench.keep(1, last)
        await bench.keeper.step()
    assert "2 values that could not be delivered are lost: 2 more than fit in memory" in bench.told[-1]
    await bench.keeper.finish(5.0)
    assert "9 values that could not be delivered are lost: 9 more than fit in memory" in bench.told[-1]
    await closed(bench)


async def test_history_is_read_behind_what_was_written_and_leaves_the_disk_when_it_is_confirmed(bench: Bench) -> None:
    bench.keep(1, 5)
    await bench.keeper.step()
    history = bench.history
    history.session_began()
    bench.keep(6, 6)
    for clock in (0.0, 1.0):
        assert history.next_samples(no_entry, list, NOW, OFFSET, clock) is None
        assert history.needs_disk
    await bench.keeper.step()
    assert not history.needs_disk
    found = history.next_samples(lambda _: KIND, list, NOW, OFFSET, 2.0)
    assert found is not None
    assert [sample.reading.value for sample in found[1]] == [1, 2, 3, 4, 5, 6]
    assert [sample.with_quality for sample in found[1]] == [True] + [False] * 5
    history.confirm(history.begin_round())
    await bench.keeper.step()
    await closed(bench)
    assert bench.stored() == []
    assert bench.told == ["all values that waited have been delivered"]
