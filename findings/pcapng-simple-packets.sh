#!/bin/sh
# Simple Packet Blocks of pcapng (a packet without time stamp and interface number, the smallest form).
# Guess: a reader that knows pcapng returns their octets.
# scapy 2.8.0 cuts them to the interface's snap length, and takes 0, which means "no limit", for 0 octets: empty packets, with
# the time of reading as their time. dpkt 1.9.8 leaves them out without a word. python-pcapng 2.1.1 has the octets.
# dpstack writes Enhanced Packet Blocks only; in what it reads a packet without a time has none ("t": null).
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install scapy==2.8.0 python-pcapng==2.1.1 dpkt==1.9.8 >/dev/null 2>&1
cat >"$dir/try.py" <<'PY'
import io
import struct
import time

import dpkt
import pcapng
from scapy.utils import PcapNgReader


def block(kind, body):
    return struct.pack("<II", kind, len(body) + 12) + body + struct.pack("<I", len(body) + 12)


start = block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1))
simple = block(3, struct.pack("<I", 6) + b"\x10\x03\x02\x49\x4e\x16\0\0")
seen = {}
began = time.time()
for limit in (0, 65535):
    file = start + block(1, struct.pack("<HHI", 147, 0, limit)) + simple
    packets = list(PcapNgReader(io.BytesIO(file)))
    assert all(began <= float(p.time) <= time.time() for p in packets)
    seen[limit, "scapy"] = [bytes(p).hex() for p in packets]
    seen[limit, "dpkt"] = [data.hex() for _, data in dpkt.pcapng.Reader(io.BytesIO(file))]
    blocks = pcapng.FileScanner(io.BytesIO(file))
    seen[limit, "python-pcapng"] = [b.packet_data.hex() for b in blocks if hasattr(b, "packet_data")]
for (limit, reader), packets in seen.items():
    print(f"snap length {limit}, {reader}: {packets}")
whole = ["100302494e16"]
assert seen == {
    (0, "scapy"): [""],
    (0, "dpkt"): [],
    (0, "python-pcapng"): whole,
    (65535, "scapy"): whole,
    (65535, "dpkt"): [],
    (65535, "python-pcapng"): whole,
}, "the behaviour has changed"
PY
"$dir/env/bin/python" "$dir/try.py"
# output seen:
# snap length 0, scapy: ['']
# snap length 0, dpkt: []
# snap length 0, python-pcapng: ['100302494e16']
# snap length 65535, scapy: ['100302494e16']
# snap length 65535, dpkt: []
# snap length 65535, python-pcapng: ['100302494e16']
