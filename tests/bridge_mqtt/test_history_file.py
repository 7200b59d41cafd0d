"""Files of a gateway: values that could not be delivered (order, bound, SIGKILL, full disk, damage, rights), and the
number of the MQTT session, which goes on across restarts, and nobody else has it."""

from __future__ import annotations

import gc
import os
import random
import resource
import signal
import sqlite3
import stat
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest
from history_rig import MB, MEMORY, OFFSET, entry
from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples

from dpstack.bridge.mqtt.history import EARLIEST_MS, Entry, Kept
from dpstack.bridge.mqtt.history_file import (
    NAME,
    DamagedHistoryError,
    HistoryError,
    HistoryFile,
    boot_id,
    move_aside,
)
from dpstack.bridge.mqtt.payload import DataType
from dpstack.bridge.mqtt.session_file import SessionFile
from dpstack.errors import ConfigError
from dpstack.plant.quality import Reason, Value


def numbers(found: Sequence[Kept]) -> list[Value]:
    return [kept.entry.value for kept in found]


def size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.glob(f"{NAME}*"))


def test_values_come_back_in_order_of_time_as_they_were(tmp_path: Path) -> None:
    values: list[tuple[DataType, Value]] = [
        (DataType.UINT64, (1 << 64) - 1),
        (DataType.INT64, -(1 << 63)),
        (DataType.BOOLEAN, True),
        (DataType.FLOAT, 0.25),
        (DataType.DOUBLE, 3.0),
        (DataType.STRING, "pump \u00e4"),
        (DataType.BYTES, b"\x00\xff"),
        (DataType.DOUBLE, None),
    ]
    given_ = [
        Entry(None, f"m{n}", type_, "", 100 - n, OFFSET, value, Reason.TOO_OLD, "limit 3 ms")
        for n, (type_, value) in enumerate(values)
    ]
    file = HistoryFile(tmp_path, MB, "a")
    file.append(given_)
    file.append([entry(1), entry(2, device="hoist")])
    file.close()
    again = HistoryFile(tmp_path, MB, "a")
    assert again.count == 10
    found = again.read(100)
    assert [kept.entry for kept in found] == [entry(1), entry(2, device="hoist"), *reversed(given_)]
    assert [type(kept.entry.value) for kept in found[2:]] == [type(one.value) for one in reversed(given_)]
    assert numbers(again.read(1)) == [1]
    assert numbers(again.read(1, {"valves"})) == [2]
    again.delete([kept.place for kept in found[:9]])
    assert [kept.entry for kept in again.read(100)] == given_[:1]
    again.close()
    assert [stat.S_IMODE(path.stat().st_mode) for path in tmp_path.glob("history*")] == [0o600]


@pytest.fixture(scope="module")
def folders() -> Iterator[Callable[[], Path]]:
    """Makes folders in memory, where there is one: the file writes to the disk each time."""
    with tempfile.TemporaryDirectory(dir=MEMORY) as folder:
        yield lambda: Path(tempfile.mkdtemp(dir=folder))


@examples(25)
@given(given_=st.lists(st.tuples(st.integers(0, 3), st.integers(0, 50)), max_size=30))
def test_the_file_is_a_list_sorted_by_start_and_time(
    folders: Callable[[], Path], given_: list[tuple[int, int]]
) -> None:
    """Several starts of the computer; entries of one time keep the order in which they came."""
    folder = folders()
    model: list[tuple[int, int, int]] = []
    number = 0
    for boot in sorted({boot for boot, _ in given_}):
        file = HistoryFile(folder, MB, f"boot {boot}")
        for at in [at for one, at in given_ if one == boot]:
            number += 1
            file.append([entry(number, at_ms=at)])
            model.append((boot, at, number))
        model.sort(key=lambda one: one[:2])
        assert numbers(file.read(100)) == [one[2] for one in model]
        if model and number % 2:
            file.delete([file.read(1)[0].place])
            del model[0]
        assert file.count == len(model)
        file.close()


