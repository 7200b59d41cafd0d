"""Pasted text: lines of logs with octets, a diagnosis as a PLC gives it."""

from __future__ import annotations

import io

from dpstack.decode.diagnosis import diagnosis_lines, diagnosis_octets, diagnosis_report
from dpstack.decode.log_text import Unread
from dpstack.decode.names import SlaveNames
from dpstack.decode.source import read_transmissions
from dpstack.errors import CaptureFileError, UsageError
from dpstack.text import printable
from tests.fuzz.frame import Target


def assert_safe(text: str) -> None:
    assert text == printable(text)


def run(octets: bytes) -> None:
    """The octets are a text file; each line gives octets or a report, and no more octets than characters."""
    unread: list[Unread] = []
    count = 0
    try:
        for sent in read_transmissions(io.BytesIO(b"     " + octets), "fuzz", on_unread=unread.append):
            count += len(sent.octets)
            assert_safe(sent.note)
    except CaptureFileError as error:
        assert_safe(str(error))
    assert count <= 2 * len(octets) + 8  # a telegram of pyprofibus has LE and FCS besides, STEP 7's DW#16#0 four octets
    for line in unread:
        assert_safe(line.text)
        assert_safe(line.reason)
    try:
        found = diagnosis_octets(octets.decode("utf-8", "replace"))
        for text in diagnosis_lines(diagnosis_report(found, SlaveNames())):
            assert_safe(text)
    except UsageError as error:
        assert_safe(str(error))


TARGET = Target(
    run,
    covers=("dpstack.decode.log_text", "dpstack.decode.diagnosis", "dpstack.decode.source"),
    max_len=400,
    words=(
        b"PHY-serial: TX   68 05 05 68 82 E3 6D 3C 3E 4C 16\n",
        b"PHY-serial: RX   E5\n",
        b"FdlTelegram(sd=SD2, haveLE=True, da=0x63, sa=0x02, fc=0x08, dae=3E, sae=3C, du=02, haveFCS=True, ed=0x16)\n",
        b"00000000: 6805 0568 82e3 6d3c 3e4c 16  h..h..m<>L.\n",
        b"0000000 0568 6805 e382 3c6d 4c3e 0016\n000000b\n",
        b"0000020 ",
        b"b'h\\x05\\x05h\\x82\\xe3m<>L\\x16'\n",
        b"[104, 5, 5, 104]",
        b"B#16#08 W#16#0C00 ",
        b"08 0C 00 02 80 E0 43 02 00",
        b"20:15:31.234 -> ",
        b"  |h..h|",
        b"*\n",
    ),
)
