"""The codec against literal octets from bus logs: requests, responses, flaws, misuse."""

from __future__ import annotations

import pytest
from support import present

from dpstack.fdl.codec import (
    SC_OCTETS,
    Flaw,
    claimed,
    decode,
    encode,
    encode_sd1,
    encode_sd2,
    encode_token,
    fcs,
    parse,
    request_octets,
)
from dpstack.fdl.telegram import SHORT_ACK, Kind, Req, Resp, StationType, Telegram, token
from tests.fdl.fc_octets import REQUEST_FCS

# Bus logs (docs/reference/protocol.md#known-telegrams) and what they say, by hand.
VECTORS: list[tuple[str, Telegram]] = [
    ("68 05 05 68 82 E3 6D 3C 3E 4C 16", Telegram(Kind.SD2, 2, 99, 0x6D, 60, 62)),
    (
        "68 0B 0B 68 E3 82 08 3E 3C 02 05 00 FF 0C DA D3 16",
        Telegram(Kind.SD2, 99, 2, 0x08, 62, 60, b"\x02\x05\x00\xff\x0c\xda"),
    ),
    (
        "68 0F 0F 68 82 E3 5D 3D 3E B8 05 01 00 0C DA 01 40 00 00 22 16",
        Telegram(Kind.SD2, 2, 99, 0x5D, 61, 62, b"\xb8\x05\x01\x00\x0c\xda\x01\x40\x00\x00"),
    ),
    ("10 02 63 49 AE 16", Telegram(Kind.SD1, 2, 99, 0x49)),
    ("10 63 02 00 65 16", Telegram(Kind.SD1, 99, 2, 0x00)),
    ("68 06 06 68 88 82 7D 3E 3E 21 24 16", Telegram(Kind.SD2, 8, 2, 0x7D, 62, 62, b"\x21")),
    (
        "68 0B 0B 68 82 88 08 3E 3C 00 0C 00 02 0A 35 D9 16",
        Telegram(Kind.SD2, 2, 8, 0x08, 62, 60, b"\x00\x0c\x00\x02\x0a\x35"),
    ),
    # made by hand from the frame layouts
    ("DC 03 02", token(3, 2)),
    ("DC 00 00", token(0, 0)),
    ("E5", SHORT_ACK),
    ("68 04 04 68 03 02 7D FF 81 16", Telegram(Kind.SD2, 3, 2, 0x7D, data=b"\xff")),
    ("68 07 07 68 FF 82 46 3A 3E 02 00 41 16", Telegram(Kind.SD2, 127, 2, 0x46, 58, 62, b"\x02\x00")),
    ("68 05 05 68 83 82 5D 00 32 94 16", Telegram(Kind.SD2, 3, 2, 0x5D, 0, 50)),  # SAP 0 is a SAP
    ("68 04 04 68 83 02 5D 00 E2 16", Telegram(Kind.SD2, 3, 2, 0x5D, dsap=0)),
    ("68 04 04 68 03 82 5D 3F 21 16", Telegram(Kind.SD2, 3, 2, 0x5D, ssap=63)),
    # segment and SAP of DA (C1 3C), then of SA (42)
    (
        "68 07 07 68 83 82 6D C1 3C 42 AA 5B 16",
        Telegram(Kind.SD2, 3, 2, 0x6D, 60, None, b"\xaa", 1, 2),
    ),
]
IDS = [f"{t.kind.name}-{n}" for n, (_, t) in enumerate(VECTORS)]
SD3_OCTETS = bytes.fromhex("A2 03 02 7D 01 02 03 04 05 06 07 08 A6 16")
SD3_SAPS = bytes.fromhex("A2 83 82 5D 3D 3E 88 01 01 0B 06 96 0E 16")


@pytest.mark.parametrize(("octets", "telegram"), VECTORS, ids=IDS)
def test_vectors_both_ways(octets: str, telegram: Telegram) -> None:
    raw = bytes.fromhex(octets)
    assert decode(raw) == telegram
    assert encode(telegram) == raw


def test_sd3_is_accepted_and_never_sent() -> None:
    plain = Telegram(Kind.SD3, 3, 2, 0x7D, data=bytes(range(1, 9)))
    assert decode(SD3_OCTETS) == plain
    assert decode(SD3_SAPS) == Telegram(Kind.SD3, 3, 2, 0x5D, 61, 62, bytes.fromhex("88 01 01 0B 06 96"))
    with pytest.raises(ValueError, match="SD3"):
        encode(plain)


