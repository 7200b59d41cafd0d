"""Octets in lines of logs, in the forms that people paste: of pyprofibus' versions, hex dumps of several programs,
lists of code, tables. The octets are those of one request and its answer (pyprofibus#7)."""

from __future__ import annotations

import io
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.capture.transmission import Transmission
from dpstack.decode.log_text import LogReader, Unread
from dpstack.decode.source import read_transmissions
from dpstack.errors import CaptureFileError

ASK = bytes.fromhex("68 05 05 68 82 E3 6D 3C 3E 4C 16")
ANSWER = bytes.fromhex("68 0B 0B 68 E3 82 08 3E 3C 02 05 00 FF 0C DA D3 16")
STATUS = bytes.fromhex("10 02 63 49 AE 16")
SC = b"\xe5"


def read(text: str | bytes) -> tuple[list[bytes], list[Unread], list[str]]:
    """The octets of each transmission, the lines without octets, and what stood before the octets."""
    unread: list[Unread] = []
    octets = text if isinstance(text, bytes) else text.encode()
    found = list(read_transmissions(io.BytesIO(octets), "log", on_unread=unread.append))
    return [one.octets for one in found], unread, [one.note for one in found]


@pytest.mark.parametrize(
    ("text", "octets"),
    [
        # pyprofibus from 1.2 on, 1.0, its dummy, mails that quote it
        ("PHY-serial: TX   68 05 05 68 82 E3 6D 3C 3E 4C 16\nPHY-serial: RX   E5", [ASK, SC]),
        ("PHY-serial: TX 6805056882e36d3c3e4c16", [ASK]),
        ("PHY-fpga: RX   10 02 63 49 AE 16", [STATUS]),
        ("CpPhyDummySlave: Sending SRD  10 02 63 49 AE 16\nCpPhyDummySlave: Receiving    E5", [STATUS, SC]),
        ("> > PHY-serial: TX 10 02 63 49 AE 16", [STATUS]),
        ("PHY-serial: RX (fragment)   E7 A7 DA", [b"\xe7\xa7\xda"]),
        # the UART decoder of sigrok-cli, with numbers of samples; of PulseView
        ("\n".join(f"uart-1: {octet:02X}" for octet in STATUS + ASK), [STATUS, ASK]),
        ("\n".join(f"115680-119520 uart-1: {octet:02X}" for octet in ASK + SC), [ASK, SC]),
        ("\n".join(f"11568-11952 UART: RX data: {octet:02X}" for octet in STATUS), [STATUS]),
        # signs between octets, the quotation marks of forums
        ("10|02|63|49|ae|16\n| E5 | 10 | 02 | 63 | 49 | AE | 16 |", [STATUS, SC, STATUS]),
        ("<10><02><63><49><ae><16>", [STATUS]),
        ("„10 02 63 49 AE 16“\nTX “E5”", [STATUS, SC]),
        # its sniffer prints fields, without LE and FCS
        (
            "FdlTelegram(sd=SD1, haveLE=False, da=0x02, sa=0x63, fc=0x49, dae=Empty, sae=Empty, du=None, "
            "haveFCS=True, ed=0x16)",
            [STATUS],
        ),
        (
            "FdlTelegram(sd=SD2, haveLE=True, da=0x63, sa=0x02, fc=0x08, dae=3E, sae=3C, du=02 05 00 FF 0C DA, "
            "haveFCS=True, ed=0x16)",
            [ANSWER],
        ),
        (
            "FdlTelegram(sd=SD2, haveLE=True, da=0x63, sa=0x02, fc=0x08, dae=[0x3E], sae=[0x3C], "
            "du=[0x02, 0x05, 0x00, 0xFF, 0x0C, 0xDA], haveFCS=True, ed=0x16)",
            [ANSWER],
        ),
        (
            "FdlTelegram(sd=SC, haveLE=False, da=None, sa=None, fc=None, dae=Empty, sae=Empty, du=None, "
            "haveFCS=False, ed=None)",
            [SC],
        ),
        # ESP-IDF in colours, its dump with addresses
        ("\x1b[0;32mI (394) RX: 10 02 63 49 ae 16\x1b[0m", [STATUS]),
        (
            "I (402) RX: 0x3ffb5b3c   68 0b 0b 68 e3 82 08 3e  3c 02 05 00 ff 0c da d3  |h..h...>........|\n"
            "I (402) RX: 0x3ffb5b4c   16                                                |.|",
            [ANSWER],
        ),
        ("0x000: 68 05 05 68  82 e3 6d 3c  3e 4c 16              h..h..m<>L.", [ASK]),
        # xxd, hexdump -C, hexdump (words of this computer, one octet filled up), od -t x1 (octal)
        (
            "00000000: 6805 0568 82e3 6d3c 3e4c 1668 0b0b 68e3  h..h..m<>L.h..h.\n"
            "00000010: 8208 3e3c 0205 00ff 0cda d316            ..><........\n",
            [ASK, ANSWER],
        ),
        ("00000000  68 05 05 68 82 e3 6d 3c  3e 4c 16                 |h..h..m<>L.|\n0000000b", [ASK]),
        ("0000000 0568 6805 e382 3c6d 4c3e 0016\n000000b", [ASK]),
        (
            "0000000 68 05 05 68 82 e3 6d 3c 3e 4c 16 68 0b 0b 68 e3\n0000020 82 08 3e 3c 02 05 00 ff 0c da d3 16\n"
            "0000034",
            [ASK, ANSWER],
        ),
        ("0000 68 05 05 68 82 e3 6d 3c\n0008 3e 4c 16\n0000 e5", [ASK, SC]),
        # libnodave
        ("0:0x68,0x05,0x05,0x68,0x82,0xE3,0x6D,0x3C,\n8:0x3E,0x4C,0x16,", [ASK]),
        # columns of times and numbers: the serial monitor of Arduino, tables
        ("20:15:31.234 -> 68 05 05 68 82 E3 6D 3C 3E 4C 16 \n20:15:31.250 -> E5", [ASK, SC]),
        ("2021-10-04 14:23:45,678 E5\n[14:23:45.678] 10 02 63 49 AE 16", [SC, STATUS]),
        ("12;0.001234;Tx;2;3;68 05 05 68 82 E3 6D 3C 3E 4C 16\n| 13 | 0.0015 | Rx | 3 | 2 | E5 |", [ASK, SC]),
        ("5 12:01:22.123456 02 -> 03 SD2 68 05 05 68 82 E3 6D 3C 3E 4C 16 Slave_Diag", [ASK]),
        ("COM4: 20:14:11.120 Tx [6] 10 02 63 49 AE 16\nCOM4: 20:14:11.131 Rx [1] E5", [STATUS, SC]),
        ("Send: 10 02 63 49 AE 16 (6 bytes)\nTX(6): 10 02 63 49 AE 16 | ..cI..", [STATUS] * 2),
        ("7 0.00017963 a.exe IRP_MJ_WRITE VCP0 SUCCESS Length 6: 10 02 63 49 AE 16", [STATUS]),
        ("→ TX  10 02 63 49 AE 16\n← RX  E5                  (ShortAck)", [STATUS, SC]),
        ("TX: 10 02 63 49 AE 16 RX: E5", [STATUS, SC]),
        # code of C, Python, Pascal, assemblers; strace
        ("uint8_t q[] = {0x10, 0x02, 0x63, 0x49, 0xAE, 0x16};", [STATUS]),
        ("ser.write(bytes([0x10, 0x02, 0x63, 0x49, 0xAE, 0x16]))", [STATUS]),
        # without leading zeros: hex() of Python, Serial.print(octet, HEX) of Arduino
        ("['0x10', '0x2', '0x63', '0x49', '0xae', '0x16']\n0x10 0x2 0x63 0x49 0xae 0x16", [STATUS] * 2),
        ("10 2 63 49 AE 16\n20:15:31.234 -> 10 2 63 49 AE 16 ", [STATUS] * 2),
        ("10h 02h 63h 49h AEh 16h\n$10 $02 $63 $49 $AE $16\n\\x10\\x02\\x63\\x49\\xAE\\x16", [STATUS] * 3),
        ("b'h\\x05\\x05h\\x82\\xe3m<>L\\x16'\nrx bytearray(b'\\xe5')", [ASK, SC]),
        ("b'\\8\\x10'", [b"8\x10"]),
        ('write(3, "h\\5\\5h\\202\\343m<>L\\26", 11) = 11', [ASK]),
        ("sent [104, 5, 5, 104, 130, 227, 109, 60, 62, 76, 22]", [ASK]),
        ("B#16#10 B#16#02 W#16#6349 16#AE 16#16", [STATUS]),
        # a telegram in several lines: wrapped by a mail, an octet a line
        ("PHY-serial: TX   68 05 05 68 82 E3\n6D 3C 3E 4C 16\nPHY-serial: RX   E5", [ASK, SC]),
        ("\n".join(re.findall("..", ANSWER.hex())), [ANSWER]),
        ("rx 68 05 05 68\nrx 82 E3 6D 3C 3E 4C 16", [ASK]),
        # which are not one: another direction, octets that do not fit
        ("rx 68 05 05 68\ntx 10 02 63 49 AE 16", [b"\x68\x05\x05\x68", STATUS]),
        ("68 05 05 68 82 E3\n10 02 63 49 AE 16", [b"\x68\x05\x05\x68\x82\xe3", STATUS]),
        # hex digits alone, and comments
        ("68-05-05-68-82-E3-6D-3C-3E-4C-16 # a comment\n# 10 02 63 49 AE 16\n\nE5#", [ASK, SC]),
    ],
)
def test_forms_of_lines(text: str, octets: list[bytes]) -> None:
    found, unread, _ = read(text)
    assert found == octets
    assert unread == []


