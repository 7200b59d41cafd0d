"""The file ``history.sqlite`` with values that could not be delivered, beside the number of the session.

Made for a program or a computer that may end at any moment: each batch is one transaction that is on the disk when
:meth:`HistoryFile.append` returns (write-ahead log, synchronous). The file has mode 0600, holds values and names only,
and is no larger than its limit: the oldest values go first.
"""

from __future__ import annotations

import contextlib
import os
import sqlite3
import uuid
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from dpstack.bridge.mqtt.history import CHUNK, Entry, Kept, Place
from dpstack.bridge.mqtt.payload import LATEST_MS, DataType
from dpstack.plant.quality import Reason, Value
from dpstack.text import printable

NAME: Final = "history.sqlite"
_DAMAGED_NAME: Final = "history.damaged-{}.sqlite"
#: damaged files that are kept; one more takes the place of the last one
_MOST_DAMAGED: Final = 3
#: in the head of the file: it is ours, and of this version
_APPLICATION: Final = 0x64707368
_VERSION: Final = 1
_PAGE: Final = 4096
#: pages of the log beside the file before they go into it, and room for one transaction in it
_LOG_PAGES: Final = 32
_LOG_ROOM: Final = 600_000
_FEWEST_PAGES: Final = 32
#: entries of a batch, and octets (about) of one without texts; octets of one transaction
MOST_IN_BATCH: Final = CHUNK
_ENTRY_OCTETS: Final = 48
_MOST_WRITTEN: Final = 50_000
#: a value that is longer gets pages of its own
_MOST_INSIDE: Final = 900
#: free pages that are given back to the disk at once
_SHRINK_PAGES: Final = 64
_BOOT_ID: Final = Path("/proc/sys/kernel/random/boot_id")
_INT64: Final = 1 << 63
#: results of SQLite for a file that is damaged
_DAMAGED: Final = frozenset({sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_CONSTRAINT})
#: clocks: the offset of the clock of the computer, by start of the computer. The last one of a start has the last id
_TABLES: Final = (
    "CREATE TABLE clocks (id INTEGER PRIMARY KEY, boot INTEGER NOT NULL, boot_id TEXT NOT NULL,"
    " offset_ms INTEGER NOT NULL)",
    "CREATE TABLE metrics (id INTEGER PRIMARY KEY, device TEXT, name TEXT NOT NULL, type INTEGER NOT NULL,"
    " unit TEXT NOT NULL)",
    "CREATE TABLE entries (boot INTEGER NOT NULL, at_ms INTEGER NOT NULL, id INTEGER NOT NULL, clock INTEGER NOT NULL,"
    " metric INTEGER NOT NULL, value, reason TEXT, note TEXT, PRIMARY KEY (boot, at_ms, id)) WITHOUT ROWID",
)
_READ: Final = "SELECT boot, at_ms, id, clock, metric, value, reason, note FROM entries"


class HistoryError(Exception):
    """The file cannot be used now, for instance as the disk is full. One line."""


class DamagedHistoryError(HistoryError):
    """The file is damaged, or another program made it."""


def boot_id() -> str:
    """The id of this start of the computer; another one at each call if the kernel gives none."""
    try:
        return _BOOT_ID.read_text("ascii").strip() or str(uuid.uuid4())
    except (OSError, ValueError):
        return str(uuid.uuid4())


