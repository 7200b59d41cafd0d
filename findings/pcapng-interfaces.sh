#!/bin/sh
# pcapng files with more than one interface description: two captures put behind each other (`cat a.pcapng b.pcapng` is a
# valid file of two sections), or two ports in one section, with time stamps in us at one and in ns at the other.
# Guess: each packet is read with the resolution and the link type of its own interface.
# scapy 2.8.0 numbers the interfaces of the second section on from those of the first, so that its packets get the first
# section's resolution: 1970, or 54 000 years ahead. dpkt 1.9.8 keeps one resolution and one link type for the whole file, that
# of its first interface, also within one section. python-pcapng 2.1.1 is right in each case.
# dpstack gives all interfaces of a file one link type and nanoseconds, so that each reader has the right times, and reads both kinds.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install scapy==2.8.0 python-pcapng==2.1.1 dpkt==1.9.8 >/dev/null 2>&1
cat >"$dir/try.py" <<'PY'
import io
import struct

import dpkt
import pcapng
from scapy.utils import PcapNgReader

S = 1_700_000_000


def block(kind, body):
    return struct.pack("<II", kind, len(body) + 12) + body + struct.pack("<I", len(body) + 12)


def packet(interface, time):
    return block(6, struct.pack("<IIIII", interface, *divmod(time, 1 << 32), 1, 1) + b"\xe5\0\0\0")


start = block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1))
us = block(1, struct.pack("<HHI", 147, 0, 0))  # without if_tsresol: microseconds
ns = block(1, struct.pack("<HHI", 147, 0, 0) + struct.pack("<HHB3xHH", 9, 1, 9, 0, 0))
files = {
    "two sections": start + us + packet(0, S * 10**6) + start + ns + packet(0, S * 10**9),
    "two interfaces": start + us + ns + packet(0, S * 10**6) + packet(1, S * 10**9),
}
seen = {}
for name, file in files.items():
    seen[name, "scapy"] = [float(p.time) for p in PcapNgReader(io.BytesIO(file))]
    seen[name, "dpkt"] = [time for time, _ in dpkt.pcapng.Reader(io.BytesIO(file))]
    blocks = pcapng.FileScanner(io.BytesIO(file))
    seen[name, "python-pcapng"] = [b.timestamp for b in blocks if hasattr(b, "packet_data")]
for (name, reader), times in seen.items():
    print(f"{name}, {reader}: {', '.join(f'{time:.0f}' for time in times)}")
right, wrong = [1.7e9, 1.7e9], [1.7e9, 1.7e12]
assert seen == {
    ("two sections", "scapy"): wrong,
    ("two sections", "dpkt"): wrong,
    ("two sections", "python-pcapng"): right,
    ("two interfaces", "scapy"): right,
    ("two interfaces", "dpkt"): wrong,
    ("two interfaces", "python-pcapng"): right,
}, "the behaviour has changed"
PY
"$dir/env/bin/python" "$dir/try.py"
# output seen:
# two sections, scapy: 1700000000, 1700000000000
# two sections, dpkt: 1700000000, 1700000000000
# two sections, python-pcapng: 1700000000, 1700000000
# two interfaces, scapy: 1700000000, 1700000000
# two interfaces, dpkt: 1700000000, 1700000000000
# two interfaces, python-pcapng: 1700000000, 1700000000