def test_bits_and_texts_of_a_uart_decoder_between_its_octets_are_left_out() -> None:
    bits = "uart-1: Start bit\nuart-1: 0\nuart-1: {:02X}\nuart-1: Stop bit\n"
    found, unread, _ = read("".join(map(bits.format, STATUS)))
    assert found == [STATUS]
    assert {line.reason for line in unread} == {""}


def test_what_stands_before_the_octets_is_kept() -> None:
    text = "14:03:21.123 COM3 TX: 10 02 63 49 AE 16\n> [14:03:21.130] RX E5\nAA\n"
    assert read(text)[2] == ["14:03:21.123 COM3 TX", "[14:03:21.130] RX", ""]


def test_words_are_reported_and_no_octets() -> None:
    words = (
        "DPM1: Trying to initialize slave 42...\nDPM1: slave[2A].state --> 'wait for diag'\ntimeout in 10 ms\n"
        "PHY-serial: Warning: The configured baud rate 45450 baud\nReceived 16 bytes\nbaud 500000\n"
        "von da ab 05 be\n------\nDP-1: slave 3, 2 retries\n"
    )
    found, unread, _ = read(words + "TX E5")
    assert found == [SC]
    assert [(line.number, line.reason) for line in unread] == [(number, "") for number in range(1, 10)]
    assert unread[0].text == "DPM1: Trying to initialize slave 42..."


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("68 O5 05 68 82 E3 6D 3C 3E 4C 16", "'O5' is no octet"),
        ("PHY-serial: TX   68 05 zz 68", "'zz' is no octet"),
        ("TX 100263 491", "an octet has two hex digits, one is missing"),
        ("slave 8 said 02 05 00 FF 0C DA today", "'today' is no octet"),
        ("TX 1002634 123", "no telegram"),
        ("FdlTelegram(sd=SD9, da=0x02)", "a telegram of pyprofibus without its fields"),
        ("00000000  68 05 05 68 82 e3 6d 3c\n*", "an asterisk stands for lines that were left out"),
    ],
)
def test_octets_that_cannot_be_read_have_a_reason(text: str, reason: str) -> None:
    unread = read(f"E5\n{text}")[1]
    assert [line.reason[: len(reason)] for line in unread] == [reason]


