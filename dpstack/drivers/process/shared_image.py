"""The process image in memory that two processes share: whole pictures, never torn, and nobody ever waits.

One area for each direction, with one writer each. An area holds the last few pictures: the writer puts the next one,
with its length and a CRC-32 over its number and octets, where the oldest stands, and then says its number. A reader
copies the newest; only if the writer went all the way round meanwhile, or the CRC does not agree, it looks again, a few
times, and keeps the picture it had. The writer never looks at anybody. (The CRC is what makes it certain on computers
that do not keep the order of stores. With one place for all pictures a reader beside a busy writer got next to none.)

Pictures name the address of each slave, so slaves may come, go and change their lengths: there is room for all 126.

Beside the pictures stand the counters of the bus, the statuses of its drives, and single numbers (:class:`Word`) by
which either process sees what the other one does without asking it.
"""

from __future__ import annotations

import itertools
import mmap
import os
import struct
import zlib
from collections.abc import Iterable, Mapping
from typing import Final, NamedTuple

from dpstack.drivers.snapshots import ImageSnapshot

_HEAD: Final = 4096
#: 126 slaves with 244 octets each way and their heads; a page boundary
_INPUTS: Final = 80 * 1024
_OUTPUTS: Final = 40 * 1024
#: the counters of 126 stations, and histograms of all durations that occur
_COUNTERS: Final = 512 * 1024
#: the statuses of 126 drives
_DRIVES: Final = 256 * 1024
#: pictures kept in an area, a power of two: while one is read the writer begins this many more before it is overwritten
_PLACES: Final = 4
SIZE: Final = _HEAD + _PLACES * (_INPUTS + _OUTPUTS + _COUNTERS + _DRIVES)
#: where each area and the words have their numbers in the head
_INPUTS_AT, _OUTPUTS_AT, _COUNTERS_AT, _WORDS_AT, _DRIVES_AT = 0, 64, 128, 192, 256

#: a reader tries so often
_TRIES: Final = 4
#: words of the head that an area has: its number, then length and CRC of each place
_WORDS: Final = 1 + 2 * _PLACES
_PICTURE: Final = struct.Struct("<QQ")
_SLAVE: Final = struct.Struct("<BBBBQQ")
_OUTPUT: Final = struct.Struct("<BBQ")
#: a time that never comes is this or more
_FOREVER: Final = 1 << 63
_forever: Final = itertools.count(_FOREVER)


class Picture(NamedTuple):
    """All slaves at the end of round number ``cycle``; ``rotations`` counted up to then."""

    cycle: int
    rotations: int
    slaves: Mapping[int, ImageSnapshot]


class Outputs(NamedTuple):
    """The application's outputs of one slave. The bus process drops them where it does not take them before
    ``until_ns`` (CLOCK_MONOTONIC). No two assignments have the same ``until_ns``, see :func:`no_limit`."""

    until_ns: int
    octets: bytes


def no_limit() -> int:
    """An ``until_ns`` that never comes, another one each time."""
    return next(_forever)


class Word:
    """One number below 2^64, which one process sets and the other one reads."""

    __slots__ = ("_cell",)

    def __init__(self, memory: memoryview, word: int) -> None:
        self._cell = memory[8 * word : 8 * (word + 1)].cast("Q")  # aligned: stored at once

    @property
    def value(self) -> int:
        """The number set last; 0 before."""
        return self._cell[0]

    @value.setter
    def value(self, number: int) -> None:
        self._cell[0] = number

    def release(self) -> None:
        """Let go of the memory."""
        self._cell.release()


