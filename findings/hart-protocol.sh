#!/bin/sh
# hart-protocol 2023.6.0, the HART package of the Python index: texts in packed ASCII, and the data of an answer.
# Guess: 32 characters of a message become 24 octets with all characters, and `data` of an answer is what its byte count
# leaves behind the two status octets.
# In a packed text only the LAST eight characters are there, all before them are zeros (shown as "@" by a device): a message or
# descriptor that was written is lost. `data` holds the check sum too, since the byte count includes the status octets; the
# final assembly number of command 19 has two of its three octets, 258 instead of 66051.
# Guess: on_error="raise" aborts at damaged telegrams only. It aborts at the third preamble of every telegram; five are usual,
# so no device can be read with it. With two preambles, and without "raise", the same answer is parsed.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install hart-protocol==2023.6.0 >/dev/null 2>&1
cat >"$dir/try.py" <<'PY'
import io
from functools import reduce

import hart_protocol
from hart_protocol import tools


def packed(text):  # as HART does it: six bits a character
    return sum((ord(c) & 0x3F) << 6 * at for at, c in enumerate(reversed(text))).to_bytes(len(text) * 6 // 8, "big")


class Port(io.BytesIO):
    @property
    def in_waiting(self):
        return len(self.getbuffer()) - self.tell()


def answer(command, data):  # long frame, response code 0, device status 0
    body = b"\x86" + bytes.fromhex("9106123456") + bytes([command, len(data) + 2, 0, 0]) + data
    return next(hart_protocol.Unpacker(Port(b"\xff" * 5 + body + bytes([reduce(int.__xor__, body)]))))


text = "TANK 12 LEVEL LOWER CONNECTION  "
right, seen = packed(text), tools.pack_ascii(text)
print(f"packed: {seen.hex()} (right: {right.hex()})")
assert seen == bytes(18) + right[18:] and len(right) == 24, "the behaviour has changed"

number = answer(19, bytes.fromhex("010203"))
print(f"data: {number.data.hex()} (right: 010203), final assembly number {number.final_assembly_no} (right: 66051)")
assert number.data[:3].hex() == "010203" and len(number.data) == 4, "the behaviour has changed"
assert number.final_assembly_no == 258, "the behaviour has changed"

body = bytes.fromhex("869106123456" "0107" "0000" "0640b00000")  # command 1: 5.5 psi
for preambles in (2, 5):
    octets = b"\xff" * preambles + body + bytes([reduce(int.__xor__, body)])
    try:
        seen = f"command {next(hart_protocol.Unpacker(Port(octets), on_error='raise')).command}"
    except RuntimeError as error:
        seen = str(error)
    print(f"{preambles} preambles: {seen}")
    assert seen.startswith("command 1" if preambles == 2 else "Head of buffer"), "the behaviour has changed"
PY
"$dir/env/bin/python" "$dir/try.py"
# output seen:
# packed: 0000000000000000000000000000000000001435093ce820 (right: 50138b831ca030558532030f5c54a00cf38e1435093ce820)
# data: 01020377 (right: 010203), final assembly number 258 (right: 66051)
# 2 preambles: command 1
# 5 preambles: Head of buffer not recognized as valid preamble
