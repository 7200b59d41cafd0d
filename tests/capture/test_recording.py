"""A capture besides the octets: interfaces, damage with its cause, gaps, statistics; how finely a source
times them."""

from __future__ import annotations

import io
import struct

import pytest

from dpstack.capture.pcapng import Packet, Reader
from dpstack.capture.recording import Gaps, PortAbout, Recording
from dpstack.capture.timing import LineTiming, timing_of
from dpstack.capture.transmission import Damage, Transmission

T = 1_790_000_000_000_000_000
TOKEN = bytes.fromhex("DC 02 02")
ABOUT = PortAbout("/dev/ttyUSB0", "adapter", paced=True)


class Blocks:
    """A file that wants one whole block a call."""

    def __init__(self) -> None:
        self.blocks: list[bytes] = []

    def write(self, block: bytes) -> None:
        size = struct.unpack_from("<I", block, 4)[0]
        assert (len(block), block[-4:]) == (size, block[4:8])
        self.blocks.append(block)

    def packets(self) -> list[Packet]:
        return list(Reader(io.BytesIO(b"".join(self.blocks)), "a"))

    def statistics(self) -> list[dict[int, bytes]]:
        """The options of each statistics block, by their codes (draft-ietf-opsawg-pcapng 4.6); 0: the interface."""
        found = []
        for block in self.blocks:
            if block[:4] != b"\x05\0\0\0":
                continue
            options = {0: block[8:12]}
            at = 20
            while (code := struct.unpack_from("<H", block, at)[0]) != 0:
                size = struct.unpack_from("<H", block, at + 2)[0]
                options[code] = block[at + 4 : at + 4 + size]
                at += 4 + size + -size % 4
            found.append(options)
        return found


def test_an_interface_tells_rate_parity_and_timing() -> None:
    file = Blocks()
    recording = Recording(file, "dpstack", ABOUT, Gaps())
    recording.add(Transmission(TOKEN, T, 500_000))
    (packet,) = file.packets()
    assert (packet.interface.name, packet.interface.bits_per_s) == ("/dev/ttyUSB0", 500_000)
    assert packet.interface.description == (
        "/dev/ttyUSB0, 500 kbit/s, 8 data bits, even parity; times by adapter, resolution 1000 us"
    )


def test_each_rate_has_its_interface() -> None:
    file = Blocks()
    recording = Recording(file, "dpstack", ABOUT, Gaps())
    for n, baud in enumerate((500_000, 1_500_000, 500_000)):
        recording.add(Transmission(TOKEN, T + n, baud))
    assert [one.interface.bits_per_s for one in file.packets()] == [500_000, 1_500_000, 500_000]
    assert sum(block[:4] == b"\1\0\0\0" for block in file.blocks) == 2
    recording.close(T + 10)
    assert [int.from_bytes(one[4], "little") for one in file.statistics()] == [2, 1]


def test_damage_with_its_cause() -> None:
    file = Blocks()
    recording = Recording(file, "dpstack", ABOUT, Gaps())
    recording.add(Transmission(TOKEN[:2], T, 500_000, "octet 2 of them", Damage.TOO_SHORT | Damage.PARITY_OR_FRAMING))
    (packet,) = file.packets()
    assert packet.octets == TOKEN[:2]
    assert packet.flags == 1 << 26 | 1 << 31
    assert packet.comments == ("damaged: too short, parity or framing; octet 2 of them",)


def test_a_gap_is_in_the_next_packet_and_in_statistics() -> None:
    file = Blocks()
    gaps = Gaps()
    recording = Recording(file, "dpstack", ABOUT, gaps)
    recording.add(Transmission(TOKEN, T, 500_000))
    gaps.add("the port vanished")
    gaps.add("3 chunks were lost", 3)
    recording.add(Transmission(TOKEN, T + 5, 500_000), gap=gaps.take())
    assert [one.comments for one in file.packets()] == [(), ("gap: the port vanished; 3 chunks were lost",)]
    (statistics,) = file.statistics()
    assert int.from_bytes(statistics[5], "little") == 3
    assert statistics[1] == (
        b"gap: the port vanished; 3 chunks were lost; in this capture so far: 2 gaps, 3 lost chunks"
    )


def test_gaps_without_end_need_no_memory() -> None:
    gaps = Gaps()
    for n in range(10_000):
        gaps.add(f"gap {n}", 1)
    text = gaps.take()
    assert text.endswith("gap 7; 9992 more gaps")
    assert (gaps.count, gaps.chunks, gaps.take()) == (10_000, 10_000, "")


@pytest.mark.parametrize(
    ("timing", "text"),
    [
        (timing_of("tap", 500_000, exact=True), "times by tap, resolution 0.001 us"),
        (timing_of("adapter", 1_500_000), "times by adapter, resolution 1000 us"),
        (timing_of("adapter", 9_600), "times by adapter, resolution 4583.33 us"),
        (timing_of("host", 9_600), "times by host, resolution 1000 us"),
        (LineTiming("file", None), "times by file, resolution unknown"),
    ],
)
def test_the_words_in_a_file_give_the_timing_back(timing: LineTiming, text: str) -> None:
    assert timing.text == text
    again = LineTiming.parse(f"/dev/ttyUSB0 at 500 kbit/s; {text}; CP2102")
    assert again.source == timing.source
    assert (again.resolution_ns or 0) == pytest.approx(timing.resolution_ns or 0, rel=1e-4)


@pytest.mark.parametrize("text", ["", "a port", "times by magic, resolution 5 us", "times by tap, resolution x us"])
def test_other_descriptions_say_nothing(text: str) -> None:
    assert LineTiming.parse(text) == LineTiming("file", None)