def test_empty_sd2_is_accepted_and_never_sent() -> None:
    telegram = decode(bytes.fromhex("68 03 03 68 02 03 08 0D 16"))
    assert telegram == Telegram(Kind.SD2, 2, 3, 0x08)
    assert telegram is not None
    assert telegram.empty_le3
    with pytest.raises(ValueError, match="LE = 3"):
        encode(telegram)
    assert not any(t.empty_le3 for _, t in VECTORS)


def test_fcs_is_the_sum_without_carry() -> None:
    assert fcs(bytes.fromhex("82 E3 6D 3C 3E")) == 0x4C
    assert fcs(b"") == 0
    assert fcs(b"\xff\x02") == 1


@pytest.mark.parametrize("octet", [0x00, 0x01, 0x7F, 0xFF])
@pytest.mark.parametrize("size", [1, 2, 127, 128, 245, 246])
def test_fcs_of_every_length(octet: int, size: int) -> None:
    data = bytes([octet]) * size
    raw = bytes([0x68, 3 + size, 3 + size, 0x68, 2, 5, 8, *data, (15 + size * octet) % 256, 0x16])
    assert encode_sd2(2, 5, 8, data) == raw
    assert decode(raw) == Telegram(Kind.SD2, 2, 5, 8, data=data)
    assert decode(raw[:-2] + bytes([(raw[-2] + 1) % 256, 0x16])) is None


@pytest.mark.parametrize(("function", "fc"), REQUEST_FCS.items())
@pytest.mark.parametrize("count", [0x00, 0x10, 0x20, 0x30])
def test_every_request_function(function: Req, fc: int, count: int) -> None:
    octets = bytes((0x10, 3, 2, fc | count, (5 + (fc | count)) & 0xFF, 0x16))
    telegram = present(decode(octets))
    assert telegram.is_request
    assert telegram.function == function & 0x0F
    assert encode_sd1(3, 2, fc | count) == octets


@pytest.mark.parametrize("status", Resp)
@pytest.mark.parametrize("station", StationType)
def test_every_response_status(status: Resp, station: StationType) -> None:
    fc = station << 4 | status
    telegram = present(decode(bytes((0x10, 2, 3, fc, 5 + fc, 0x16))))
    assert not telegram.is_request
    assert telegram.function == status
    assert telegram.station_type is station


@pytest.mark.parametrize("fc", [fc for fc in range(0x80, 0x100) if fc & 0xCF != 0xC0])
def test_bit_7_of_fc_is_only_the_clock_values(fc: int) -> None:
    assert parse(bytes((0x10, 3, 2, fc, (5 + fc) & 0xFF, 0x16)), 0, 6) is Flaw.BAD_FC
    assert parse(bytes((0x68, 4, 4, 0x68, 3, 2, fc, 0, (5 + fc) & 0xFF, 0x16)), 0, 10) is Flaw.BAD_FC


def test_token_and_short_ack_have_no_fc() -> None:
    for telegram in (SHORT_ACK, token(1, 2)):
        assert not telegram.is_request
        assert telegram.fc < 0


# --- what is wrong with it --------------------------------------------------------------------------------------------
FLAWS: list[tuple[str, Flaw]] = [
    ("00", Flaw.BAD_START),
    ("16", Flaw.BAD_START),
    ("68 02 02", Flaw.LE_RANGE),
    ("68 00 00 68 16 16 16 16 16", Flaw.LE_RANGE),
    ("68 02 02 68 03 02 05 16 16", Flaw.LE_RANGE),
    ("68 FA FA", Flaw.LE_RANGE),
    ("68 FA FA 68 03 02 05 16 16", Flaw.LE_RANGE),
    ("68 FF FF", Flaw.LE_RANGE),
    ("68 05 04", Flaw.LE_MISMATCH),
    ("68 02 05", Flaw.LE_RANGE),
    ("68 05 04 68 82 E3 6D 3C 3E 4C 16", Flaw.LE_MISMATCH),
    ("68 05 05 60", Flaw.BAD_SECOND_SD),
    ("68 05 05 60 82 E3 6D 3C 3E 4C 16", Flaw.BAD_SECOND_SD),
    ("68 04 04 68 02 7F 08 00 89 16", Flaw.BAD_ADDRESS),
    ("68 05 05 68 82 FF 08 3E 3C 03 16", Flaw.BAD_ADDRESS),
    ("68 04 04 68 02 FF 08 00 09 16", Flaw.BAD_ADDRESS),
    ("68 05 05 68 82 E3 6D 3C 3E 4D 16", Flaw.BAD_FCS),
    ("68 05 05 68 82 E3 6D 3C 3E 4C 17", Flaw.BAD_ED),
    ("68 03 03 68 82 83 08 0D 16", Flaw.BAD_EXTENSION),  # no octet for either
    ("68 04 04 68 82 83 08 3E 4B 16", Flaw.BAD_EXTENSION),  # none for SA
    ("68 04 04 68 82 03 08 BE 4B 16", Flaw.BAD_EXTENSION),  # another one announced
    ("68 05 05 68 82 03 08 BE 3C 87 16", Flaw.BAD_EXTENSION),  # two SAPs
    ("68 05 05 68 82 03 08 C1 42 90 16", Flaw.BAD_EXTENSION),  # two segments
    ("68 06 06 68 82 03 08 C1 BE 3C 48 16", Flaw.BAD_EXTENSION),  # three octets
    ("10 82", Flaw.BAD_ADDRESS),
    ("10 02 83", Flaw.BAD_ADDRESS),
    ("10 02 7F", Flaw.BAD_ADDRESS),
    ("10 82 03 08 8D 16", Flaw.BAD_ADDRESS),
    ("10 02 7F 08 89 16", Flaw.BAD_ADDRESS),
    ("10 02 03 08 0E 16", Flaw.BAD_FCS),
    ("10 02 03 08 0D 61", Flaw.BAD_ED),
    ("DC 7F", Flaw.BAD_ADDRESS),
    ("DC 80", Flaw.BAD_ADDRESS),
    ("DC 02 7F", Flaw.BAD_ADDRESS),
    ("DC 02 E5", Flaw.BAD_ADDRESS),
    ("A2 03 7F 7D 01 02 03 04 05 06 07 08 23 16", Flaw.BAD_ADDRESS),
    ("A2 03 02 7D 01 02 03 04 05 06 07 08 A7 16", Flaw.BAD_FCS),
    ("A2 03 02 7D 01 02 03 04 05 06 07 08 A6 15", Flaw.BAD_ED),
]


