#!/bin/sh
# Two captures of one bus, put together by pycapng 0.19.7 (the bindings of libpcapng), and a packet written with a comment.
# Guess: merge(..., sort_by_timestamp=True) gives the packets of both in the order of their times, and WritePacket(octets, comment)
# writes the comment as the option opt_comment of the packet.
# The packets stay in the order of the files, as without that argument: a request of one tap and the answer of the other are far
# apart. (Interfaces keep their names, resolutions and link types under new numbers; packets keep their comments.) The comment
# that WritePacket gets is in no block of the file; the one that OpenFileLinkTypeComment gets is in the section's header.
# dpstack writes its remarks as opt_comment, and merges no files.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install pycapng==0.19.7 >/dev/null 2>&1
cat >"$dir/try.py" <<'PY'
import os
import struct
import sys

import pycapng


def block(kind, body):
    return struct.pack("<II", kind, len(body) + 12) + body + struct.pack("<I", len(body) + 12)


def capture(name, packets):  # one interface of PROFIBUS, times in ns; packets: seconds and octet
    file = block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1))
    file += block(1, struct.pack("<HHI", 257, 0, 0) + struct.pack("<HHB3xHH", 9, 1, 9, 0, 0))
    for second, octet in packets:
        time = divmod((1_700_000_000 + second) * 10**9, 1 << 32)
        file += block(6, struct.pack("<IIIII", 0, *time, 1, 1) + bytes([octet, 0, 0, 0]))
    with open(name, "wb") as out:
        out.write(file)
    return name


os.chdir(sys.argv[1])
files = [capture("a.pcapng", [(0, 0xA0), (2, 0xA2)]), capture("b.pcapng", [(1, 0xB1), (3, 0xB3)])]
orders = []
for is_sorted in (False, True):
    pycapng.merge(files, "both.pcapng", sort_by_timestamp=is_sorted)
    packets = pycapng.read_packets("both.pcapng")
    orders.append([packet.timestamp_ns // 10**9 - 1_700_000_000 for packet in packets])
    print(f"sort_by_timestamp={is_sorted}: {[packet.data.hex() for packet in packets]}, seconds {orders[-1]}")
assert orders == [[0, 2, 1, 3], [0, 2, 1, 3]], "the behaviour has changed"

writer = pycapng.PcapNG()
writer.OpenFileLinkTypeComment("one.pcapng", "w", pycapng.LINKTYPE_PROFIBUS_DL, "rack 7")
writer.WritePacket(b"\xe5", "broken wire")
writer.CloseFile()
with open("one.pcapng", "rb") as written:
    octets = written.read()
there = [text in octets for text in (b"rack 7", b"broken wire")]
print(f"comment of the file: {there[0]}, of the packet: {there[1]}")
assert there == [True, False], "the behaviour has changed"
PY
timeout 120 "$dir/env/bin/python" "$dir/try.py" "$dir"
# output seen:
# sort_by_timestamp=False: ['a0', 'a2', 'b1', 'b3'], seconds [0, 2, 1, 3]
# sort_by_timestamp=True: ['a0', 'a2', 'b1', 'b3'], seconds [0, 2, 1, 3]
# comment of the file: True, of the packet: False