class Area:
    """One direction: ``write`` in one process, ``read`` in the other one."""

    __slots__ = ("_at", "_limit", "_memory", "_seen", "_words")

    def __init__(self, memory: memoryview, word: int, at: int, limit: int) -> None:
        # aligned words of 8 octets: each is stored at once
        self._words = memory[8 * word : 8 * (word + _WORDS)].cast("Q")
        self._memory = memory
        self._at = at
        self._limit = limit
        self._seen = 0

    @property
    def newest(self) -> int:
        """The number of the newest picture; 0 before the first."""
        return self._words[0]

    @property
    def limit(self) -> int:
        """The most octets of a picture."""
        return self._limit

    def write(self, octets: bytes) -> None:
        """Publish ``octets`` instead of what was there."""
        assert len(octets) <= self._limit
        words = self._words
        number = words[0] + 1
        place = number % _PLACES
        words[1 + 2 * place] = len(octets)
        words[2 + 2 * place] = zlib.crc32(octets, number & 0xFFFF_FFFF)
        at = self._at + place * self._limit
        self._memory[at : at + len(octets)] = octets
        words[0] = number

    def read(self) -> bytes | None:
        """The newest picture; None when it was read before, or could not be had whole."""
        words = self._words
        for _ in range(_TRIES):
            number = words[0]
            if number == self._seen:
                return None
            place = number % _PLACES
            length, crc = words[1 + 2 * place], words[2 + 2 * place]
            if length > self._limit:
                continue
            at = self._at + place * self._limit
            octets = bytes(self._memory[at : at + length])
            if zlib.crc32(octets, number & 0xFFFF_FFFF) == crc:
                self._seen = number
                return octets
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
        self.inputs = Area(memory[:], _INPUTS_AT, _HEAD, _INPUTS)
        self.outputs = Area(memory[:], _OUTPUTS_AT, _HEAD + _PLACES * _INPUTS, _OUTPUTS)
        #: what the bus process counted
        self.counters = Area(memory[:], _COUNTERS_AT, _HEAD + _PLACES * (_INPUTS + _OUTPUTS), _COUNTERS)
        #: what the drive plugins tell, see :func:`dpstack.drivers.process.messages.encoded`
        self.drives = Area(memory[:], _DRIVES_AT, _HEAD + _PLACES * (_INPUTS + _OUTPUTS + _COUNTERS), _DRIVES)
        #: the bus process: when it was alive last (CLOCK_MONOTONIC, ns)
        self.heartbeat = Word(memory, _WORDS_AT)
        #: the bus process: the number of the order that it took last, set before it looks at the order's deadline
        self.order_taken = Word(memory, _WORDS_AT + 1)
        #: the bus process: the number of the picture of outputs that it took last, set before it reads the picture
        self.outputs_taken = Word(memory, _WORDS_AT + 2)
        #: the application: how often it found the bus process silent
        self.silences = Word(memory, _WORDS_AT + 3)
        memory.release()

    def take_outputs(self) -> dict[int, Outputs] | None:
        """The application's outputs by address where there is a new picture of them. For the bus process."""
        self.outputs_taken.value = self.outputs.newest
        octets = self.outputs.read()
        return None if octets is None else read_outputs(octets)

    def close(self) -> None:
        """Unmap it; the other process keeps its own."""
        for area in (self.inputs, self.outputs, self.counters, self.drives):
            area.release()
        for word in (self.heartbeat, self.order_taken, self.outputs_taken, self.silences):
            word.release()
        self._map.close()


def make_memory() -> int:
    """The file descriptor of fresh memory, all zeros."""
    fd = os.memfd_create("dpstack", os.MFD_CLOEXEC)
    os.ftruncate(fd, SIZE)
    return fd


def picture_octets(cycle: int, rotations: int, slaves: Iterable[tuple[int, ImageSnapshot]]) -> bytes:
    """A picture as it stands in memory."""
    parts = [_PICTURE.pack(cycle, rotations)]
    for address, (inputs, outputs, valid, exchanges, at) in slaves:
        parts += (_SLAVE.pack(address, valid, len(inputs), len(outputs), exchanges, at), inputs, outputs)
    return b"".join(parts)


def read_picture(octets: bytes) -> Picture:
    """The picture that :func:`picture_octets` made."""
    cycle, rotations = _PICTURE.unpack_from(octets)
    slaves: dict[int, ImageSnapshot] = {}
    at = _PICTURE.size
    while at < len(octets):
        address, valid, inputs, outputs, exchanges, input_time = _SLAVE.unpack_from(octets, at)
        start = at + _SLAVE.size
        middle, at = start + inputs, start + inputs + outputs
        slaves[address] = ImageSnapshot(octets[start:middle], octets[middle:at], bool(valid), exchanges, input_time)
    return Picture(cycle, rotations, slaves)


def output_octets(outputs: Mapping[int, Outputs]) -> bytes:
    """The application's outputs by address as they stand in memory."""
    return b"".join(_OUTPUT.pack(address, len(octets), until) + octets for address, (until, octets) in outputs.items())


def read_outputs(octets: bytes) -> dict[int, Outputs]:
    """The outputs that :func:`output_octets` wrote."""
    found: dict[int, Outputs] = {}
    at = 0
    while at < len(octets):
        address, length, until = _OUTPUT.unpack_from(octets, at)
        at += _OUTPUT.size
        found[address] = Outputs(until, octets[at : at + length])
        at += length
    return found
