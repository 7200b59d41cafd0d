"""A far end that sends without end: a port hands over a bounded piece, throws the rest away in blocks and counts it."""

from __future__ import annotations

import os
from collections.abc import Callable

from dpstack.ports.fdport import CHUNK, FdPort

HANDED_OVER = 64 * CHUNK


class Line(FdPort):
    """A port on ``read`` instead of a descriptor."""

    def __init__(self, read: Callable[[int], bytes]) -> None:
        super().__init__("line", 500_000, paced=False)
        self._read = read


def test_a_backlog_is_handed_over_up_to_its_bound_and_the_rest_counted() -> None:
    near, far = os.pipe()
    os.set_blocking(near, False)
    try:
        port = Line(lambda size: os.read(near, size))
        os.write(far, bytes(60_000))
        assert len(port.read_now()) == HANDED_OVER == 30_080
        assert port.discarded == 60_000 - HANDED_OVER
        assert port.damage() == {"discarded": 60_000 - HANDED_OVER}
        assert port.read_now() == b""
        os.write(far, b"\xe5")
        assert port.read_now() == b"\xe5"
    finally:
        os.close(near)
        os.close(far)


def test_a_far_end_that_never_stops_does_not_hold_the_caller() -> None:
    reads: list[int] = []

    def endless(size: int) -> bytes:
        reads.append(size)
        return b"\x55" * size

    port = Line(endless)
    assert len(port.read_now()) == HANDED_OVER
    assert reads == [CHUNK] * 64 + [65_536] * 16
    assert port.discarded == 16 * 65_536


def test_octets_within_the_bound_are_all_delivered() -> None:
    chunks = [bytes(CHUNK)] * 10 + [b"\xe5"]
    port = Line(lambda _size: chunks.pop(0))
    assert len(port.read_now()) == 10 * CHUNK + 1
    assert port.discarded == 0
    assert port.damage() == {}
