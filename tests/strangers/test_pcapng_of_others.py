"""pcapng files judged by programs of others: ours are read by capinfos, tshark, scapy and python-pcapng, theirs by us.

Times are compared as whole nanoseconds: tshark prints them so, of the Python packages the raw 64-bit values are taken.
"""

from __future__ import annotations

import importlib
import io
import struct
import subprocess
from collections.abc import Callable
from itertools import accumulate
from pathlib import Path
from typing import Any, Final, NamedTuple

import pytest
from programs import Starter, wait_for_socket

from bench.listen import traffic
from dpstack.capture.pcapng import USER0, Reader, Writer
from dpstack.capture.recording import PortAbout, Recording
from dpstack.capture.timing import ADAPTER
from dpstack.capture.transmission import Damage, Transmission
from tests.strangers.stranger_kit import program, run_program

pytestmark = [pytest.mark.strangers, pytest.mark.filterwarnings("ignore:Field type should not be")]

T: Final = 1_790_000_000_123_456_789
TOKEN: Final = bytes.fromhex("DC 02 02")
_FIELDS: Final = ("time_epoch", "interface_name", "packet_flags", "comment", "cap_len", "encap_type")
_USER0_IN_WIRESHARK: Final = "45"


class Seen(NamedTuple):
    """A packet as one program reads it; ``t_ns`` None: it has no time."""

    t_ns: int | None
    octets: bytes
    interface: str
    flags: int
    comments: tuple[str, ...]


@pytest.fixture(autouse=True)
def _own_configuration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Wireshark without the plugins and settings of whoever runs the tests."""
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setenv("WIRESHARK_CONFIG_DIR", str(tmp_path / "wireshark"))


# --- how each program reads a file ------------------------------------------------------------------------------------


def by_us(path: Path) -> list[Seen]:
    with path.open("rb") as file:
        reader = Reader(file, path.name)
        found = [Seen(p.t_ns, p.octets, p.interface.name, p.flags, p.comments) for p in reader]
    assert reader.cut == ""
    return found


def by_tshark(path: Path, linktype: int = USER0) -> list[Seen]:
    """Its fields and, from its hex dump of each packet, the octets."""
    fields = [word for name in _FIELDS for word in ("-e", f"frame.{name}")]
    how = ["-T", "fields", "-E", "separator=/t", "-E", "occurrence=a", "-E", "aggregator=|", *fields, "-e", "data.data"]
    rows = [line.split("\t") for line in run_program("tshark", ["-r", path, *how]).stdout.splitlines()]
    found = []
    for time, interface, flags, comment, length, encapsulation, octets in rows:
        assert (encapsulation == _USER0_IN_WIRESHARK) is (linktype == USER0)
        assert len(octets) == 2 * int(length)
        seconds, _, fraction = time.partition(".")
        t_ns = int(seconds) * 1_000_000_000 + int(fraction.ljust(9, "0")) if time else None
        comments = tuple(comment.split("|")) if comment else ()
        found.append(Seen(t_ns, bytes.fromhex(octets), interface, int(flags or "0", 16), comments))
    return found


def by_scapy(path: Path) -> list[Seen]:
    """It drops the flags: they are not compared."""
    reader: Any = importlib.import_module("scapy.utils").RawPcapNgReader(str(path))
    found = []
    for octets, about in reader:
        assert about.linktype == USER0
        assert about.tsresol == 1_000_000_000
        comments = tuple(comment.decode() for comment in about.comments or ())
        found.append(Seen(about.tshigh << 32 | about.tslow, octets, about.ifname.decode(), 0, comments))
    reader.close()
    return found


def by_python_pcapng(path: Path) -> list[Seen]:
    package: Any = importlib.import_module("pcapng")
    blocks: Any = importlib.import_module("pcapng.blocks")
    found = []
    with path.open("rb") as file:
        for block in package.FileScanner(file):
            if isinstance(block, blocks.EnhancedPacket):
                interface = block.interface
                assert interface.options["if_tsresol"] == b"\x09"
                flags = block.options.get("epb_flags", 0)
                comments = (block.options["opt_comment"],) if "opt_comment" in block.options else ()
                t_ns = block.timestamp_high << 32 | block.timestamp_low
                found.append(Seen(t_ns, block.packet_data, interface.options["if_name"], int(flags), comments))
    return found


def capinfos(path: Path) -> dict[str, str]:
    lines = run_program("capinfos", ["-M", path]).stdout.splitlines()
    return {name.strip(): value.strip() for name, mark, value in (line.partition(":") for line in lines) if mark}


def all_agree(path: Path, expected: list[Seen]) -> None:
    """All programs and we read ``expected``."""
    assert by_us(path) == expected
    assert by_tshark(path) == expected
    assert by_scapy(path) == [seen._replace(flags=0) for seen in expected]
    assert by_python_pcapng(path) == expected
    about = capinfos(path)
    assert about["File type"] == "pcapng"
    assert about["Number of packets"] == str(len(expected))
    assert about["Data size"] == f"{sum(len(seen.octets) for seen in expected)} bytes"


# --- files of ours ----------------------------------------------------------------------------------------------------


class Blocks(io.BytesIO):
    """A file that notes where its blocks end."""

    def __init__(self) -> None:
        super().__init__()
        self.sizes: list[int] = []

    def write(self, octets: Any, /) -> int:
        self.sizes.append(len(octets))
        return super().write(octets)


def rich_file() -> tuple[Blocks, list[Seen]]:
    """Three interfaces, one that comes late, all flags, comments, statistics, each size of a telegram's last word."""
    file = Blocks()
    writer = Writer(file, "dpstack of a test")
    expected: list[Seen] = []
    names = ["/dev/ttyUSB0", "second \N{GREEK SMALL LETTER MU}"]
    numbers = [writer.interface(name, 500_000 * (n + 1), f"even parity, {name}") for n, name in enumerate(names)]

    def packet(port: int, t_ns: int, octets: bytes, flags: int = 0, comment: str = "") -> None:
        writer.packet(port, t_ns, octets, flags, comment)
        expected.append(Seen(t_ns, octets, names[port], flags, (comment,) if comment else ()))

    for size in (1, 2, 3, 4, 255):
        packet(numbers[size & 1], T + size, bytes(range(size)))
    for damage in Damage:
        packet(numbers[0], T + 1_000 + int(damage), TOKEN, int(damage), f"damage {damage.name}")
    packet(numbers[1], T + 9_000_000_000, b"\x00", sum(Damage), "all of it, \N{LATIN SMALL LETTER U WITH DIAERESIS}")
    writer.statistics(numbers[0], T, T + 9_000_000_000, 9, 2, "the disk was too slow")
    names.append("late")
    numbers.append(writer.interface("late", 12_000_000, ""))
    packet(numbers[2], T + 9_000_000_001, TOKEN, 0, "x" * 2_000)
    writer.statistics(numbers[2], T, T + 9_000_000_002, 1, 0)
    return file, expected


