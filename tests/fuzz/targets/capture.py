"""The readers of captures (pcapng, text of hex digits), and the cutter of a stream of octets."""

from __future__ import annotations

import io

from dpstack.capture.cutter import split
from dpstack.capture.pcapng import Packet, Reader
from dpstack.capture.transmission import damage_text
from dpstack.decode.source import read_transmissions
from dpstack.errors import CaptureFileError
from tests.fuzz.frame import Target, assert_plain


def run(octets: bytes) -> None:
    """The octets are a file; the file is read at once and in pieces, with the same packets and the same error."""
    assert _packets(io.BytesIO(octets)) == _packets(_Slow(octets))
    try:
        for sent in read_transmissions(io.BytesIO(octets), "fuzz"):
            assert len(sent.octets) <= len(octets)
            assert_plain(damage_text(sent.damage) if sent.damage else "")
    except CaptureFileError as error:
        assert_plain(str(error))
    assert b"".join(split(octets)) == octets


def _packets(file: io.BytesIO | _Slow) -> tuple[list[Packet], str, str]:
    """Packets, the error and what was cut off."""
    reader = Reader(file, "fuzz")
    found: list[Packet] = []
    try:
        found.extend(reader)
    except CaptureFileError as error:
        assert_plain(str(error))
        return found, str(error), ""
    return found, "", reader.cut


class _Slow:
    """A pipe that delivers a few octets at a time."""

    def __init__(self, octets: bytes) -> None:
        self._octets = octets
        self._at = 0

    def read(self, size: int, /) -> bytes:
        """At most 7 octets."""
        found = self._octets[self._at : self._at + min(size, 7)]
        self._at += len(found)
        return found


def repair(octets: bytes) -> bytes:
    """Let the file begin with a section, and give each block the length that reaches the next one, twice."""
    out = bytearray(octets)
    if len(out) < 28 or out[:1] in b"0123456789abcdef":
        return octets
    out[:12] = b"\n\r\r\n\x1c\0\0\0\x4d\x3c\x2b\x1a"
    out[12:16] = b"\1\0\0\0"
    at = 0
    while at + 12 <= len(out):
        size = 28 if at == 0 else min(max(12, out[at + 4] & 0xFC), (len(out) - at) & ~3)
        if at:
            out[at] = (1, 2, 3, 6, 6, 5, 11)[out[at] % 7]
            out[at + 1 : at + 4] = b"\0\0\0"
        out[at + 4 : at + 8] = out[at + size - 4 : at + size] = size.to_bytes(4, "little")
        at += size
    return bytes(out)


TARGET = Target(
    run,
    covers=("dpstack.capture", "dpstack.decode.source"),
    max_len=240,
    repair=repair,
    words=(
        b"\n\r\r\n\x1c\0\0\0\x4d\x3c\x2b\x1a\1\0\0\0\xff\xff\xff\xff\xff\xff\xff\xff\x1c\0\0\0",
        b"\1\0\0\0\x14\0\0\0\x93\0\0\0\0\0\0\0\x14\0\0\0",
        b"\6\0\0\0\x28\0\0\0\0\0\0\0\0\0\0\0\1\0\0\0\6\0\0\0\6\0\0\0\x10\3\2\x49\x4e\x16\0\0\x28\0\0\0",
        b"\2\0\4\0lineZ",
        b"\x09\0\1\0\x09\0\0\0",
        b"\x0e\0\x08\0",
        b"10 03 02 49 4e 16\n",
        b"68 05 05 68 83 82 6d 3c 3e ec 16",
        b"\xd4\xc3\xb2\xa1",
        b"\x1a\x2b\x3c\x4d",
    ),
)