def test_without_somebody_to_report_to_such_a_line_is_an_error() -> None:
    with pytest.raises(CaptureFileError, match="log: line 2: no octets"):
        list(read_transmissions(io.BytesIO(b"E5\nhello"), "log"))


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-be"])
def test_encodings_of_editors_and_shells(encoding: str) -> None:
    text = ("\ufeff" if encoding == "utf-16-be" else "") + "→ TX 10 02 63 49 AE 16\r\nE5\r\n"
    assert read(text.encode(encoding))[0] == [STATUS, SC]


@pytest.mark.parametrize("sign", ["<", "tx ", "b'", "zz 68 ", "-", "0x"])
def test_long_lines_of_signs_take_no_time(sign: str) -> None:
    """Patterns that look back at each sign would take minutes."""
    found, unread, _ = read(f"E5\n{sign * (5_000 // len(sign))}")
    assert found[0] == SC
    assert len(found) > 1 or len(unread) == 1


def test_a_text_without_octets_and_octets_without_text() -> None:
    with pytest.raises(CaptureFileError, match="no octets in its lines"):
        read("hello\nworld\n")
    with pytest.raises(CaptureFileError, match="xxd FILE"):
        read(ASK)
    with pytest.raises(CaptureFileError, match="xxd FILE"):
        read(SC * 4)


@given(st.lists(st.text(alphabet="0123456789abcdefABCDEFxX#*:;,|()[]'\"\\ >-.TRhDtz\n", max_size=80), max_size=8))
def test_any_lines_end_in_octets_or_a_report(lines: list[str]) -> None:
    """Nothing raises, and every line that is no comment gives octets, a report, or is the end of a dump."""
    unread: list[Unread] = []
    reader = LogReader(unread.append)
    found: list[Transmission] = []
    for line in lines:
        found += reader.add(line)
    found += reader.end()
    assert all(one.octets for one in found)
    assert all(line.text for line in unread)


@pytest.mark.parametrize(
    ("text", "octets"),
    [
        ("Time,Dir,Data\n0.001,TX,10 02 63 49 AE 16\n0.002,RX,E5\n", [STATUS, SC]),
        ("Time [s],Data\n0.001,10 02 63 49 AE 16\n", [STATUS]),
    ],
)
def test_a_heading_that_a_logic_analyser_could_have_written(text: str, octets: list[bytes]) -> None:
    found, unread, _ = read(text)
    assert found == octets
    assert [one.number for one in unread] == [1]