def test_interfaces_flags_comments_and_statistics(tmp_path: Path) -> None:
    file, expected = rich_file()
    path = tmp_path / "rich.pcapng"
    path.write_bytes(file.getvalue())
    all_agree(path, expected)
    about = run_program("capinfos", ["-M", path]).stdout
    for text in ("Speed = 12000000", "Name = /dev/ttyUSB0", "Description = even parity, /dev/ttyUSB0"):
        assert text in about
    assert "Capture application: dpstack of a test" in about
    assert about.count("Number of stat entries = 1") == 2


def test_statistics_have_their_times_and_counts(tmp_path: Path) -> None:
    file, _ = rich_file()
    blocks: Any = importlib.import_module("pcapng.blocks")
    scanner: Any = importlib.import_module("pcapng").FileScanner
    found = [block for block in scanner(io.BytesIO(file.getvalue())) if isinstance(block, blocks.InterfaceStatistics)]
    first, last = (dict(block.options) for block in found)
    assert (first["isb_ifrecv"], first["isb_ifdrop"], first["opt_comment"]) == (9, 2, "the disk was too slow")
    assert (last["isb_ifrecv"], last["isb_ifdrop"]) == (1, 0)
    # it reads the two halves of these times as one number: the upper half comes first, as in a packet
    assert first["isb_starttime"] == (T & 0xFFFFFFFF) << 32 | T >> 32


