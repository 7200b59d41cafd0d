"""The codec against construct, and against itself turned round."""

from __future__ import annotations

from typing import Any

import construct as c
from hypothesis import given
from hypothesis import strategies as st

from dpstack.fdl.codec import (
    claimed,
    decode,
    encode,
    parse,
    plain_frame_of,
)
from dpstack.fdl.telegram import SHORT_ACK, Kind, Telegram, token
from tests.fdl.fc_octets import REQUEST_FCS


# --- construct as the oracle ------------------------------------------------------------------------------------------
def _sum(octets: bytes) -> int:
    total = 0
    for octet in octets:
        total += octet
    return total % 256


SD1_FRAME = c.Struct(
    "start" / c.Const(b"\x10"),
    "body" / c.RawCopy(c.Struct("da" / c.Byte, "sa" / c.Byte, "fc" / c.Byte)),
    "fcs" / c.Checksum(c.Byte, _sum, c.this.body.data),
    "end" / c.Const(b"\x16"),
)
SD2_FRAME = c.Struct(
    "start" / c.Const(b"\x68"),
    "le" / c.Rebuild(c.Byte, lambda ctx: 3 + len(ctx.body["value"]["unit"])),
    "ler" / c.Rebuild(c.Byte, c.this.le),
    c.Check(c.this.le == c.this.ler),
    "start2" / c.Const(b"\x68"),
    "body"
    / c.RawCopy(c.Struct("da" / c.Byte, "sa" / c.Byte, "fc" / c.Byte, "unit" / c.Bytes(lambda ctx: ctx._.le - 3))),
    "fcs" / c.Checksum(c.Byte, _sum, c.this.body.data),
    "end" / c.Const(b"\x16"),
)
SD3_FRAME = c.Struct(
    "start" / c.Const(b"\xa2"),
    "body" / c.RawCopy(c.Struct("da" / c.Byte, "sa" / c.Byte, "fc" / c.Byte, "unit" / c.Bytes(8))),
    "fcs" / c.Checksum(c.Byte, _sum, c.this.body.data),
    "end" / c.Const(b"\x16"),
)

addresses = st.integers(0, 126)
saps = st.none() | st.integers(0, 63)
fcs_octets = st.sampled_from(sorted(REQUEST_FCS.values())) | st.integers(0, 0x7F)


@st.composite
def sd2_telegrams(draw: st.DrawFn) -> Telegram:
    dsap, ssap, dseg, sseg = (draw(saps) for _ in range(4))
    extensions = sum(x is not None for x in (dsap, ssap, dseg, sseg))
    data = draw(st.binary(min_size=0 if extensions else 1, max_size=246 - extensions))
    da = draw(st.integers(0, 127))
    return Telegram(Kind.SD2, da, draw(addresses), draw(fcs_octets), dsap, ssap, data, dseg, sseg)


sd1_telegrams = st.tuples(st.integers(0, 127), addresses, fcs_octets).map(lambda t: Telegram(Kind.SD1, *t))
tokens = st.tuples(addresses, addresses).map(lambda t: token(*t))
telegrams = st.one_of(sd2_telegrams(), sd1_telegrams, tokens, st.just(SHORT_ACK))


def unit_of(t: Telegram) -> bytes:
    """The data unit with its extension octets, written down independently of the codec."""
    unit = b""
    for sap, segment in ((t.dsap, t.dseg), (t.ssap, t.sseg)):
        if segment is not None:
            unit += bytes((0x40 + segment + (0x80 if sap is not None else 0),))
        if sap is not None:
            unit += bytes((sap,))
    return unit + t.data


def build(frame: Any, t: Telegram) -> bytes:
    da = t.da + (0x80 if t.dsap is not None or t.dseg is not None else 0)
    sa = t.sa + (0x80 if t.ssap is not None or t.sseg is not None else 0)
    value = {"da": da, "sa": sa, "fc": t.fc, "unit": unit_of(t)}
    octets = frame.build({"body": {"value": value}})
    assert isinstance(octets, bytes)
    return octets


