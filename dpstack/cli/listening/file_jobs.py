"""Captures read by several processes: each reads pieces of a file, one process counts all of them in their order.

Nothing crosses from one piece to the next but the order, so that the result is that of one process.
"""

from __future__ import annotations

import io
import signal
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Future
from concurrent.futures.process import ProcessPoolExecutor
from typing import BinaryIO, Final

from dpstack.capture.pcapng import Interface, Piece, Reader
from dpstack.capture.transmission import Columns, Transmission
from dpstack.cli.terminal import output
from dpstack.decode.source import of_bus
from dpstack.errors import CaptureFileError
from dpstack.monitor.exchanges import Batch, Telegrams, condense

#: octets of a piece; for each process two of them wait, with what was read from them
_PIECE: Final = 1 << 20
#: what was read from a piece, and why no more of it
_Read = tuple[list[tuple[Interface, Batch]], str]


class FileJobs:
    """``count`` processes that read pieces of files. Entering starts them, leaving ends them."""

    def __init__(self, count: int) -> None:
        self._most = 2 * count
        self._pool = ProcessPoolExecutor(count, initializer=_begin)
        self._waiting: deque[tuple[Piece, Future[_Read] | None]] = deque()
        self._works = True

    def __enter__(self) -> FileJobs:
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(cancel_futures=True)

    def batches(self, file: BinaryIO, name: str, on_interface: Callable[[Interface], None]) -> Iterator[Batch]:
        """The transmissions in a pcapng ``file``, as :func:`~dpstack.decode.source.read_batches` has them."""
        reader = Reader(file, name)
        self._waiting.clear()
        return of_bus(reader, self._in_order(reader), on_interface)

    def _in_order(self, reader: Reader) -> Iterator[tuple[Interface, Batch]]:
        pieces, waiting = reader.pieces(_PIECE), self._waiting
        end: CaptureFileError | None = None  # of the file, after what waits
        more = True
        while more or waiting:
            try:
                while more and len(waiting) < self._most:
                    piece = next(pieces, None)
                    more = piece is not None
                    if piece is not None:
                        waiting.append((piece, self._submit(piece, reader.name)))
            except CaptureFileError as error:
                end, more = error, False
            if waiting:
                batches, wrong = self._result(*waiting.popleft(), reader.name)
                yield from batches
                if wrong:
                    raise CaptureFileError(wrong)
        if end is not None:
            raise end

    def _submit(self, piece: Piece, name: str) -> Future[_Read] | None:
        try:
            return self._pool.submit(_read, piece, name) if self._works else None
        except BrokenExecutor:
            return None

    def _result(self, piece: Piece, future: Future[_Read] | None, name: str) -> _Read:
        try:
            if future is not None:
                return future.result()
        except BrokenExecutor:
            if self._works:
                output.warn("a process that reads the file has ended (out of memory?): the rest is read by this one")
            self._works = False
        return _read(piece, name)


_known: Final = Telegrams()


def _begin() -> None:
    """In a new process: Ctrl-C is for the first one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _read(piece: Piece, name: str) -> _Read:
    """Read a piece, in the other process."""
    found: list[tuple[Interface, Batch]] = []
    try:
        for interface, batch in Reader(_AtOnce(piece.octets), name, piece.before).batches():
            found.append((interface, _packed(batch)))
    except CaptureFileError as error:
        return found, str(error)
    return found, ""


def _packed(batch: Columns | list[Transmission]) -> Batch:
    heard = condense(batch, _known) if isinstance(batch, Columns) else None
    try:
        return batch if heard is None else heard.packed()
    except OverflowError:
        return batch


class _AtOnce(io.BytesIO):
    """A file of which one reads all there is."""

    def read1(self, size: int | None = -1, /) -> bytes:
        return self.read()