def test_a_file_cut_after_each_block(tmp_path: Path) -> None:
    file, expected = rich_file()
    octets = file.getvalue()
    kinds = [struct.unpack_from("<I", octets, end - size)[0] for size, end in zip(file.sizes, _ends(file), strict=True)]
    for number, end in enumerate(_ends(file), 1):
        path = tmp_path / f"{number}.pcapng"
        path.write_bytes(octets[:end])
        packets = expected[: kinds[:number].count(6)]
        assert by_us(path) == packets
        assert by_python_pcapng(path) == packets
        if number < 3 or number % 4 == 0:
            all_agree(path, packets)


def _ends(file: Blocks) -> list[int]:
    return list(accumulate(file.sizes))


def test_a_file_cut_within_a_block_has_the_same_packets_for_tshark_and_for_us(tmp_path: Path) -> None:
    file, expected = rich_file()
    end = _ends(file)[7]
    path = tmp_path / "cut.pcapng"
    path.write_bytes(file.getvalue()[: end - 3])
    with path.open("rb") as opened:
        reader = Reader(opened, "cut")
        count = sum(1 for _ in reader)
    assert (count, reader.cut) == (4, f"{file.sizes[7] - 3} octets of a last block are not read")
    done = subprocess.run(
        [program("tshark"), "-r", str(path), "-T", "fields", "-e", "frame.time_epoch"], capture_output=True, text=True
    )
    assert done.returncode
    assert "cut short in the middle of a packet" in done.stderr
    assert len(done.stdout.splitlines()) == count == len(expected[:4])


@pytest.mark.parametrize("packets", [False, True])
def test_files_with_hardly_anything(tmp_path: Path, packets: bool) -> None:
    path = tmp_path / "a.pcapng"
    with path.open("wb") as file:
        writer = Writer(file, "dpstack")
        if packets:
            writer.interface("p", 0, "")
    all_agree(path, [])


@pytest.mark.parametrize("t_ns", [0, 1, (1 << 32) - 1, 1 << 32, (1 << 63) - 1])
def test_times_at_the_bounds_of_their_halves(tmp_path: Path, t_ns: int) -> None:
    path = tmp_path / "a.pcapng"
    with path.open("wb") as file:
        writer = Writer(file, "dpstack")
        writer.packet(writer.interface("p", 9_600, ""), t_ns, TOKEN)
    all_agree(path, [Seen(t_ns, TOKEN, "p", 0, ())])


def test_text_that_no_terminal_should_get_is_kept_as_it_is(tmp_path: Path) -> None:
    comment = "\x1b[31m a\tb\r\n\N{RIGHT-TO-LEFT OVERRIDE} " + "\N{EURO SIGN}" * 30_000
    path = tmp_path / "a.pcapng"
    with path.open("wb") as file:
        writer = Writer(file, "dpstack")
        writer.packet(writer.interface("/dev/\udcff", 9_600, ""), T, TOKEN, 0, comment)
    (seen,) = by_us(path)
    assert seen.comments == (comment[: 13 + 21_840],) == by_python_pcapng(path)[0].comments
    assert by_scapy(path) == [seen]
    assert seen.interface == "/dev/?"


@pytest.mark.parametrize("linktype", [147, 257])
def test_a_recorded_bus_at_two_rates(tmp_path: Path, linktype: int) -> None:
    """A whole bring-up with diagnosis and DP-V1, damaged octets, and a gap."""
    heard = traffic(1_500, 1_500_000)
    path = tmp_path / "bus.pcapng"
    with path.open("wb") as file:
        recording = Recording(file, "dpstack", PortAbout("bus", ADAPTER, paced=True), linktype=linktype)
        for one in heard[:800]:
            recording.add(one)
        recording.add(Transmission(b"\x68\x05", heard[799].t_ns, 1_500_000, "", Damage.TOO_SHORT))
        recording.add(heard[800], gap="3 chunks of octets were lost")
        for one in heard[801:]:
            recording.add(one._replace(baud=12_000_000))
        recording.close((heard[-1].t_ns or 0) + 1)
    expected = by_us(path)
    assert [seen.octets for seen in expected if not seen.flags] == [one.octets for one in heard]
    assert [seen.t_ns for seen in expected if not seen.flags] == [one.t_ns for one in heard]
    if linktype == USER0:
        all_agree(path, expected)
    else:
        assert by_tshark(path, linktype) == expected
    assert capinfos(path)["Number of interfaces in file"] == "2"