@pytest.mark.parametrize(("octets", "flaw"), FLAWS)
def test_flaws_are_recognised_by_the_first_octet_that_shows_them(octets: str, flaw: Flaw) -> None:
    raw = bytes.fromhex(octets)
    assert parse(raw, 0, len(raw)) is flaw
    assert decode(raw) is None
    # the octets before the telling one do not condemn it yet, unless the whole is needed
    if len(raw) < 6 and len(raw) > 1:
        assert parse(raw, 0, len(raw) - 1) is None


WHOLE = [bytes.fromhex(octets) for octets, _ in VECTORS] + [SD3_OCTETS, SD3_SAPS]


@pytest.mark.parametrize("raw", WHOLE, ids=lambda raw: raw[:8].hex())
def test_prefixes_and_trailing_octets(raw: bytes) -> None:
    for end in range(1, len(raw)):
        assert parse(raw, 0, end) is None
        assert decode(raw[:end]) is None
    telegram = decode(raw)
    for tail in (b"\x00", b"\xe5", raw, b"\x68\xff\x00"):
        assert decode(raw + tail) is None
        assert parse(raw + tail, 0, len(raw + tail)) == telegram
        assert claimed(raw + tail, 0, len(raw + tail)) == len(raw)
        assert parse(tail + raw + tail, len(tail), len(tail + raw + tail)) == telegram
        assert parse(bytearray(tail + raw), len(tail), len(tail + raw)) == telegram
    assert decode(b"") is None


