#!/bin/sh
# hartip-py 0.5.0, a HART-IP package, beside a server of this script that gives valid answers of three transmitters.
# Guess: a value that comes with a warning is a value; range and damping of a HART 5 device can be read; the maker is the
# one whose code the device sends.
# A response code other than 0 is an error for it, the warnings too (8, "update failure" in command 1, which its own table calls
# a warning): Device gives None instead of the value, and an error is raised by raise_for_error(). Command 15 has 17 octets up to
# HART 5; with less than 18 the result is an empty dict, so that the range seems to be unknown, without a word. In HART 7 the octet
# behind 254 belongs to the device type, and the maker stands in the octets 17 and 18: it reads these, and takes the name from the
# other one, "Unknown (0xE3)" for a maker that stands in its own list.
# dpstack shows values with their warning, reads 17 octets and more, and takes the maker by the HART revision.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install hartip-py==0.5.0 >/dev/null 2>&1
cat >"$dir/try.py" <<'PY'
import socket
import struct
import threading
from functools import reduce

from hartip import Device
from hartip.vendors import get_vendor_name

HART7 = bytes.fromhex("fee3a1050701010800123456050400070061bd61bd01")  # device type E3A1, maker 61BD
HART5 = bytes.fromhex("fe2606050501010800123456")
VALUE = bytes([7]) + struct.pack(">f", 2.5)  # bar
RANGE = bytes([0, 0, 7]) + struct.pack(">fff", 10, 0, 1.5) + bytes([0, 250])


def serve(server, answers):
    """Command: response code and data. Session messages are sent back as answers."""
    while True:
        request, client = server.recvfrom(300)
        version, _, message, _, number, _ = struct.unpack_from(">BBBBHH", request)
        body = request[8:]
        if message == 3:
            end = 6 if body[0] & 0x80 else 2
            code, data = answers.get(body[end], (64, b""))
            body = bytes([body[0] | 4]) + body[1 : end + 1] + bytes([len(data) + 2, code, 0]) + data
            body += bytes([reduce(int.__xor__, body)])
        server.sendto(struct.pack(">BBBBHH", version, 1, message, 0, number, 8 + len(body)) + body, client)


def device(answers):
    server = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    server.bind(("127.0.0.1", 0))
    threading.Thread(target=serve, args=(server, answers), daemon=True).start()
    return Device("127.0.0.1", server.getsockname()[1], protocol="udp", auto_read_tags=False)


values = {}
for code in (0, 8):
    with device({0: (0, HART5), 1: (code, VALUE)}) as one:
        values[code] = one.primary_variable and one.primary_variable.value
print(f"value 2.5 with response code 0: {values[0]}, with 8 (warning: update failure): {values[8]}")
assert values == {0: 2.5, 8: None}, "the behaviour has changed"

ranges = {}
for octets in (RANGE, RANGE + b"\0"):
    with device({0: (0, HART5), 15: (0, octets)}) as one:
        ranges[len(octets)] = one.client.read_output_info().parsed.get("upper_range_value")
print(f"upper range value 10.0 by the octets of command 15: {ranges}")
assert ranges == {17: None, 18: 10.0}, "the behaviour has changed"

with device({0: (0, HART7)}) as one:
    code, name = one.info.manufacturer_id_16bit, one.manufacturer_name
is_listed = not get_vendor_name(code).startswith("Unknown")
print(f"maker {code:04X}, in its list: {is_listed}, shown: {name}")
assert (code, is_listed, name) == (0x61BD, True, "Unknown (0xE3)"), "the behaviour has changed"
PY
"$dir/env/bin/python" "$dir/try.py"
# output seen:
# value 2.5 with response code 0: 2.5, with 8 (warning: update failure): None
# upper range value 10.0 by the octets of command 15: {17: None, 18: 10.0}
# maker 61BD, in its list: True, shown: Unknown (0xE3)