def test_the_oldest_go_first_and_the_file_keeps_its_limit(folders: Callable[[], Path]) -> None:
    folder = folders()
    file = HistoryFile(folder, MB, "a")
    largest = 0
    for begin in range(0, 5000, 500):
        file.append([entry(number, note="y" * 150) for number in range(begin, begin + 500)])
        largest = max(largest, size(folder))
    assert largest <= MB
    kept = numbers(file.read(30_000))
    assert file.displaced == 5000 - len(kept)
    assert kept == list(range(file.displaced, 5000))
    assert 1000 < file.count == len(kept) < 5000
    file.append([entry(number, note="x" * 1000) for number in range(1000)])
    assert size(folder) <= MB
    assert 0 < file.count < 1000
    while places := [one.place for one in file.read(1000)]:
        file.delete(places)
    for _ in range(5):
        file.delete([])
    file.close()
    assert size(folder) < 64 * 4096 + 100_000  # the disk has its room again


def test_a_smaller_limit_shrinks_the_file(folders: Callable[[], Path]) -> None:
    folder = folders()
    file = HistoryFile(folder, 10 * MB, "a")
    file.append([entry(number, note="x" * 1000) for number in range(300)])
    file.close()
    file = HistoryFile(folder, MB, "a")
    file.append([entry(300)])
    kept = numbers(file.read(30_000))
    assert kept == list(range(file.displaced, 301))
    assert 0 < file.displaced < 300
    file.close()


# --- time ---------------------------------------------------------------------------------------------------------


def test_times_of_a_clock_that_is_set_later(tmp_path: Path) -> None:
    """The computer begins in 1970 and gets its time: of this start, and of an earlier one."""
    file = HistoryFile(tmp_path, MB, "a")
    file.append([entry(1, offset_ms=0)], 0)
    (kept,) = file.read(10)
    assert kept.time_ms(0) is None
    assert kept.time_ms(OFFSET) == OFFSET + 10  # set while it waits
    assert kept.time_ms(OFFSET + 7) == OFFSET + 17
    file.append((), OFFSET)
    file.close()
    file = HistoryFile(tmp_path, MB, "b")
    file.append([entry(2, offset_ms=0)], 0)
    first, second = file.read(10)
    assert first.time_ms(0) == OFFSET + 10  # by the last offset of its own start
    assert (second.time_ms(0), second.time_ms(OFFSET)) == (None, OFFSET + 20)
    file.close()
    file = HistoryFile(tmp_path, MB, "c")
    assert [kept.time_ms(OFFSET + 5) for kept in file.read(10)] == [OFFSET + 10, None]
    file.close()


def test_drift_of_the_clock_changes_no_time(tmp_path: Path) -> None:
    """So a value that was sent and not confirmed has the same time as history."""
    file = HistoryFile(tmp_path, MB, "a")
    file.append([entry(1, offset_ms=OFFSET)], OFFSET + 900)
    assert file.read(1)[0].time_ms(OFFSET - 900) == OFFSET + 10
    file.append([entry(2, offset_ms=OFFSET + 900)], OFFSET)
    file.close()
    file = HistoryFile(tmp_path, MB, "b")
    assert [kept.time_ms(0) for kept in file.read(9)] == [OFFSET + 10, OFFSET + 920]
    file.close()
    assert len(boot_id()) > 8


# --- SIGKILL, full disk, damage -------------------------------------------------------------------------------------

WRITER = """
import sys
from pathlib import Path
from history_rig import entry
from dpstack.bridge.mqtt.history_file import HistoryFile
file, number = HistoryFile(Path(sys.argv[1]), 1_000_000, "a"), 0
while True:
    file.append([entry(number + one) for one in range(7)])
    number += 7
    print(number, flush=True)
    if number % 210 == 0:
        file.delete([kept.place for kept in file.read(70)])
"""


def test_sigkill_while_it_writes_costs_nothing_that_was_written(folders: Callable[[], Path]) -> None:
    folder = folders()
    child = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(folder)],
        stdout=subprocess.PIPE,
        cwd=Path(__file__).parent,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        text=True,
    )
    assert child.stdout is not None
    wanted = random.randrange(300, 900)
    told = 0
    while told < wanted:
        told = int(child.stdout.readline())
    child.send_signal(signal.SIGKILL)
    rest = child.stdout.read().split()
    child.wait()
    child.stdout.close()
    told = int(rest[-1]) if rest else told
    file = HistoryFile(folder, MB, "a")
    found = [int(str(value)) for value in numbers(file.read(10_000))]
    file.close()
    assert found == list(range(found[0], found[-1] + 1))  # none is missing, none is half
    assert found[0] % 70 == 0
    assert found[-1] + 1 in (told, told + 7)


