"""Telegrams of real devices, recorded by others and published: octets and where they stand.

Each line is a request ("> ") or an answer ("< "), as published. Docs: foreign.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final


@dataclass(frozen=True, slots=True)
class Recording:
    """A conversation of ``master`` with the device at ``slave``. ``source``: where it was published."""

    name: str
    source: str
    master: int
    slave: int
    text: str

    @property
    def lines(self) -> list[tuple[bool, bytes]]:
        """In order: whether it is a request, and its octets."""
        rows = (line.strip() for line in self.text.splitlines())
        return [(row[0] == ">", bytes.fromhex(row[1:])) for row in rows if row]

    @property
    def pairs(self) -> list[tuple[bytes, bytes]]:
        """Each request that was answered, and its answer."""
        lines = self.lines
        following = pairwise(lines)
        return [(asked, said) for (is_request, asked), (is_next, said) in following if is_request and not is_next]

    def sent_to(self, dsap: int) -> bytes:
        """The data of the one request to ``dsap``."""
        (data,) = {octets[9:-2] for is_request, octets in self.lines if is_request and is_to(octets, dsap)}
        return data


def is_to(octets: bytes, dsap: int) -> bool:
    """An SD2 telegram to that service access point."""
    return octets[0] == 0x68 and bool(octets[4] & 0x80) and octets[7] == dsap


#: Siemens IM 151-1 High Feature with two input modules of one octet, and a Siemens PLC: Get_Cfg before Set_Prm, DP-V1
#: status octets, and Stat_Diag (status 2 bit 1) in four diagnoses after Chk_Cfg
IM151_PLC: Final = Recording(
    "IM 151-1 and a PLC",
    "https://github.com/1161774/ProfibusSlave (main/ET200S Conversation.txt at 54f79af)",
    1,
    8,
    """
    > 68 07 07 68 FF 81 46 3A 3E 00 00 3E 16
    > 68 05 05 68 88 81 6D 3C 3E F0 16
    < 68 0B 0B 68 81 88 08 3E 3C 02 05 00 FF 80 E0 F1 16
    > 68 05 05 68 88 81 5D 3B 3E DF 16
    < 68 08 08 68 81 88 08 3E 3B 00 10 10 AA 16
    > 68 25 25 68 88 81 7D 3D 3E B8 0D 0F 0B 80 E0 00 C0 00 00 11 21 00 00 00 00 00 00 01 00 00 00 00 00 00 00 00 20 01 00 18 18 84 16
    < E5
    > 68 08 08 68 88 81 5D 3E 3E 00 10 10 02 16
    < E5
    > 68 05 05 68 88 81 7D 3C 3E 00 16
    < 68 28 28 68 81 88 08 3E 3C 00 0E 00 01 80 E0 49 00 00 00 00 00 00 00 00 14 82 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 D9 16
    > 68 05 05 68 88 81 5D 3C 3E E0 16
    < 68 28 28 68 81 88 08 3E 3C 00 0E 00 01 80 E0 49 00 00 00 00 00 00 00 00 14 82 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 D9 16
    > 68 05 05 68 88 81 7D 3C 3E 00 16
    < 68 28 28 68 81 88 08 3E 3C 00 0E 00 01 80 E0 49 00 00 00 00 00 00 00 00 14 82 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 D9 16
    > 68 05 05 68 88 81 5D 3C 3E E0 16
    < 68 28 28 68 81 88 08 3E 3C 00 0E 00 01 80 E0 49 00 00 00 00 00 00 00 00 14 82 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 D9 16
    > 68 05 05 68 88 81 7D 3C 3E 00 16
    < 68 28 28 68 81 88 08 3E 3C 00 0C 00 01 80 E0 49 00 00 00 00 00 00 00 00 14 82 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 D7 16
    > 68 07 07 68 FF 81 46 3A 3E 00 00 3E 16
    """,  # noqa: E501
)

#: Siemens IM 151-1 with an input and an output module, and pyprofibus: a full identifier-related diagnosis already
#: while it wants parameters, Station_Not_Ready once after Chk_Cfg
IM151: Final = Recording(
    "IM 151-1",
    "https://github.com/mbuesch/pyprofibus/issues/26",
    2,
    5,
    """
    > 10 05 02 49 50 16
    < 10 02 05 00 07 16
    > 68 05 05 68 85 82 6D 3C 3E EE 16
    < 68 28 28 68 82 85 08 3E 3C 02 05 00 FF 80 6A 49 00 00 00 00 00 00 00 00 14 82 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 58 16
    > 68 29 29 68 85 82 5D 3D 3E B8 1E 01 00 80 6A 01 40 01 00 11 21 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 20 01 00 20 08 00 20 08 00 85 16
    < E5
    > 68 08 08 68 85 82 7D 3E 3E 00 10 20 30 16
    < E5
    > 68 05 05 68 85 82 5D 3C 3E DE 16
    < 68 28 28 68 82 85 08 3E 3C 02 0C 00 02 80 6A 49 00 00 00 00 00 00 00 00 14 82 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 62 16
    > 68 05 05 68 85 82 7D 3C 3E FE 16
    """,  # noqa: E501
)

#: Festo CPV10 valve terminal with a DP node (16 outputs), and pyprofibus. It answers Data_Exchange, and after half a
#: second, by its watchdog, refuses it with RS
FESTO_CPV: Final = Recording(
    "Festo CPV",
    "https://github.com/mbuesch/pyprofibus/issues/19",
    2,
    8,
    """
    > 10 08 02 49 53 16
    < 10 02 08 00 0A 16
    > 68 05 05 68 88 82 6D 3C 3E F1 16
    < 68 0B 0B 68 82 88 08 3E 3C 02 05 00 FF 0A 35 D1 16
    > 68 13 13 68 88 82 5D 3D 3E B8 1E 01 00 0A 35 01 00 00 00 82 00 00 00 7B 16
    < E5
    > 68 06 06 68 88 82 7D 3E 3E 21 24 16
    < E5
    > 68 05 05 68 88 82 5D 3C 3E E1 16
    < 68 0B 0B 68 82 88 08 3E 3C 00 0C 00 02 0A 35 D9 16
    """,
)
#: what the same terminal said to Data_Exchange when its watchdog had run out
FESTO_RS: Final = bytes.fromhex("10 02 08 03 0D 16")

#: The slave of Texas Instruments' industrial communication kit (Sitara), and pyprofibus as master 99
TI_SITARA: Final = Recording(
    "TI Sitara",
    "https://github.com/mbuesch/pyprofibus/issues/7",
    99,
    2,
    """
    > 10 02 63 49 AE 16
    < 10 63 02 00 65 16
    > 68 05 05 68 82 E3 6D 3C 3E 4C 16
    < 68 0B 0B 68 E3 82 08 3E 3C 02 05 00 FF 0C DA D3 16
    > 68 0F 0F 68 82 E3 5D 3D 3E B8 05 01 00 0C DA 01 40 00 00 22 16
    < E5
    """,
)

#: Siemens ASM 754 (an RFID interface, four words each way) in data exchange with a PLC: Data_Exchange, then Write and
#: Read of class 1 from service access point 54 of the master. The manual prints 00 where the FCS stands, and shows
#: no FCB: FC is left as printed
ASM754: Final = Recording(
    "ASM 754",
    "Siemens, function manual FC 45 (J31069-D0167-U001-A2-7618, release 03/2006), page B-25",
    2,
    3,
    """
    > 68 0B 0B 68 03 02 5D 00 00 00 00 00 00 00 00 00 16
    < 68 0B 0B 68 02 03 08 80 00 80 00 80 00 80 00 00 16
    > 68 0B 0B 68 03 02 7D 80 00 80 00 80 00 80 00 00 16
    < 68 0B 0B 68 02 03 08 80 00 80 00 80 00 80 00 00 16
    > 68 0B 0B 68 03 02 5D 80 00 80 00 80 00 80 00 00 16
    < 68 0B 0B 68 02 03 08 88 00 88 00 88 00 88 00 00 16
    > 68 0B 0B 68 03 02 7D 00 00 00 00 00 00 00 00 00 16
    < 68 0B 0B 68 02 03 08 88 00 88 00 88 00 88 00 00 16
    > 68 0B 0B 68 03 02 5D 00 00 00 00 00 00 00 00 00 16
    < 68 0B 0B 68 02 03 08 08 00 08 00 08 00 08 00 00 16
    > 68 0F 0F 68 83 82 5C 33 36 5F 01 68 06 05 00 00 00 2B 02 00 16
    < E5
    > 68 05 05 68 83 82 5C 33 36 00 16
    < 68 09 09 68 82 83 08 36 33 5F 01 68 06 00 16
    > 68 0B 0B 68 03 02 7D 00 00 00 00 00 00 00 00 00 16
    < 68 0B 0B 68 02 03 08 08 00 08 00 08 00 10 00 00 16
    > 68 09 09 68 83 82 5C 33 36 5E 01 68 06 00 16
    < E5
    > 68 05 05 68 83 82 5C 33 36 00 16
    < 68 0F 0F 68 82 83 08 36 33 5E 01 68 06 05 00 00 00 00 00 00 16
    """,
)

#: A device with 16 octets in and 1 out, as its answers stand in the tests of a public master: Ext_Diag_Overflow
#: (status 3 bit 7) without any extended diagnosis. Its master repeats FC 6D (FCV 0, FCB 1) for ever
TOIT: Final = Recording(
    "toit-profibus",
    "https://github.com/Consibio/toit-profibus (tests/dp_test.toit at 1f3ea4c)",
    2,
    20,
    """
    > 68 05 05 68 94 82 6D 3C 3E FD 16
    < 68 0B 0B 68 82 94 08 3E 3C 02 05 80 FF 06 D1 F5 16
    > 68 07 07 68 94 82 6D 3E 3E 9F A0 3E 16
    > 68 0C 0C 68 94 82 6D 3D 3E 80 01 01 00 06 D1 00 57 16
    > 68 04 04 68 14 02 6D 01 84 16
    """,
)

#: those whose octets are whole: FCS and all
WHOLE: Final = (IM151_PLC, IM151, FESTO_CPV, TI_SITARA, TOIT)

#: Siemens LOGO! 0BA6 and its text display: they took PROFIBUS's name and start octet, but LE has two octets.
#: https://github.com/brickpool/logo (extras/de-DE/Dekodierung/TD-Dekodierung.md)
LOGO_TD: Final = (
    bytes.fromhex("68 00 09 00 09 68 80 7F 06 06 01 01 00 01 03 11 16"),
    bytes.fromhex("68 00 10 00 10 68 7F 80 06 06 01 01 00 08 03 01 00 00 00 00 7B C4 58 16"),
    bytes.fromhex("68 00 0A 00 0A 68 80 7F 06 06 01 01 00 02 09 11 29 16"),
    bytes.fromhex("68 00 09 00 09 68 80 7F 06 06 01 01 00 01 10 1E 16"),
    bytes.fromhex("68 00 10 00 10 68 7F 80 06 06 01 01 00 08 10 10 05 12 08 02 03 01 5A 16"),
)


def completed(octets: bytes, fcb: int | None = None) -> bytes:
    """A telegram printed without FCS, with it; ``fcb`` 0 or 1 sets the FCB of a request."""
    body = bytearray(octets[4:-2])
    if fcb is not None:
        body[2] = (body[2] & ~0x20) | 0x20 * fcb
    return octets[:4] + bytes(body) + bytes((sum(body) & 0xFF, 0x16))
