"""The texts for a diagnosis, with and without those of a GSD file: whatever the slave sends, they are plain lines."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from dpstack.dp.pdu.diag_texts import block_texts, conspicuous_text, texts_of
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.gsd.diag_texts import DiagTexts
from dpstack.gsd.parser import load_gsd
from tests.fuzz.frame import Target, assert_plain

_FILE: Final = Path(__file__).resolve().parent.parent.parent / "gsd" / "files" / "diagnosis.gsd"
_DEVICE: Final = load_gsd(_FILE.read_bytes()).device
_MODULE: Final = _DEVICE.modules[0]
_TEXTS: Final = (None, DiagTexts(_DEVICE), DiagTexts(_DEVICE, (_MODULE, None, _MODULE)))


def run(octets: bytes) -> None:
    """The first octet chooses texts, DP-V1 and data exchange; the others are the answer of the slave."""
    how = octets[0] if octets else 0
    found = Diagnosis.parse(octets[1:])
    if found is None:
        return
    texts, dpv1, exchanging = _TEXTS[how % 3], bool(how & 0x40), bool(how & 0x80)
    lines = block_texts(found, texts, dpv1=dpv1)
    for line in (*lines, conspicuous_text(found, texts, dpv1=dpv1, exchanging=exchanging), found.ext_finding or ""):
        assert_plain(line)
    assert len(texts_of(found.blocks, texts, dpv1=dpv1, messages=False)) <= len(lines)
    if any(found.ext_rest):
        assert found.ext_rest.hex(" ") in lines[-1]


def repair(octets: bytes) -> bytes:
    """Give each block of the extended diagnosis a length that is not beyond its end."""
    out, at = bytearray(octets), 7
    while at < len(out):
        kind, size = out[at] >> 6, out[at] & 0x3F
        if kind < 2:
            size = min(max(size % 24, 2), len(out) - at)
            out[at] = kind << 6 | size
        at += size if kind < 2 else 3 if kind == 2 else 1
    return bytes(out)


TARGET = Target(
    run,
    covers=("dpstack.dp.pdu", "dpstack.gsd.diag_texts"),
    max_len=48,
    repair=repair,
    words=(b"\x08\x81\x00\x00\x01\x00\x00\x00", b"\x80\x10\x30", b"\x44\x01\x00\x00", b"\x07\x82\x00\x00\xe4\x00\x00"),
)