@pytest.mark.parametrize("raw", WHOLE, ids=lambda raw: raw[:8].hex())
def test_a_flipped_bit_is_never_the_same_telegram(raw: bytes) -> None:
    whole = decode(raw)
    for bit in range(len(raw) * 8):
        damaged = bytearray(raw)
        damaged[bit // 8] ^= 1 << bit % 8
        found = decode(damaged)
        if raw[0] == Kind.SD4:
            assert found != whole  # nothing but its addresses protects a token
        else:
            assert found is None


@pytest.mark.parametrize("raw", [raw for raw in WHOLE if len(raw) > 3], ids=lambda raw: raw[:8].hex())
def test_two_flipped_bits_with_one_in_the_framing_are_no_telegram(raw: bytes) -> None:
    # two flipped bits can only cancel out in the sum: same bit weight, once up and once down (or a carry chain)
    whole = decode(raw)
    framing = {0, 1, 2, 3, len(raw) - 1} if raw[0] == Kind.SD2 else {0, len(raw) - 1}
    for first in range(len(raw) * 8):
        for second in range(first):
            if first // 8 in framing or second // 8 in framing:
                damaged = bytearray(raw)
                damaged[first // 8] ^= 1 << first % 8
                damaged[second // 8] ^= 1 << second % 8
                found = decode(damaged)
                assert found is None
    assert whole is not None


def test_start_octets_differ_by_four_bits() -> None:
    for i, one in enumerate(Kind):
        for other in list(Kind)[:i]:
            assert (one ^ other).bit_count() >= 4


# --- misuse -----------------------------------------------------------------------------------------------------------
def test_longest_data_unit() -> None:
    assert len(encode_sd2(3, 2, 0x5D, bytes(246))) == 255
    assert len(encode_sd2(3, 2, 0x5D, bytes(244), 61, 62)) == 255
    for data, dsap, ssap in ((247, None, None), (246, 1, None), (246, None, 1), (245, 61, 62)):
        with pytest.raises(ValueError, match="246 fit"):
            encode_sd2(3, 2, 0x5D, bytes(data), dsap, ssap)


@pytest.mark.parametrize(
    ("da", "sa", "fc"), [(128, 2, 0), (-1, 2, 0), (3, 127, 0), (3, -1, 0), (3, 2, 256), (3, 2, -1)]
)
def test_addresses_and_fc_out_of_range(da: int, sa: int, fc: int) -> None:
    with pytest.raises(ValueError, match="must be"):
        encode_sd1(da, sa, fc)
    with pytest.raises(ValueError, match="must be"):
        encode_sd2(da, sa, fc, b"\x00")
    with pytest.raises(ValueError, match="must be"):
        encode(Telegram(Kind.SD2, da, sa, fc, dseg=1, data=b"\x00"))


@pytest.mark.parametrize(("da", "sa"), [(127, 2), (2, 127), (-1, 2), (2, -1)])
def test_token_addresses_out_of_range(da: int, sa: int) -> None:
    with pytest.raises(ValueError, match="token"):
        encode_token(da, sa)


@pytest.mark.parametrize("sap", [-1, 64, 255])
def test_saps_out_of_range(sap: int) -> None:
    for dsap, ssap in ((sap, None), (None, sap), (sap, 62), (62, sap)):
        with pytest.raises(ValueError, match="SAP"):
            encode_sd2(3, 2, 0x5D, b"\x00", dsap, ssap)
    with pytest.raises(ValueError, match="segment"):
        encode(Telegram(Kind.SD2, 3, 2, 0x5D, data=b"\x00", dseg=sap))


def test_sd1_carries_nothing() -> None:
    for extra in (Telegram(Kind.SD1, 3, 2, 0, data=b"x"), Telegram(Kind.SD1, 3, 2, 0, dsap=0)):
        with pytest.raises(ValueError, match="SD1"):
            encode(extra)


def test_request_octets_takes_the_shortest() -> None:
    assert request_octets(2, 99, 0x49, b"", None, None) == bytes.fromhex("10 02 63 49 AE 16")
    assert request_octets(2, 99, 0x6D, b"", 60, 62) == bytes.fromhex("68 05 05 68 82 E3 6D 3C 3E 4C 16")
    assert request_octets(3, 2, 0x5D, b"", 0, None) == bytes.fromhex("68 04 04 68 83 02 5D 00 E2 16")
    assert SC_OCTETS == b"\xe5"


def test_the_fc_octets_that_a_telegram_may_have() -> None:
    """Bit 7 is set in a clock value request only: FC C0 to FF without bits 3 to 0."""
    good = {*range(0x80), 0xC0, 0xD0, 0xE0, 0xF0}
    for fc in range(256):
        frames = []
        for body in (bytes((3, 2, fc)), bytes((3, 2, fc, 7)), bytes((0x83, 0x82, fc, 60, 62))):
            tail = bytes((sum(body) & 0xFF, 0x16))
            size = len(body)
            frames.append(b"\x10" + body + tail if size == 3 else bytes((0x68, size, size, 0x68)) + body + tail)
        body = bytes((3, 2, fc)) + bytes(8)
        frames.append(b"\xa2" + body + bytes((sum(body) & 0xFF, 0x16)))
        for octets in frames:
            telegram = decode(octets)
            assert (telegram is not None) is (fc in good), octets.hex(" ")
            assert telegram is None or telegram.fc == fc


@pytest.mark.parametrize(
    ("octets", "end", "length"),
    [
        ("68", 1, 2),
        ("68 05", 2, 11),
        ("68 05 09", 2, 11),  # LEr has not come yet
        ("68 05 09", 3, 15),
        ("68 09 05", 3, 15),
        ("68 05 05", 3, 11),
        ("68 02 00", 3, 9),
        ("68 FF 00", 3, 255),
    ],
)
def test_the_longer_of_two_lengths_counts(octets: str, end: int, length: int) -> None:
    assert claimed(bytes.fromhex(octets), 0, end) == length
    assert claimed(b"\x00\x68" + bytes.fromhex(octets), 2, 2 + end) == length
