"""Decoding in several threads: the frame that is kept for each head is one for the whole process."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Sequence
from types import FrameType
from typing import Any

import pytest

from dpstack.fdl.codec import decode, plain_frame_of
from dpstack.fdl.decoder import Decoder
from dpstack.fdl.telegram import Kind, Telegram

# inputs 01 02 and FE FC of slave 5: answers with one head and another FCS
FIRST = bytes.fromhex("68 05 05 68 02 05 08 01 02 12 16")
SECOND = bytes.fromhex("68 05 05 68 02 05 08 FE FC 09 16")
ANSWERS = {
    FIRST: Telegram(Kind.SD2, 2, 5, 0x08, data=b"\x01\x02"),
    SECOND: Telegram(Kind.SD2, 2, 5, 0x08, data=b"\xfe\xfc"),
}


def _expecting() -> Callable[[bytes], Telegram | None]:
    """A receiver that expects the head of these answers, as a master does after its request."""
    decoder, expected = Decoder(stall_ns=1), plain_frame_of(ANSWERS[FIRST])
    return lambda octets: decoder.whole(octets, expected)


def _plain() -> Callable[[bytes], Telegram | None]:
    return decode


WAYS = pytest.mark.parametrize("way", [_plain, _expecting], ids=["decode", "expected answer"])


@WAYS
def test_threads_get_their_own_telegrams(way: Callable[[], Callable[[bytes], Telegram | None]]) -> None:
    wrong: list[Telegram | None] = []
    start = threading.Barrier(2)

    def decode_often() -> None:
        read = way()
        start.wait()
        for _ in range(60_000):
            for octets, right in ANSWERS.items():
                found = read(octets)
                if found != right:
                    wrong.append(found)

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        threads = [threading.Thread(target=decode_often) for _ in range(2)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        sys.setswitchinterval(interval)
    assert wrong == []


@WAYS
def test_another_thread_may_run_between_any_two_steps(way: Callable[[], Callable[[bytes], Telegram | None]]) -> None:
    """Decode beside one instruction of a decoding what another thread may decode there, for each instruction."""
    read, other = way(), way()
    steps = 0

    def at_step(chosen: int, between: Sequence[bytes]) -> Callable[[FrameType, str, Any], Any]:
        def trace(frame: FrameType, event: str, _: Any) -> Any:
            nonlocal steps
            frame.f_trace_opcodes = True
            if event == "opcode":
                steps += 1
                if steps == chosen:
                    sys.settrace(None)
                    assert [other(one) for one in between] == [ANSWERS[one] for one in between]
                    sys.settrace(trace)
            return trace

        return trace

    before = sys.gettrace()
    for between in ((FIRST, SECOND), (SECOND, FIRST), (SECOND,)):
        chosen = 0
        while chosen <= steps:  # until the last step of the run before
            other(SECOND)
            chosen, steps = chosen + 1, 0
            sys.settrace(at_step(chosen, between))
            try:
                found = read(FIRST)
            finally:
                sys.settrace(before)
            assert found == ANSWERS[FIRST]
            assert [read(one) for one in ANSWERS] == list(ANSWERS.values())
        assert chosen > 30
