"""The process image in memory that two processes share: whole pictures, never torn, and nobody ever waits.

One area for each direction, with one writer each. An area holds the last few pictures: the writer puts the next one,
with its length and a CRC-32 over its number and octets, where the oldest stands, and then sets its number. A reader
copies the newest; only if the writer went all the way round meanwhile, or the CRC does not agree, it looks again, a few
times, and keeps the picture it had. The writer never looks at anybody. (The CRC is needed on computers that do not keep
the order of stores. With one place for all pictures a reader beside a busy writer got next to none.)

A picture is one value in MessagePack, which msgspec writes and reads by its type. It names the address of each slave,
so slaves may come, go and change their lengths: there is room for all 126.

Beside the pictures stand single numbers (:class:`Word`) by which either process sees the state of the other one without
asking it.
"""

from __future__ import annotations

import mmap
import os
import zlib
from enum import IntEnum
from typing import Final, Generic, TypeVar

import msgspec
from msgspec import Struct

from dpstack.drivers.snapshots import Counters, ImageSnapshot
from dpstack.errors import BusError

T = TypeVar("T")

_HEAD: Final = 4096
#: 126 slaves with 244 octets each way and their numbers; a page boundary
_INPUTS: Final = 80 * 1024
_OUTPUTS: Final = 40 * 1024
#: the counters of 126 stations, and histograms of all durations that occur
_COUNTERS: Final = 512 * 1024
#: the statuses of 126 drives
_DRIVES: Final = 256 * 1024
#: pictures kept in an area: while one is read the writer begins this many more before it is overwritten. Fewer of those
#: that are long and seldom: they are locked memory
_PLACES: Final = 4
_FEW: Final = 2
SIZE: Final = _HEAD + _PLACES * (_INPUTS + _OUTPUTS) + _FEW * (_COUNTERS + _DRIVES)
#: where each area and the words have their numbers in the head
_INPUTS_AT, _OUTPUTS_AT, _COUNTERS_AT, _WORDS_AT, _DRIVES_AT = 0, 64, 128, 192, 256

#: a reader tries this often
_TRIES: Final = 4
#: words of the head that an area has: its number, then length and CRC of each place
_WORDS: Final = 1 + 2 * _PLACES


class Picture(Struct, frozen=True, array_like=True):
    """All slaves at the end of round number ``cycle``; ``rotations`` counted up to then."""

    cycle: int
    rotations: int
    slaves: dict[int, ImageSnapshot]


class Outputs(Struct, frozen=True, array_like=True):
    """The application's outputs of one slave. The bus process drops them if it does not take them before
    ``until_ns`` (CLOCK_MONOTONIC), another time for each assignment. ``returns``: that of the newest
    :class:`~dpstack.drivers.snapshots.ImageSnapshot` as they were set; with another number they are too old."""

    until_ns: int
    octets: bytes
    returns: int = 0


class Word(IntEnum):
    """Single numbers below 2^64, each set by one process and read by the other one; 0 before."""

    #: bus process: the time of its last sign of life (CLOCK_MONOTONIC, ns)
    HEARTBEAT = 0
    #: bus process: number of the order that it took last, set before it looks at the order's deadline
    ORDER_TAKEN = 1
    #: bus process: number of the picture of outputs that it took last, set before it reads the picture
    OUTPUTS_TAKEN = 2
    #: application: how often it found the bus process silent
    SILENCES = 3
    #: application: 1 while it wants news of the end of each round
    ROUNDS_WATCHED = 4
    #: application: 1 while it wants the octets on the line
    TAPPED = 5


_encoder: Final = msgspec.msgpack.Encoder()