def test_a_disk_that_is_full_fails_clearly_and_keeps_what_was_there(tmp_path: Path) -> None:
    file = HistoryFile(tmp_path, 10 * MB, "a")
    file.append([entry(1)])
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, before[1]))
        with pytest.raises(HistoryError) as told:
            file.append([entry(number) for number in range(2, 20_000)])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
    assert not isinstance(told.value, DamagedHistoryError)
    file.close()
    file = HistoryFile(tmp_path, 10 * MB, "a")
    kept = numbers(file.read(20_000))
    assert kept == list(range(1, 1 + len(kept)))
    assert 0 < len(kept) < 19_999
    file.append([entry(20_000)])
    assert numbers(file.read(20_000)) == [*kept, 20_000]
    file.close()


@pytest.mark.parametrize(
    "content",
    [b"no database", b"SQLite format 3\x00" + bytes(5000), b""],
    ids=["another file", "a head and nothing", "empty"],
)
def test_a_file_that_is_not_ours_is_moved_aside(tmp_path: Path, content: bytes) -> None:
    (tmp_path / NAME).write_bytes(content)
    if content:
        with pytest.raises(DamagedHistoryError):
            HistoryFile(tmp_path, MB, "a")
        assert move_aside(tmp_path) == "history.damaged-1.sqlite"
        assert (tmp_path / "history.damaged-1.sqlite").read_bytes() == content
    HistoryFile(tmp_path, MB, "a").close()


def test_a_database_of_another_program_or_version_is_not_used(tmp_path: Path) -> None:
    sql = sqlite3.connect(tmp_path / NAME)
    sql.execute("CREATE TABLE theirs (x)")
    sql.commit()
    sql.close()
    for turn in range(1, 5):
        with pytest.raises(DamagedHistoryError, match="another program or version"):
            HistoryFile(tmp_path, MB, "a")
        name = move_aside(tmp_path)
        assert name == f"history.damaged-{min(turn, 3)}.sqlite"
        HistoryFile(tmp_path, MB, "a").close()
        sql = sqlite3.connect(tmp_path / NAME)
        sql.execute("PRAGMA user_version = 2")
        sql.close()
    assert len(list(tmp_path.glob("history.damaged*"))) == 3


@examples(25)
@given(damage=st.lists(st.tuples(st.integers(0, 40_000), st.binary(min_size=1, max_size=40)), min_size=1, max_size=8))
def test_damage_is_told_or_costs_single_values(folders: Callable[[], Path], damage: list[tuple[int, bytes]]) -> None:
    """Octets of the file are changed: it is refused, or what is read are entries."""
    folder = folders()
    file = HistoryFile(folder, MB, "a")
    file.append([entry(number) for number in range(400)], OFFSET)
    file.close()
    content = bytearray((folder / NAME).read_bytes())
    for at, octets in damage:
        at %= len(content)
        content[at : at + len(octets)] = octets
    (folder / NAME).write_bytes(content)
    try:
        file = HistoryFile(folder, MB, "b")
    except HistoryError:
        return
    try:
        for kept in file.read(1000):
            time_ms = kept.time_ms(OFFSET)
            assert time_ms is None or time_ms >= EARLIEST_MS
        file.append([entry(1)], OFFSET)
    except HistoryError:
        pass
    finally:
        file.close()


def test_a_folder_or_file_that_cannot_be_used_is_told(tmp_path: Path) -> None:
    with pytest.raises(HistoryError, match="No such file"):
        HistoryFile(tmp_path / "missing", MB, "a")
    (tmp_path / NAME).symlink_to("/etc/hostname")
    with pytest.raises(HistoryError, match="symbolic link"):
        HistoryFile(tmp_path, MB, "a")
    (tmp_path / NAME).unlink()
    (tmp_path / NAME).mkdir()
    with pytest.raises(HistoryError, match="directory"):
        HistoryFile(tmp_path, MB, "a")