def test_a_capture_by_the_command_of_a_live_bus(tmp_path: Path, start: Starter) -> None:
    bus = tmp_path / "bus"
    start.segment(bus, 4)
    station = ("--gsd", "io-station", "--modules", "8 DI", "8 DO", "--address", "8")
    start("sim", *station, "--port", str(bus / "0"), "--baud", "500000")
    wait_for_socket(bus / "0")
    path = tmp_path / "live.pcapng"
    capture = start("capture", "--port", str(bus / "1"), "--baud", "500000", "--write", str(path), "--json")
    ring = ("--ring", "2", "--size", "1", "--write", str(tmp_path / "ring.pcapng"))
    captures = [capture, start("capture", "--port", str(bus / "3"), "--baud", "500000", *ring, "--json")]
    for each in captures:
        each.wait_for('"event":"start"')
    scan = start("scan", "--port", str(bus / "2"), "--baud", "500000", "--json")
    assert scan.end() in (0, 1)
    assert [each.end(2) for each in captures] == [0, 0]
    expected = by_us(path)
    assert sum(seen.octets[0] == 0x10 for seen in expected) > 10
    all_agree(path, expected)
    (file,) = tmp_path.glob("ring_*.pcapng")
    all_agree(file, by_us(file))
    assert [seen.octets for seen in by_us(file)] == [seen.octets for seen in expected]


# --- files of theirs --------------------------------------------------------------------------------------------------

Build = Callable[[Any], None]


def their_blocks(order: str, resolution: bytes | None, offset: int | None) -> bytes:
    """By python-pcapng: two interfaces, packets with options, a block of names, statistics, a Simple Packet."""
    package: Any = importlib.import_module("pcapng")
    blocks: Any = importlib.import_module("pcapng.blocks")
    section = blocks.SectionHeader(endianness=order, options={"shb_os": "an os", "opt_comment": "a section"})
    options: dict[str, Any] = {"if_name": "theirs", "if_speed": 187_500, "if_os": "an os", "if_fcslen": 1}
    if resolution is not None:
        options["if_tsresol"] = resolution
    if offset is not None:
        options["if_tsoffset"] = offset
    interface = section.new_member(blocks.InterfaceDescription, link_type=USER0, snaplen=0, options=options)
    other = section.new_member(blocks.InterfaceDescription, link_type=USER0, snaplen=4, options={"if_name": "other"})
    out = io.BytesIO()
    writer = package.FileWriter(out, section)
    ticks = {None: 1_000_000, b"\x06": 1_000_000, b"\x09": 10**9, b"\x8a": 1 << 10, b"\x94": 1 << 20}[resolution]
    for number, octets in enumerate((TOKEN, b"\xe5", bytes(range(200)))):
        time = 1_790_000_000 * ticks + ticks // 3 + number
        packet = section.new_member(blocks.EnhancedPacket, interface_id=0, packet_data=octets)
        packet.timestamp_high, packet.timestamp_low = time >> 32, time & 0xFFFFFFFF
        packet.packet_len = len(octets) + number  # the last ones were cut while they were captured
        if number:
            packet.options["epb_flags"] = int(Damage.FCS) | 1
            packet.options["epb_dropcount"] = number
            packet.options["opt_comment"] = f"comment {number}"
        writer.write_block(packet)
    writer.write_block(section.new_member(blocks.NameResolution, records=[]))
    writer.write_block(section.new_member(blocks.InterfaceStatistics, interface_id=interface.interface_id))
    second = section.new_member(blocks.EnhancedPacket, interface_id=other.interface_id, packet_data=b"\x10\x02")
    second.timestamp_high, second.timestamp_low = 416_766, 5
    writer.write_block(second)
    return out.getvalue()


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("resolution", [None, b"\x06", b"\x09", b"\x8a", b"\x94"])
@pytest.mark.parametrize("offset", [None, 3_600])
def test_files_of_python_pcapng(tmp_path: Path, order: str, resolution: bytes | None, offset: int | None) -> None:
    path = tmp_path / "theirs.pcapng"
    path.write_bytes(their_blocks(order, resolution, offset))
    found = by_us(path)
    assert len(found) == 4
    assert found == by_tshark(path)


