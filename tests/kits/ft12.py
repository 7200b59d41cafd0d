"""Telegrams of two protocols that share frames and check sum with PROFIBUS (IEC 60870-5-1, FT1.2): M-Bus and IEC 101.

M-Bus: examples of "The M-Bus: A Documentation", rev. 4.8 (M-Bus Usergroup), which EN 13757-2 and -3 took over; the two
RSP_UD stand in its chapter 6 (m-bus.com, documentation wired, 06 application layer). The others and their chapters were
written down from memory; a test holds lengths and check sums. IEC: IEC 60870-5-101 with the link layer of IEC
60870-5-2; made after the layouts there (C and A of each service, ASDU of each type), for link address 1 and common
address 1. Two conversations are recordings, as their comments say.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import cycle, islice
from typing import Final

SC: Final = b"\xe5"


def _octets(*lines: str) -> tuple[bytes, ...]:
    return tuple(map(bytes.fromhex, lines))


#: a master that reads meters: SND_NKE, REQ_UD2 with turning FCB, and their answers (5.5, 6.3)
MBUS_READING: Final = _octets(
    "10 40 01 41 16",
    "E5",
    "10 7B 01 7C 16",
    # RSP_UD, variable data: water meter 12345678, two values (6.3.1, and appendix of the documentation)
    "68 1F 1F 68 08 02 72 78 56 34 12 24 40 01 07 55 00 00 00 03 13 15 31 00 DA 02 3B 13 01 8B 60 04 37 18 02 18 16",
    "10 5B 01 5C 16",
    # RSP_UD, fixed data: meter 12345678 (6.3.1)
    "68 13 13 68 08 05 73 78 56 34 12 0A 00 E9 7E 01 00 00 00 35 01 00 00 3C 16",
    "10 5B FE 59 16",
    "10 7B FD 78 16",
)
#: a master that writes: SND_UD and its acknowledgement E5 (6.1, 6.4.2, 7.1)
MBUS_WRITING: Final = _octets(
    "68 06 06 68 53 FE 51 01 7A 08 25 16",  # set the primary address to 8
    "E5",
    "68 0D 0D 68 53 FE 51 07 79 04 03 02 01 24 40 01 04 95 16",  # set the complete identification
    "E5",
    "68 0F 0F 68 53 FE 51 0C 79 78 56 34 12 0C 06 07 01 00 00 55 16",  # set identification number and counter
    "E5",
    "68 03 03 68 53 FE BD 0E 16",  # to 9600 bit/s
    "E5",
    "68 03 03 68 53 FE 50 A1 16",  # application reset
    "E5",
    "68 04 04 68 53 FE 50 10 B1 16",  # application reset, sub-code 10: user data
    "E5",
    "68 0B 0B 68 53 FD 52 78 56 34 12 FF FF FF FF B2 16",  # select the meter with secondary address 12345678
    "E5",
    "68 0B 0B 68 53 FD 52 FF FF FF FF FF FF FF FF 9A 16",  # select every meter
    "E5",
)
#: unbalanced, link address of one octet: reset, status, general interrogation, classes 1 and 2
IEC101: Final = _octets(
    "10 49 01 4A 16",
    "10 0B 01 0C 16",
    "10 40 01 41 16",
    "10 00 01 01 16",
    "10 7A 01 7B 16",
    "68 09 09 68 08 01 46 01 04 01 00 00 00 55 16",  # M_EI_NA_1: end of initialisation
    "68 09 09 68 73 01 64 01 06 01 00 00 14 F4 16",  # C_IC_NA_1: general interrogation
    "E5",
    "10 5A 01 5B 16",
    "68 09 09 68 28 01 64 01 07 01 00 00 14 AA 16",  # confirmed
    "10 7A 01 7B 16",
    "68 0A 0A 68 28 01 01 02 14 01 01 00 01 00 43 16",  # M_SP_NA_1: single points
    "10 5A 01 5B 16",
    "68 09 09 68 08 01 64 01 0A 01 00 00 14 8D 16",  # ended
    "10 7B 01 7C 16",
    "10 09 01 0A 16",
    "10 5B 01 5C 16",
    "E5",
)


def frame(control: int, link: bytes, asdu: bytes) -> bytes:
    """A frame of variable length."""
    body = bytes((control, *link)) + asdu
    return bytes((0x68, len(body), len(body), 0x68)) + body + bytes((sum(body) & 0xFF, 0x16))


def fixed(control: int, link: bytes) -> bytes:
    """A frame of fixed length."""
    body = bytes((control, *link))
    return b"\x10" + body + bytes((sum(body) & 0xFF, 0x16))


#: the same with a link address of two octets (IEC 60870-5-101, 6.1): its fixed frames have the length of SD1
IEC101_WIDE: Final = _octets(
    "10 49 01 00 4A 16",
    "10 0B 01 00 0C 16",
    "10 40 01 00 41 16",
    "10 00 01 00 01 16",
    "68 0B 0B 68 53 01 00 64 01 06 01 00 00 00 14 D4 16",
    "10 00 01 00 01 16",
    "10 7A 01 00 7B 16",
    "68 0B 0B 68 08 01 00 64 01 07 01 00 00 00 14 8A 16",
    "10 5B 01 00 5C 16",
    "10 09 01 00 0A 16",
)
#: balanced: both ends send requests, DIR (bit 7 of the control field) says which one
IEC101_BALANCED: Final = _octets(
    "10 C9 01 CA 16",
    "10 0B 01 0C 16",
    "10 C0 01 C1 16",
    "10 00 01 01 16",
    "68 09 09 68 F3 01 64 01 06 01 00 00 14 74 16",
    "10 00 01 01 16",
    "68 09 09 68 53 01 64 01 07 01 00 00 14 D5 16",
    "10 80 01 81 16",
    "68 0A 0A 68 73 01 01 02 14 01 01 00 01 00 8E 16",
    "E5",
)

#: recorded at a gas meter (hottis.de, "M-Bus Master, Part 4 (Gas)", 2013): it gets address 40h, is reset and read
MBUS_RECORDED: Final = _octets(
    "68 06 06 68 53 FE 51 01 7A 40 5D 16",
    "E5",
    "10 40 40 80 16",
    "E5",
    "10 5B 40 9B 16",
    "68 56 56 68 08 40 72 43 60 52 00 77 04 14 03 CA 10 00 00 0C 78 76 03 01 10 0D 7C 08 44 49 "
    "20 2E 74 73 75 63 0A 30 30 30 30 30 30 30 30 30 30 04 6D 38 15 AA 19 02 7C 09 65 6D 69 74 "
    "20 2E 74 61 62 22 0C 04 13 C1 0E 00 00 04 93 7F 4E 01 00 00 44 13 5D 08 00 00 0F 01 00 1F "
    "DE 16",
)
#: recorded at a gateway (communication log in the user manual of leandc): reset of the link, clock, interrogation
IEC101_RECORDED: Final = _octets(
    "10 40 01 41 16",
    "10 00 01 01 16",
    "68 0F 0F 68 73 01 67 01 06 01 00 00 42 86 0E 11 CB 05 0D A7 16",
    "10 20 01 21 16",
    "68 09 09 68 53 01 64 01 06 01 00 00 14 D4 16",
)

CONVERSATIONS: Final = {
    "M-Bus recording": MBUS_RECORDED,
    "IEC 101 recording": IEC101_RECORDED,
    "M-Bus reading": MBUS_READING,
    "M-Bus writing": MBUS_WRITING,
    "M-Bus reading and writing": MBUS_READING + MBUS_WRITING,
    "IEC 101": IEC101,
    "IEC 101, link address of two octets": IEC101_WIDE,
    "IEC 101 balanced": IEC101_BALANCED,
}


def repeated(telegrams: tuple[bytes, ...], count: int) -> Iterator[bytes]:
    """The first ``count`` telegrams of a conversation that goes round and round."""
    return islice(cycle(telegrams), count)
