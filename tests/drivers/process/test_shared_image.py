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

from dpstack.drivers.process.shared_image import (
    SIZE,
    Outputs,
    Picture,
    SharedImage,
    make_memory,
    no_limit,
    output_octets,
    picture_octets,
    read_outputs,
    read_picture,
)
from dpstack.drivers.snapshots import ImageSnapshot

U64 = st.integers(0, 2**64 - 1)
OCTETS = st.binary(max_size=244)
SLAVES = st.dictionaries(
    st.integers(0, 126), st.builds(ImageSnapshot, OCTETS, OCTETS, st.booleans(), U64, U64), max_size=5
)

#: writes pictures whose octets are all alike, of every length, as quickly as it can
WRITER = """
import sys
from dpstack.drivers.process.shared_image import SharedImage
image = SharedImage(int(sys.argv[1]))
print(flush=True)
number = 0
while True:
    number += 1
    image.inputs.write(bytes((number % 251,)) * (number * 7919 % 40_000))
"""


@pytest.fixture
def memory() -> Iterator[int]:
    fd = make_memory()
    yield fd
    os.close(fd)


@given(U64, U64, SLAVES)
def test_a_picture_comes_back_as_it_was(cycle: int, rotations: int, slaves: dict[int, ImageSnapshot]) -> None:
    assert read_picture(picture_octets(cycle, rotations, slaves.items())) == Picture(cycle, rotations, slaves)


def test_the_octets_of_a_picture() -> None:
    octets = picture_octets(3, 2, [(4, ImageSnapshot(b"\x11\x22", b"\x33", True, 5, 6))])
    assert octets == bytes.fromhex(
        "0300000000000000 0200000000000000 04010201 0500000000000000 0600000000000000 112233"
    )


@given(st.dictionaries(st.integers(0, 126), st.builds(Outputs, U64, OCTETS), max_size=5))
def test_outputs_come_back_as_they_were(outputs: dict[int, Outputs]) -> None:
    assert read_outputs(output_octets(outputs)) == outputs


def test_126_slaves_with_all_the_octets_there_can_be(memory: int) -> None:
    image, there = SharedImage(memory), SharedImage(memory)
    full = {address: ImageSnapshot(b"\x11" * 244, b"\x22" * 244, True, 2**64 - 1, 2**64 - 1) for address in range(127)}
    image.inputs.write(picture_octets(1, 2, full.items()))
    octets = there.inputs.read()
    assert octets is not None
    assert read_picture(octets).slaves == full
    outputs = {address: Outputs(2**64 - 1, bytes(244)) for address in range(127)}
    there.outputs.write(output_octets(outputs))
    octets = image.outputs.read()
    assert octets is not None
    assert read_outputs(octets) == outputs
    assert os.fstat(memory).st_size == SIZE
    image.close()
    there.close()


def test_a_reader_is_told_what_is_new_and_keeps_the_rest(memory: int) -> None:
    image, there = SharedImage(memory), SharedImage(memory)
    assert there.inputs.read() is None  # nobody has written yet
    image.inputs.write(b"one")
    image.inputs.write(b"two")
    assert there.inputs.read() == b"two"
    assert there.inputs.read() is None
    image.inputs.write(b"")
    assert there.inputs.read() == b""
    image.close()
    there.close()


def test_a_writer_that_died_in_the_middle_holds_nobody_up(memory: int) -> None:
    image, there = SharedImage(memory), SharedImage(memory)
    image.inputs.write(b"whole")
    assert there.inputs.read() == b"whole"
    os.pwrite(memory, b"torn!", 4096 + 2 * 80 * 1024)  # the second picture, half of it, and not yet its number
    assert there.inputs.read() is None
    image.inputs.write(b"again")
    assert there.inputs.read() == b"again"
    os.pwrite(memory, (3).to_bytes(8, sys.byteorder), 0)  # a number without its octets: the check sum is that of none
    assert there.inputs.read() is None
    os.pwrite(memory, (2**40).to_bytes(8, sys.byteorder), 8 + 16 * 3)  # a length that cannot be
    assert there.inputs.read() is None
    image.close()
    there.close()


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
            octets = image.inputs.read()
            if octets is not None:
                assert octets == octets[:1] * len(octets)
                whole += 1
            assert time.monotonic() < end, f"only {whole} pictures could be read"
    finally:
        writer.kill()
        writer.wait()
        writer.stdout.close()
    image.close()


def test_the_octets_of_outputs() -> None:
    octets = output_octets({4: Outputs(0x0102, b"\x11\x22"), 5: Outputs(3, b"")})
    assert octets == bytes.fromhex("0402 0201000000000000 1122 0500 0300000000000000")


def test_who_takes_outputs_says_so_before_they_are_read(memory: int) -> None:
    """An application that takes outputs back and then sees an older number knows that nobody will send them."""
    image, there = SharedImage(memory), SharedImage(memory)
    assert there.take_outputs() is None
    image.outputs.write(output_octets({4: Outputs(1, b"\x11")}))
    image.outputs.write(output_octets({4: Outputs(2, b"\x22")}))
    assert (image.outputs.newest, image.outputs_taken.value) == (2, 0)
    assert there.take_outputs() == {4: Outputs(2, b"\x22")}
    assert image.outputs_taken.value == 2
    assert there.take_outputs() is None
    numbers = {no_limit() for _ in range(3)}
    assert len(numbers) == 3
    assert min(numbers) >= 2**63 - 1
    image.close()
    there.close()


def test_words_and_counters(memory: int) -> None:
    image, there = SharedImage(memory), SharedImage(memory)
    image.heartbeat.value, image.order_taken.value, image.silences.value = 2**64 - 1, 2, 3
    assert (there.heartbeat.value, there.order_taken.value, there.silences.value) == (2**64 - 1, 2, 3)
    assert there.outputs_taken.value == 0
    most = bytes(range(256)) * (image.counters.limit // 256)
    image.counters.write(most)
    image.inputs.write(b"in")
    assert (there.counters.read(), there.inputs.read()) == (most, b"in")
    image.close()
    there.close()
