#!/bin/sh
# pcapng readers for Python and the option if_tsoffset of an interface (seconds to be added to each of its time stamps).
# Guess: a reader that knows the interface's resolution knows its offset, too.
# scapy 2.8.0 and python-pcapng 2.1.1 ignore the offset: a packet of 14 November 2023 is of 1 January 1970. dpkt 1.9.8 adds it.
# dpstack writes no if_tsoffset, so that its captures show the same time in each of them, and adds the offset when it reads.
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


def block(kind, body):
    return struct.pack("<II", kind, len(body) + 12) + body + struct.pack("<I", len(body) + 12)


start = block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1))
resolution = struct.pack("<HHB3x", 9, 1, 9)  # if_tsresol: nanoseconds
offset = struct.pack("<HHq", 14, 8, 1_700_000_000)  # if_tsoffset
interface = block(1, struct.pack("<HHI", 147, 0, 0) + resolution + offset + struct.pack("<HH", 0, 0))
octets = b"\x10\x03\x02\x49\x4e\x16"
packet = block(6, struct.pack("<IIIII", 0, *divmod(5_000_000_000, 1 << 32), 6, 6) + octets + b"\0\0")
file = start + interface + packet

seen = {
    "scapy": float(next(iter(PcapNgReader(io.BytesIO(file)))).time),
    "python-pcapng": [b for b in pcapng.FileScanner(io.BytesIO(file)) if hasattr(b, "packet_data")][0].timestamp,
    "dpkt": next(iter(dpkt.pcapng.Reader(io.BytesIO(file))))[0],
}
for name, time in seen.items():
    print(f"{name}: {time:.1f} s (right: 1700000005.0)")
assert seen == {"scapy": 5.0, "python-pcapng": 5.0, "dpkt": 1_700_000_005.0}, "the behaviour has changed"
PY
"$dir/env/bin/python" "$dir/try.py"
# output seen:
# scapy: 5.0 s (right: 1700000005.0)
# python-pcapng: 5.0 s (right: 1700000005.0)
# dpkt: 1700000005.0 s (right: 1700000005.0)