def test_others_cannot_read_it_whatever_the_umask(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        (tmp_path / NAME).touch(0o666)
        file = HistoryFile(tmp_path, MB, "a")
        file.append([entry(1)])
        assert {stat.S_IMODE(path.stat().st_mode) for path in tmp_path.iterdir()} == {0o600}
        file.close()
    finally:
        os.umask(before)


def test_values_that_were_displaced_while_they_were_on_their_way_are_counted_once(tmp_path: Path) -> None:
    file = HistoryFile(tmp_path, 0, "a")
    file.append([entry(number) for number in range(1000)])
    on_their_way = [kept.place for kept in file.read(1000)]
    while not file.displaced:
        file.append([entry(number) for number in range(1000, 2000)])
    file.delete(on_their_way)
    counted = file.count
    assert counted == len(file.read(1_000_000))
    file.close()
    file = HistoryFile(tmp_path, 0, "a")
    assert file.count == counted
    file.close()


KILLED = """
import os, signal, sys
from pathlib import Path
from dpstack.bridge.mqtt.session_file import SessionFile
numbers = SessionFile(Path(sys.argv[1]))
for _ in range(int(sys.argv[2])):
    number = numbers.next()
print(number, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_numbers_begin_at_zero_and_wrap_behind_255(tmp_path: Path) -> None:
    numbers = SessionFile(tmp_path / "a" / "b")
    assert [numbers.next() for _ in range(258)] == [*range(256), 0, 1]
    assert not numbers.damaged
    assert oct((tmp_path / "a" / "b").stat().st_mode)[-3:] == "700"
    numbers.close()
    numbers.close()


def test_a_folder_that_nobody_holds_any_more_is_free(tmp_path: Path) -> None:
    """As where the task that took it was cancelled meanwhile."""
    SessionFile(tmp_path)
    gc.collect()
    numbers = SessionFile(tmp_path)
    assert numbers.next() == 0
    numbers.close()
    with pytest.raises(OSError, match="Bad file descriptor"):
        numbers.next()


def test_a_number_is_never_given_twice_by_programs_that_are_killed(tmp_path: Path) -> None:
    given = []
    for count in (1, 3):
        run = subprocess.run(
            [sys.executable, "-c", KILLED, str(tmp_path), str(count)], capture_output=True, text=True, check=False
        )
        assert run.returncode == -9, run.stderr
        given.append(int(run.stdout))
    numbers = SessionFile(tmp_path)
    assert [*given, numbers.next()] == [0, 3, 4]
    numbers.close()


def test_the_number_is_on_disk_before_it_is_returned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Octets, then the new name, then the folder that has the name."""
    done: list[str] = []
    numbers = SessionFile(tmp_path)
    sync, replace = os.fsync, os.replace

    def fsync(fd: int) -> None:
        done.append("sync " + Path(os.readlink(f"/proc/self/fd/{fd}")).name)
        sync(fd)

    def renamed(old: str, new: str, *, src_dir_fd: int, dst_dir_fd: int) -> None:
        done.append("rename")
        replace(old, new, src_dir_fd=src_dir_fd, dst_dir_fd=dst_dir_fd)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(os, "replace", renamed)
    numbers.next()
    assert done == ["sync bdseq.new", "rename", f"sync {tmp_path.name}"]
    numbers.close()


def test_a_disk_that_is_full_gives_no_number_and_the_old_one_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    numbers = SessionFile(tmp_path)
    numbers.next()

    def full(fd: int, octets: bytes) -> int:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "write", full)
        with pytest.raises(OSError, match="No space"):
            numbers.next()
    assert (tmp_path / "bdseq").read_bytes() == b"0\n"
    assert numbers.next() == 1
    numbers.close()


@pytest.mark.parametrize("octets", [b"", b"256\n", b"12", b"-1\n", b"1\n2\n", b"\xff\x00", b"7 \n", b"0" * 100])
def test_a_damaged_file_is_found(tmp_path: Path, octets: bytes) -> None:
    (tmp_path / "bdseq").write_bytes(octets)
    numbers = SessionFile(tmp_path)
    assert numbers.damaged
    assert numbers.next() == 0
    numbers.close()
    again = SessionFile(tmp_path)
    assert not again.damaged
    again.close()


def test_a_second_gateway_with_the_same_id_is_refused(tmp_path: Path) -> None:
    first = SessionFile(tmp_path)
    with pytest.raises(ConfigError, match="another gateway on this computer has the same group and node"):
        SessionFile(tmp_path)
    first.close()
    SessionFile(tmp_path).close()


def test_a_folder_that_cannot_be_used_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "link").mkdir()
    (tmp_path / "link" / "bdseq").symlink_to("/etc/passwd")
    for folder in (tmp_path / "file", tmp_path / "file" / "below", tmp_path / "link"):
        with pytest.raises(ConfigError, match="the state of the MQTT session cannot be kept in"):
            SessionFile(folder)