class HistoryFile:
    """The store in ``folder``, ``most_octets`` at most. One thread makes and uses it. ``boot``: :func:`boot_id`.

    ``count``: entries in it. ``displaced``, ``unreadable``: entries that were dropped for want of room, or as they
    could not be read.

    Each call raises DamagedHistoryError or HistoryError; close it then.
    """

    def __init__(self, folder: Path, most_octets: int, boot: str) -> None:
        self.displaced = self.unreadable = 0
        self._path = folder / NAME
        self._most_pages = max(_FEWEST_PAGES, (most_octets - _LOG_ROOM) // _PAGE)
        with _errors():
            # others cannot read it, nor is it behind a link of somebody
            os.close(os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600))
            os.chmod(self._path, 0o600)
            self._sql = sqlite3.connect(self._path, isolation_level=None, check_same_thread=False)
        self._sql.text_factory = _text
        try:
            with _errors():
                self._prepare(boot)
        except (TypeError, ValueError):
            self._sql.close()
            raise DamagedHistoryError("it is damaged") from None
        except BaseException:
            self._sql.close()
            raise

    def close(self) -> None:
        with contextlib.suppress(sqlite3.Error):
            self._sql.close()

    def _prepare(self, boot: str) -> None:
        sql = self._sql
        # without another reader there is no shared memory, which a full disk could take away
        for line in ("locking_mode = EXCLUSIVE", f"page_size = {_PAGE}", "auto_vacuum = INCREMENTAL",
                     "journal_mode = WAL", "synchronous = FULL", f"wal_autocheckpoint = {_LOG_PAGES}",
                     f"journal_size_limit = {_LOG_PAGES * _PAGE}", "trusted_schema = OFF",
                     "cell_size_check = ON", "temp_store = MEMORY", "cache_size = -2000"):  # fmt: skip
            sql.execute(f"PRAGMA {line}")
        if self._one("SELECT count(*) FROM sqlite_schema") == 0:
            with self._transaction():
                for table in _TABLES:
                    sql.execute(table)
                sql.execute(f"PRAGMA application_id = {_APPLICATION}")
                sql.execute(f"PRAGMA user_version = {_VERSION}")
        head = self._one("PRAGMA application_id"), self._one("PRAGMA user_version")
        if head != (_APPLICATION, _VERSION):
            raise DamagedHistoryError("it is a file of another program or version")
        tables = [text for (text,) in sql.execute("SELECT sql FROM sqlite_schema WHERE sql IS NOT NULL ORDER BY rowid")]
        if tables != list(_TABLES):
            raise DamagedHistoryError("it has other tables")
        if self._one("PRAGMA quick_check(1)") != "ok":
            raise DamagedHistoryError("it is damaged")
        with self._transaction():
            sql.execute("DELETE FROM clocks WHERE boot_id != ? AND boot NOT IN (SELECT boot FROM entries)", (boot,))
            sql.execute(
                "DELETE FROM clocks WHERE id NOT IN (SELECT clock FROM entries)"
                " AND id NOT IN (SELECT max(id) FROM clocks GROUP BY boot)"
            )
            sql.execute("DELETE FROM metrics WHERE id NOT IN (SELECT metric FROM entries)")
        self._read_tables(boot)

    def _read_tables(self, boot: str) -> None:
        sql = self._sql
        self.count = int(self._one("SELECT count(*) FROM entries"))
        self._last_id = int(self._one("SELECT coalesce(max(id), 0) FROM entries"))
        self._metrics = {row[1:]: row[0] for row in sql.execute("SELECT id, device, name, type, unit FROM metrics")}
        self._metric_of = {number: metric for metric, number in self._metrics.items()}
        self._last_metric = max(self._metric_of, default=0)
        #: boot and offset by clock; the last offset of each boot
        self._clocks: dict[int, tuple[int, int]] = {}
        self._last_offset: dict[int, int] = {}
        self._boot_id, self._boot = boot, 0
        for number, boot_number, boot_text, offset in sql.execute(
            "SELECT id, boot, boot_id, offset_ms FROM clocks ORDER BY id"
        ):
            if not isinstance(offset, int) or abs(offset) > LATEST_MS:
                raise ValueError(offset)
            self._clocks[number] = boot_number, offset
            self._last_offset[boot_number] = offset
            if boot_text == boot:
                self._boot = boot_number
        if not self._boot:
            self._boot = 1 + max([one for one, _ in self._clocks.values()] + [self._highest_boot()])

    def _highest_boot(self) -> int:
        return int(self._one("SELECT coalesce(max(boot), 0) FROM entries"))

    def _one(self, text: str) -> Any:
        return self._sql.execute(text).fetchone()[0]

    # --- writing ------------------------------------------------------------------------------------------------------

    def append(self, entries: Sequence[Entry], offset_ms: int | None = None) -> None:
        """Write entries; they are on the disk then. ``offset_ms``: the offset of the clock of the computer now, by
        which later readers date them."""
        part, octets = list[Entry](), 0
        for entry in entries:
            part.append(entry)
            octets += _octets(entry)
            if octets >= _MOST_WRITTEN:
                self._append(part, octets, offset_ms)
                part, octets = [], 0
        if part or not entries:
            self._append(part, octets, offset_ms)

    def _append(self, entries: Sequence[Entry], octets: int, offset_ms: int | None) -> None:
        with _errors(), self._undone_whole(), self._transaction():
            self._make_room(octets, len(entries))
            self._sql.executemany(
                "INSERT INTO entries VALUES (?, ?, ?, ?, ?, ?, ?, ?)", [self._row(entry) for entry in entries]
            )
            self.count += len(entries)
            if offset_ms is not None and self.count and self._last_offset.get(self._boot) != offset_ms:
                self._clock(offset_ms, last=True)

    def delete(self, places: Sequence[Place]) -> None:
        """Take entries off the disk; those that are gone already do not matter."""
        with _errors(), self._undone_whole():
            with self._transaction():
                gone = self._sql.executemany("DELETE FROM entries WHERE boot = ? AND at_ms = ? AND id = ?", places)
                self.count -= gone.rowcount  # those that were displaced meanwhile are not counted twice
            if self._one("PRAGMA freelist_count") >= _SHRINK_PAGES:
                self._sql.execute(f"PRAGMA incremental_vacuum({_SHRINK_PAGES})").fetchall()

    def _row(self, entry: Entry) -> tuple[object, ...]:
        self._last_id += 1
        return (
            self._boot,
            entry.at_ms,
            self._last_id,
            self._clock(entry.offset_ms),
            self._metric((entry.device, entry.metric, entry.type, entry.unit)),
            _written(entry.value),
            None if entry.reason is Reason.GOOD else entry.reason.name,
            _utf8(entry.note) or None,
        )

    def _clock(self, offset_ms: int, *, last: bool = False) -> int:
        """The number of a clock of this boot; ``last``: it is the last one of them."""
        for number, clock in reversed(self._clocks.items()):
            if clock == (self._boot, offset_ms) and (not last or self._last_offset[self._boot] == offset_ms):
                return number
        number = max(self._clocks, default=0) + 1
        self._sql.execute("INSERT INTO clocks VALUES (?, ?, ?, ?)", (number, self._boot, self._boot_id, offset_ms))
        self._clocks[number] = self._boot, offset_ms
        self._last_offset[self._boot] = offset_ms
        return number

    def _metric(self, metric: tuple[str | None, str, int, str]) -> int:
        number = self._metrics.get(metric)
        if number is None:
            number = self._last_metric = self._last_metric + 1
            self._sql.execute("INSERT INTO metrics VALUES (?, ?, ?, ?, ?)", (number, *metric))
            self._metrics[metric], self._metric_of[number] = number, metric
        return number

    def _make_room(self, octets: int, entries: int) -> None:
        """Drop the oldest entries until ``octets`` more fit in."""
        most = self._most_pages - 2 * octets // _PAGE - 1
        while self.count and self._one("PRAGMA page_count") - self._one("PRAGMA freelist_count") > most:
            number = min(self.count, max(entries, MOST_IN_BATCH // 4))
            last = self._sql.execute(
                "SELECT boot, at_ms, id FROM entries ORDER BY boot, at_ms, id LIMIT 1 OFFSET ?", (number - 1,)
            ).fetchone()
            if last is None:
                raise DamagedHistoryError("it has fewer values than were counted")
            self._sql.execute("DELETE FROM entries WHERE (boot, at_ms, id) <= (?, ?, ?)", last)
            self.count -= number
            self.displaced += number

    # --- reading ------------------------------------------------------------------------------------------------------

    def read(self, most: int, without: Collection[str] = ()) -> list[Kept]:
        """The oldest entries, ascending in time, but those of the devices ``without``."""
        places = ", ".join("?" * len(without))
        found: list[Kept] = []
        wrong: list[Place] = []
        with _errors():
            rows = self._sql.execute(
                f"{_READ} WHERE metric NOT IN (SELECT id FROM metrics WHERE device IN ({places}))"
                " ORDER BY boot, at_ms, id LIMIT ?",
                (*without, most),
            )
            for boot, at_ms, id_, clock, metric, value, reason, note in rows:
                try:
                    if not isinstance(at_ms, int) or abs(at_ms) > LATEST_MS:
                        raise ValueError(at_ms)
                    device, name, type_, unit = self._metric_of[metric]
                    offset = self._clocks[clock][1]
                    why = Reason.GOOD if reason is None else Reason[reason]
                    given = _read_back(value, DataType(type_))
                except (KeyError, ValueError, TypeError):
                    wrong.append((boot, at_ms, id_))
                    continue
                entry = Entry(device, name, type_, unit, at_ms, offset, given, why, printable(note or ""))
                last = None if boot == self._boot else self._last_offset.get(boot, offset)
                found.append(Kept((boot, at_ms, id_), entry, last))
        if wrong:
            self.unreadable += len(wrong)
            self.delete(wrong)
        return found or (self.read(most, without) if wrong else [])

    # --- transactions -------------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def _transaction(self) -> Iterator[None]:
        self._sql.execute("BEGIN IMMEDIATE")
        try:
            yield
            self._sql.execute("COMMIT")
        except BaseException:
            with contextlib.suppress(sqlite3.Error):
                self._sql.execute("ROLLBACK")
            raise

    @contextlib.contextmanager
    def _undone_whole(self) -> Iterator[None]:
        """Take back the counts of a transaction that fails."""
        displaced = self.displaced
        try:
            yield
        except BaseException:
            self.displaced = displaced
            raise


def move_aside(folder: Path) -> str:
    """Give a damaged file, with its log, another name, and return that. Raises HistoryError."""
    name = next(
        (one for one in map(_DAMAGED_NAME.format, range(1, _MOST_DAMAGED)) if not (folder / one).exists()),
        _DAMAGED_NAME.format(_MOST_DAMAGED),
    )
    with _errors():
        os.replace(folder / NAME, folder / name)
        for suffix in ("-wal", "-journal"):
            with contextlib.suppress(FileNotFoundError):
                os.replace(folder / f"{NAME}{suffix}", folder / f"{name}{suffix}")
        with contextlib.suppress(FileNotFoundError):
            os.unlink(folder / f"{NAME}-shm")
    return name


@contextlib.contextmanager
def _errors() -> Iterator[None]:
    try:
        yield
    except sqlite3.Error as error:
        text = printable(str(error)) or type(error).__name__
        code = getattr(error, "sqlite_errorcode", 0) & 0xFF
        raise (DamagedHistoryError if code in _DAMAGED else HistoryError)(text) from None
    except OSError as error:
        raise HistoryError(printable(error.strerror or str(error))) from None


def _octets(entry: Entry) -> int:
    """Octets of an entry in the file, about."""
    value = entry.value
    texts = len(value.encode("utf-8", "replace")) if isinstance(value, str) else 0
    texts += len(value) if isinstance(value, bytes) else 0
    texts += len(entry.note.encode("utf-8", "replace"))
    return _ENTRY_OCTETS + texts + (0 if texts <= _MOST_INSIDE else (texts // _PAGE + 1) * _PAGE)


def _text(octets: bytes) -> str:
    return octets.decode("utf-8", "replace")


def _utf8(text: str) -> str:
    return text.encode("utf-8", "replace").decode()


def _written(value: Value) -> int | float | str | bytes | None:
    """A value as SQLite takes it: its whole numbers have 64 bits with sign."""
    if isinstance(value, str):
        return _utf8(value)
    if isinstance(value, int) and not -_INT64 <= value < _INT64:
        return str(value)
    return int(value) if isinstance(value, bool) else value


def _read_back(value: object, type_: DataType) -> Value:
    """A value of the file. Raises ValueError or TypeError if it is none of ``type_``."""
    if value is None:
        return None
    if type_ in (DataType.STRING, DataType.TEXT) and isinstance(value, str):
        return printable(value)
    if type_ is DataType.BYTES and isinstance(value, bytes):
        return value
    if type_ in (DataType.FLOAT, DataType.DOUBLE) and isinstance(value, (int, float)):
        return float(value)
    if type_ is DataType.BOOLEAN and value in (0, 1):
        return bool(value)
    if DataType.INT8 <= type_ <= DataType.UINT64 and isinstance(value, (int, str)):
        return int(value)
    raise ValueError(f"{value!r} is no {type_.name}")