@given(sd2_telegrams())
def test_sd2_agrees_with_construct(telegram: Telegram) -> None:
    octets = build(SD2_FRAME, telegram)
    assert encode(telegram) == octets
    assert decode(octets) == telegram
    assert SD2_FRAME.parse(encode(telegram)).body.value.unit == unit_of(telegram)


@given(sd1_telegrams)
def test_sd1_agrees_with_construct(telegram: Telegram) -> None:
    octets = build(SD1_FRAME, telegram)
    assert encode(telegram) == octets
    assert decode(octets) == telegram


@given(st.data())
def test_sd3_agrees_with_construct(data: st.DataObject) -> None:
    dsap, ssap = data.draw(saps), data.draw(saps)
    size = 8 - sum(x is not None for x in (dsap, ssap))
    payload = data.draw(st.binary(min_size=size, max_size=size))
    telegram = Telegram(Kind.SD3, data.draw(addresses), data.draw(addresses), 0x7D, dsap, ssap, payload)
    assert decode(build(SD3_FRAME, telegram)) == telegram


@given(st.integers(0, 255), st.binary(min_size=3, max_size=16), st.booleans())
def test_frames_that_construct_refuses_are_refused(start: int, rest: bytes, close: bool) -> None:
    octets = bytes((start,)) + rest
    if close and len(octets) > 4:  # make FCS and ED right, so that more than the sum is judged
        octets = octets[:-2] + bytes((_sum(octets[1:-2]), 0x16))
    frame = {0x10: SD1_FRAME, 0x68: SD2_FRAME, 0xA2: SD3_FRAME}.get(start)
    if frame is None:
        return
    try:
        frame.parse(octets)
        accepted = len(frame.build(frame.parse(octets))) == len(octets)
    except c.ConstructError:
        accepted = False
    if not accepted:
        assert decode(octets) is None


@given(telegrams)
def test_round_trip(telegram: Telegram) -> None:
    octets = encode(telegram)
    assert decode(octets) == telegram
    assert claimed(octets, 0, len(octets)) == len(octets)


@given(st.binary(min_size=1, max_size=300), st.data())
def test_garbage_never_raises(octets: bytes, data: st.DataObject) -> None:
    decode(octets)
    at = data.draw(st.integers(0, len(octets) - 1))
    end = data.draw(st.integers(at + 1, len(octets)))
    found = parse(octets, at, end)
    if isinstance(found, Telegram):
        assert claimed(octets, at, end) <= end - at


@given(telegrams, st.data())
def test_a_whole_damaged_frame_is_read_alike_in_a_stream(telegram: Telegram, data: st.DataObject) -> None:
    octets = bytearray(encode(telegram))
    for _ in range(data.draw(st.integers(0, 2))):
        octets[data.draw(st.integers(0, len(octets) - 1))] = data.draw(st.integers(0, 255))
    frame = bytes(octets[: data.draw(st.integers(1, len(octets)))]) + data.draw(st.sampled_from((b"", b"\x16")))
    found = parse(frame, 0, len(frame))
    whole = isinstance(found, Telegram) and claimed(frame, 0, len(frame)) == len(frame)
    assert decode(frame) == decode(bytearray(frame)) == (found if whole else None)
    assert decode(frame, plain_frame_of(telegram)) == (found if whole else None)


def test_answers_with_one_head_are_told_apart() -> None:
    first, second = (Telegram(Kind.SD2, 2, 9, 0x08, data=data) for data in (b"\x01\x02", b"\x02\x01"))
    damaged = encode(first)[:7] + b"\x01\x03" + encode(first)[9:]
    for _ in range(2):
        assert decode(encode(first)) == first
        assert decode(damaged) is None
        assert decode(encode(first)) == first
        assert decode(encode(second)) == second
