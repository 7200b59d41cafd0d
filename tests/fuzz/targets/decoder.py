"""The decoder of telegrams: any octets in any pieces give the same telegrams, and each telegram is in the octets."""

from __future__ import annotations

from collections.abc import Iterator

from dpstack.fdl.codec import encode
from dpstack.fdl.decoder import Decoder
from dpstack.fdl.interface import DecoderStats
from dpstack.fdl.telegram import Kind, Telegram
from tests.fuzz.frame import Cutter, Target

_STALL_NS = 1_000
#: octets at the begin of an input that say how it is cut into pieces
_HEAD = 4


def run(octets: bytes) -> None:
    """Feed the octets behind the head as a whole, and in pieces (of one octet each, where the head says so)."""
    head, line = Cutter(octets[:_HEAD]), octets[_HEAD:]
    whole = _decoded((line,))
    assert _decoded(_pieces(line, head)) == whole
    telegrams, counters = whole
    assert counters.octets == len(line)
    assert counters.telegrams == len(telegrams)
    used = sum(_check(telegram, line) for telegram in telegrams)
    assert used + counters.skipped == len(line)


def _pieces(line: bytes, head: Cutter) -> Iterator[bytes]:
    sizes = [1 + head.octet() % 32 for _ in range(_HEAD)]
    at = count = 0
    while at < len(line):
        yield line[at : at + sizes[count % _HEAD]]
        at += sizes[count % _HEAD]
        count += 1


def _decoded(pieces: Iterator[bytes] | tuple[bytes, ...]) -> tuple[list[Telegram], DecoderStats]:
    """Telegrams and counters; the line is silent behind the last piece."""
    decoder = Decoder(stall_ns=_STALL_NS)
    found: list[Telegram] = []
    for piece in pieces:
        found += decoder.feed(piece, 0)
    assert (decoder.stall_at() == _STALL_NS) == bool(decoder.pending)
    found += decoder.stalled(_STALL_NS)
    assert not decoder.pending
    return found, decoder.stats


def _check(telegram: Telegram, line: bytes) -> int:
    """Hold ``telegram`` against the line; returns how many octets it has."""
    if telegram.kind is Kind.SD3:
        assert telegram.data in line
        return 14
    if telegram.empty_le3:
        return 9
    made = encode(telegram)
    assert len(made) > 3 or made in line
    again = Decoder(stall_ns=_STALL_NS).feed(made, 0)
    assert again == [telegram], (again, telegram)
    return len(made)


def repair(octets: bytes) -> bytes:
    """Give each frame that begins with a start octet its LE, its FCS and its ED."""
    out = bytearray(octets)
    at = _HEAD
    while at < len(out):
        at = _repaired(out, at)
    return bytes(out)


def _repaired(out: bytearray, at: int) -> int:
    start = out[at]
    if start == Kind.SD2 and at + 9 <= len(out):
        le = max(4, min(out[at + 1], 249, len(out) - at - 6))
        out[at + 1 : at + 4] = bytes((le, le, start))
        return _checked(out, at + 4, le)
    if start == Kind.SD1 and at + 6 <= len(out):
        return _checked(out, at + 1, 3)
    if start == Kind.SD3 and at + 14 <= len(out):
        return _checked(out, at + 1, 11)
    return at + 1


def _checked(out: bytearray, at: int, size: int) -> int:
    """FCS and ED behind ``size`` octets; returns the place behind them."""
    stop = at + size
    out[stop : stop + 2] = bytes((sum(out[at:stop]) & 0xFF, 0x16))
    return stop + 2


TARGET = Target(
    run,
    covers=("dpstack.fdl.codec", "dpstack.fdl.decoder"),
    max_len=120,
    repair=repair,
    words=(
        b"\xe5",
        b"\xdc\x02\x01",
        b"\x10\x03\x02\x49\x4e\x16",
        b"\x68\x05\x05\x68\x83\x82\x5d\x3c\x3e\xe0\x16",
        b"\x68" * 12,
    ),
)