def test_sections_of_both_orders_and_blocks_that_nobody_knows(tmp_path: Path) -> None:
    unknown = [struct.pack(f"{order}II", 0x0BAD_0000, 16) + b"abcd" + struct.pack(f"{order}I", 16) for order in "<>"]
    parts = [their_blocks("<", b"\x09", None), unknown[0], their_blocks(">", None, None), unknown[1]]
    path = tmp_path / "theirs.pcapng"
    path.write_bytes(b"".join(parts))
    assert len(by_us(path)) == 8
    assert by_us(path) == by_tshark(path)


def test_simple_packets_have_no_time(tmp_path: Path) -> None:
    package: Any = importlib.import_module("pcapng")
    blocks: Any = importlib.import_module("pcapng.blocks")
    section = blocks.SectionHeader(endianness=">")
    section.new_member(blocks.InterfaceDescription, link_type=USER0, snaplen=2, options={"if_name": "p"})
    path = tmp_path / "theirs.pcapng"
    with path.open("wb") as out:
        writer = package.FileWriter(out, section)
        for octets in (b"\xe5", TOKEN):
            packet = section.new_member(blocks.SimplePacket, packet_data=octets[:2])
            packet.packet_len = len(octets)
            writer.write_block(packet)
    found = by_us(path)
    assert [(seen.t_ns, seen.octets) for seen in found] == [(None, b"\xe5"), (None, TOKEN[:2])]
    assert [seen.octets for seen in by_tshark(path)] == [seen.octets for seen in found]


def test_files_of_scapy(tmp_path: Path) -> None:
    utils: Any = importlib.import_module("scapy.utils")
    path = tmp_path / "theirs.pcapng"
    packets = [importlib.import_module("scapy.packet").Raw(octets) for octets in (TOKEN, b"\xe5")]
    packets[0].time, packets[1].time = 1_790_000_000.25, 1_790_000_001.5
    packets[1].comments, packets[1].sniffed_on, packets[1].direction = [b"one", b"two"], "named", 1
    with utils.PcapNgWriter(str(path)) as writer:
        writer.linktype = USER0
        writer.write(packets)
    found = by_us(path)
    assert [seen.t_ns for seen in found] == [1_790_000_000_250_000_000, 1_790_000_001_500_000_000]
    assert found[1] == Seen(1_790_000_001_500_000_000, b"\xe5", "named", 1, ("one", "two"))
    # tshark gives an interface without a name its number
    assert [seen._replace(interface="") for seen in found] == [s._replace(interface="") for s in by_tshark(path)]


@pytest.mark.parametrize(
    ("name", "how"),
    [
        ("editcap", ["-F", "pcapng", "-a", "2:a remark", "ours", "theirs"]),
        ("editcap", ["-t", "1.5", "ours", "theirs"]),
        ("editcap", ["-s", "5", "ours", "theirs"]),
        ("mergecap", ["-w", "theirs", "ours", "ours"]),
        ("mergecap", ["-a", "-w", "theirs", "ours", "ours"]),
        ("tshark", ["-r", "ours", "-w", "theirs"]),
    ],
)
def test_files_of_ours_that_wireshark_has_written_again(tmp_path: Path, name: str, how: list[str]) -> None:
    ours, theirs = tmp_path / "ours.pcapng", tmp_path / "theirs.pcapng"
    file, expected = rich_file()
    ours.write_bytes(file.getvalue())
    run_program(name, [{"ours": ours, "theirs": theirs}.get(word, word) for word in how])
    found = by_us(theirs)
    assert found == by_tshark(theirs)
    if name == "tshark":
        assert found == expected
    else:
        assert len(found) == len(expected) * how.count("ours")


def test_a_pcap_file_is_converted_as_the_message_says(tmp_path: Path) -> None:
    ours, pcap, again = tmp_path / "a.pcapng", tmp_path / "a.pcap", tmp_path / "b.pcapng"
    with ours.open("wb") as file:
        writer = Writer(file, "dpstack")
        writer.packet(writer.interface("p", 9_600, ""), T, TOKEN)
    run_program("editcap", ["-F", "nsecpcap", ours, pcap])
    with pytest.raises(Exception, match="this is a pcap file, not pcapng; convert it: editcap -F pcapng OLD NEW"):
        by_us(pcap)
    run_program("editcap", ["-F", "pcapng", pcap, again])
    assert [(seen.t_ns, seen.octets) for seen in by_us(again)] == [(T, TOKEN)]
