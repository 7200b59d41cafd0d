"""The process image in shared memory: whole pictures, between two processes that do not wait for each other."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest
from far_ends import HANG_S
from hypothesis import given
from hypothesis import strategies as st

from dpstack.drivers.process.shared_image import SIZE, Outputs, Picture, SharedImage, Word, make_memory
from dpstack.drivers.snapshots import Counters, ImageSnapshot

U64 = st.integers(0, 2**64 - 1)
OCTETS = st.binary(max_size=244)
SLAVES = st.dictionaries(
    st.integers(0, 126), st.builds(ImageSnapshot, OCTETS, OCTETS, st.booleans(), U64, U64), max_size=5
)

#: writes pictures whose octets are all alike, of every length, as quickly as it can
WRITER = """
import sys
from dpstack.drivers.process.shared_image import Picture, SharedImage, Word
from dpstack.drivers.snapshots import ImageSnapshot
image = SharedImage(int(sys.argv[1]))
print(flush=True)
number = 0
while True:
    number += 1
    octets = bytes((number % 251,)) * (number * 7919 % 40_000)
    image.inputs.write(Picture(number, 0, {4: ImageSnapshot(octets, b"", True, 0, 0)}))
"""


@pytest.fixture
def memory() -> Iterator[int]:
    fd = make_memory()
    yield fd
    os.close(fd)


@pytest.fixture
def both(memory: int) -> Iterator[tuple[SharedImage, SharedImage]]:
    """The same memory as the bus process and the application see it."""
    image, there = SharedImage(memory), SharedImage(memory)
    yield image, there
    image.close()
    there.close()


def picture(octets: bytes) -> Picture:
    return Picture(1, 2, {4: ImageSnapshot(octets, b"", True, 3, 4)})


@given(U64, U64, SLAVES, st.dictionaries(st.integers(0, 126), st.builds(Outputs, U64, OCTETS), max_size=5))
def test_pictures_and_outputs_come_back_as_they_were(
    cycle: int, rotations: int, slaves: dict[int, ImageSnapshot], outputs: dict[int, Outputs]
) -> None:
    memory = make_memory()
    image, there = SharedImage(memory), SharedImage(memory)
    os.close(memory)
    image.inputs.write(Picture(cycle, rotations, slaves))
    assert there.inputs.read_new() == Picture(cycle, rotations, slaves)
    there.outputs.write(outputs)
    assert image.outputs.read_new() == outputs
    image.close()
    there.close()


def test_the_octets_of_a_picture_and_of_outputs(memory: int, both: tuple[SharedImage, SharedImage]) -> None:
    image, there = both
    image.inputs.write(Picture(3, 2, {4: ImageSnapshot(b"\x11\x22", b"\x33", True, 5, 6)}))
    octets = bytes.fromhex("93 03 02 81 04 95 C4 02 11 22 C4 01 33 C3 05 06")
    assert os.pread(memory, len(octets) + 1, 4096 + 80 * 1024) == octets + b"\0"
    there.outputs.write({4: Outputs(0x0102, b"\x11\x22"), 5: Outputs(3, b"")})
    octets = bytes.fromhex("82 04 92 CD 01 02 C4 02 11 22 05 92 03 C4 00")
    assert os.pread(memory, len(octets) + 1, 4096 + 4 * 80 * 1024 + 40 * 1024) == octets + b"\0"


def test_126_slaves_with_all_the_octets_there_can_be(memory: int, both: tuple[SharedImage, SharedImage]) -> None:
    image, there = both
    full = {address: ImageSnapshot(b"\x11" * 244, b"\x22" * 244, True, 2**64 - 1, 2**64 - 1) for address in range(127)}
    image.inputs.write(Picture(2**64 - 1, 2**64 - 1, full))
    assert there.inputs.read_new() == Picture(2**64 - 1, 2**64 - 1, full)
    outputs = {address: Outputs(2**64 - 1, bytes(244)) for address in range(127)}
    there.outputs.write(outputs)
    assert image.outputs.read_new() == outputs
    assert os.fstat(memory).st_size == SIZE


def test_a_reader_gets_the_newest_picture_once(both: tuple[SharedImage, SharedImage]) -> None:
    image, there = both
    assert there.inputs.read_new() is None  # nobody has written yet
    image.inputs.write(picture(b"one"))
    image.inputs.write(picture(b"two"))
    assert there.inputs.read_new() == picture(b"two")
    assert there.inputs.read_new() is None
    image.inputs.write(picture(b"x" * 80 * 1024))  # longer than there is room for
    assert there.inputs.read_new() is None
    image.inputs.write(picture(b""))
    assert there.inputs.read_new() == picture(b"")


def test_a_half_written_picture_blocks_no_reader(memory: int, both: tuple[SharedImage, SharedImage]) -> None:
    image, there = both
    image.inputs.write(picture(b"whole"))
    assert there.inputs.read_new() == picture(b"whole")
    os.pwrite(memory, b"torn!", 4096 + 2 * 80 * 1024)  # the second picture, half of it, and not yet its number
    assert there.inputs.read_new() is None
    image.inputs.write(picture(b"again"))
    assert there.inputs.read_new() == picture(b"again")
    os.pwrite(memory, (3).to_bytes(8, sys.byteorder), 0)  # a number without its octets: the check sum is that of none
    assert there.inputs.read_new() is None
    os.pwrite(memory, (2**40).to_bytes(8, sys.byteorder), 8 + 16 * 3)  # a length that cannot be
    assert there.inputs.read_new() is None


def test_no_picture_is_ever_torn(memory: int) -> None:
    """One process writes as quickly as it can, this one reads: whole pictures only, and the newest."""
    image = SharedImage(memory)
    writer = subprocess.Popen([sys.executable, "-c", WRITER, str(memory)], stdout=subprocess.PIPE, pass_fds=(memory,))
    assert writer.stdout is not None
    try:
        writer.stdout.readline()
        whole = 0
        end = time.monotonic() + HANG_S
        while whole < 2_000:
            found = image.inputs.read_new()
            if found is not None:
                octets = found.slaves[4].inputs
                assert octets == bytes((found.cycle % 251,)) * len(octets)
                whole += 1
            assert time.monotonic() < end, f"only {whole} pictures could be read"
    finally:
        writer.kill()
        writer.wait()
        writer.stdout.close()
    image.close()


def test_the_number_of_taken_outputs_is_set_before_they_are_read(both: tuple[SharedImage, SharedImage]) -> None:
    """An application that takes outputs back and then sees an older number knows that nobody will send them."""
    image, there = both
    assert there.take_outputs() is None
    image.outputs.write({4: Outputs(1, b"\x11")})
    image.outputs.write({4: Outputs(2, b"\x22")})
    assert (image.outputs.newest, image.words[Word.OUTPUTS_TAKEN]) == (2, 0)
    assert there.take_outputs() == {4: Outputs(2, b"\x22")}
    assert image.words[Word.OUTPUTS_TAKEN] == 2
    assert there.take_outputs() is None


def test_each_area_and_word_has_its_own_place(both: tuple[SharedImage, SharedImage]) -> None:
    image, there = both
    image.words[Word.HEARTBEAT], image.words[Word.ORDER_TAKEN], image.words[Word.SILENCES] = 2**64 - 1, 2, 3
    assert (there.words[Word.HEARTBEAT], there.words[Word.ORDER_TAKEN], there.words[Word.SILENCES]) == (2**64 - 1, 2, 3)
    assert (there.words[Word.OUTPUTS_TAKEN], there.words[Word.ROUNDS_WATCHED]) == (0, 0)
    image.words[Word.ROUNDS_WATCHED] = True
    assert there.words[Word.ROUNDS_WATCHED] == 1
    counters = Counters(t_ns=1, damage={str(number): number for number in range(40_000)})
    image.counters.write(counters)
    image.drives.write({4: "x" * 260_000})
    image.inputs.write(picture(b"in"))
    assert there.counters.read_new() == counters
    assert there.drives.read_new() == {4: "x" * 260_000}
    assert there.inputs.read_new() == picture(b"in")
