"""PDUs of an S7-200 over PPI, at both ends: answers as a program reads them, and any request at the simulated CPU.

The first octet chooses. Judged: an error is a PduError or UsageError in plain text; the CPU answers every request by
one PDU that can be read, fits a telegram, and keeps its sequence number; its memory keeps its size.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dpstack.errors import PduError, UsageError
from dpstack.fdl.codec import decode, encode_sd2
from dpstack.fdl.telegram import MAX_DATA, Telegram
from dpstack.ppi.addresses import parse_address
from dpstack.ppi.cpu import SIZES, CpuStation, SimulatedCpu
from dpstack.ppi.pdu import (
    clock_octets,
    fit,
    item_error,
    negotiated,
    parse_clock,
    parse_items,
    parse_pdu,
    pdu_error,
    read_items,
    read_request,
    user_data,
    write_request,
    written,
)
from tests.fuzz.frame import Cutter, Target, assert_plain, parsed

#: addresses of reads: a bit, numbers of each kind, octets, a timer and a counter
ADDRESSES: Final = tuple(map(parse_address, ("M0.3", "VW100:int", "VD8:real", "VB0[16]", "T37", "C5", "AIW4")))


def run(octets: bytes) -> None:
    """The first octet chooses the part."""
    if octets:
        _PARTS[octets[0] % len(_PARTS)](octets[1:])


def _answer(octets: bytes) -> None:
    """An answer of a CPU as a program reads it."""
    found = parsed(parse_pdu, octets, PduError)
    if found is None:
        return
    assert found.octets[:2] == octets[:2]
    assert parse_pdu(found.octets) == found
    assert_plain(pdu_error(found.error))
    count = found.parameter[1] % (len(ADDRESSES) + 1) if len(found.parameter) > 1 else 0
    for addresses in (ADDRESSES[:count], ADDRESSES[7 - count :]):
        values = parsed(lambda _, addresses=addresses: read_items(found, addresses), b"", PduError)  # type: ignore[misc]
        assert values is None or len(values) == count
    parsed(lambda _: negotiated(found), b"", PduError)
    code = parsed(lambda _: written(found), b"", PduError)
    assert_plain(item_error(code or 0))
    data = parsed(lambda _: user_data(found), b"", PduError)
    time = None if data is None else parsed(parse_clock, data, PduError)
    if time is not None:
        assert parse_clock(clock_octets(time)) == time
    parsed(lambda _: parse_items(found.parameter), b"", PduError)


def _address(octets: bytes) -> None:
    """An address as people type it; what it says is read and written."""
    script = Cutter(octets)
    value = int.from_bytes(script.take(4), "big") - (1 << 31)
    address = parsed(lambda _: parse_address(script.rest().decode("latin-1")), b"", UsageError)
    if address is None:
        return
    assert_plain(address.text)
    assert parse_address(address.text) == address
    assert fit([address] * 30) >= 1
    request = read_request(1, [address])
    assert len(parse_items(request.parameter)) == 1
    for given in (value, bool(value & 1), float(value), octets):
        written_pdu = parsed(lambda _, given=given: write_request(1, address, given), b"", UsageError)  # type: ignore[misc]
        assert written_pdu is None or parse_pdu(written_pdu.octets) == written_pdu


def _cpu(octets: bytes) -> None:
    """Requests to the simulated CPU, each behind its length."""
    cpu, script = SimulatedCpu(), Cutter(octets)
    station = CpuStation(cpu, answer_ns=0)
    for request in script.pieces():
        now = script.at * 1_000_000
        answer = parse_pdu(cpu.answer(request, now))
        asked = parsed(parse_pdu, request, PduError)
        if asked is not None:
            assert answer.sequence == asked.sequence
        if 0 < len(request) <= MAX_DATA:
            _ask(station, request, now)
    assert {name: len(part) for name, part in cpu._memory.items()} == _MEMORY


def _ask(station: CpuStation, request: bytes, now: int) -> None:
    """The same over the link layer: its answer fits a telegram."""
    first, poll = decode(encode_sd2(2, 0, 0x6C, request)), Telegram(_SD1, 2, 0, 0x5C)
    assert first is not None
    station.serve(first, now)
    reply = station.serve(poll, now)
    assert reply is not None
    assert len(reply.data) <= MAX_DATA, "an answer that fits no telegram"


_SD1: Final = decode(bytes.fromhex("10 02 00 5C 5E 16")).kind  # type: ignore[union-attr]
_MEMORY: Final = {name: len(part) for name, part in SimulatedCpu()._memory.items()}
assert _MEMORY.keys() == SIZES.keys()
_PARTS: Final[tuple[Callable[[bytes], None], ...]] = (_answer, _address, _cpu, _cpu)


def _with_lengths(pdu: bytearray) -> None:
    """Give a PDU its head and the length of its data."""
    head = 12 if pdu[1] in (2, 3) else 10
    pdu[0] = 0x32
    parameter = min(int.from_bytes(pdu[6:8], "big"), max(0, len(pdu) - head))
    pdu[6:8] = parameter.to_bytes(2, "big")
    pdu[8:10] = max(0, len(pdu) - head - parameter).to_bytes(2, "big")


def repair(octets: bytes) -> bytes:
    """Give PDUs their lengths."""
    if len(octets) < 13:
        return octets
    part, out = octets[0] % len(_PARTS), bytearray(octets)
    if part == 0:
        pdu = out[1:]
        _with_lengths(pdu)
        return bytes(out[:1] + pdu)
    if part == 1:
        return octets
    at = 1
    while at + 13 < len(out):
        size = min(max(out[at], 10), len(out) - at - 1)
        out[at] = size
        pdu = out[at + 1 : at + 1 + size]
        _with_lengths(pdu)
        out[at + 1 : at + 1 + size] = pdu
        at += 1 + size
    return bytes(out)


TARGET = Target(run, covers=("dpstack.ppi",), executions=200_000, max_len=300, repair=repair)