class Area(Generic[T]):
    """Pictures of ``kind`` in one direction: ``write`` in one process, ``read_new`` in the other one."""

    __slots__ = ("_at", "_decoder", "_kind", "_limit", "_memory", "_places", "_seen", "_words")

    def __init__(
        self, memory: memoryview, word: int, at: int, limit: int, kind: type[T], places: int = _PLACES
    ) -> None:
        # aligned words of 8 octets: each is stored at once
        self._words = memory[8 * word : 8 * (word + _WORDS)].cast("Q")
        self._memory = memory
        self._at = at
        self._limit = limit
        self._places = places
        self._seen = 0
        self._kind = kind
        self._decoder: msgspec.msgpack.Decoder[T] | None = None  # of the reader: the writer needs none

    @property
    def newest(self) -> int:
        """The number of the newest picture; 0 before the first."""
        return self._words[0]

    def write(self, picture: T) -> None:
        """Publish ``picture``; one that is too long is left out, so the older one stays."""
        octets = _encoder.encode(picture)
        if len(octets) > self._limit:
            return
        words = self._words
        number = words[0] + 1
        place = number % self._places
        words[1 + 2 * place] = len(octets)
        words[2 + 2 * place] = zlib.crc32(octets, number & 0xFFFF_FFFF)
        at = self._at + place * self._limit
        self._memory[at : at + len(octets)] = octets
        words[0] = number

    def read_new(self) -> T | None:
        """The newest picture; None when it was read before, or could not be had whole. Raises BusError for a whole one
        that is none of ``kind``."""
        words = self._words
        for _ in range(_TRIES):
            number = words[0]
            if number == self._seen:
                return None
            place = number % self._places
            length, crc = words[1 + 2 * place], words[2 + 2 * place]
            if length > self._limit:
                continue
            at = self._at + place * self._limit
            octets = bytes(self._memory[at : at + length])
            if zlib.crc32(octets, number & 0xFFFF_FFFF) == crc:
                self._seen = number
                decoder = self._decoder
                if decoder is None:
                    decoder = self._decoder = msgspec.msgpack.Decoder(self._kind)
                try:
                    return decoder.decode(octets)
                except (msgspec.MsgspecError, UnicodeError, RecursionError) as error:
                    raise BusError(f"a picture in the shared memory cannot be read: {error}") from None
        return None

    def release(self) -> None:
        """Let go of the memory."""
        self._words.release()
        self._memory.release()


class SharedImage:
    """Both directions, mapped from the file descriptor ``fd``."""

    def __init__(self, fd: int) -> None:
        self._map = mmap.mmap(fd, SIZE)
        memory = memoryview(self._map)
        #: from the bus to the application, and back
        self.inputs = Area(memory[:], _INPUTS_AT, _HEAD, _INPUTS, Picture)
        at = _HEAD + _PLACES * _INPUTS
        self.outputs = Area(memory[:], _OUTPUTS_AT, at, _OUTPUTS, dict[int, Outputs])
        at += _PLACES * _OUTPUTS
        self.counters = Area(memory[:], _COUNTERS_AT, at, _COUNTERS, Counters, _FEW)
        at += _FEW * _COUNTERS
        #: the statuses of the drive plugins by address
        self.drives = Area(memory[:], _DRIVES_AT, at, _DRIVES, dict[int, object], _FEW)
        #: by :class:`Word`; aligned: each is stored at once
        self.words = memory[8 * _WORDS_AT : 8 * (_WORDS_AT + len(Word))].cast("Q")
        memory.release()

    def take_outputs(self) -> dict[int, Outputs] | None:
        """The application's outputs by address if there is a new picture of them. For the bus process. Raises
        BusError as :meth:`Area.read_new`."""
        self.words[Word.OUTPUTS_TAKEN] = self.outputs.newest
        return self.outputs.read_new()

    def close(self) -> None:
        """Unmap it; the other process keeps its own."""
        for part in (self.inputs, self.outputs, self.counters, self.drives, self.words):
            part.release()
        self._map.close()


def make_memory(empty: int | None = None) -> int:
    """The file descriptor of fresh memory, all zeros, that no other user may open; ``empty``: a memfd without any yet.

    Raises OSError, and closes ``empty`` then.

    All of its pages exist: if the system has none left, the error is here, and not SIGBUS at a later store.
    """
    fd = os.memfd_create("dpstack", os.MFD_CLOEXEC) if empty is None else empty
    try:
        os.fchmod(fd, 0o600)
        os.posix_fallocate(fd, 0, SIZE)
    except OSError:
        os.close(fd)
        raise
    return fd
