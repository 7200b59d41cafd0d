#!/bin/sh
# An octet above 127 in a CHAR value of an EPICS server (caproto 1.3.0), without and with numpy (2.2.6) beside it.
# Guess: octets are octets, whichever of its two ways to hold arrays the package takes; numpy only makes it quicker.
# Without numpy a value of 80h cannot be read: the package raises OverflowError in the server. With numpy the octet goes out as
# it is. The package takes numpy if it is there, without a word.
# A server of process data has to make signed numbers of octets itself, as dpstack does.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/without"
"$dir/without/bin/pip" --quiet --disable-pip-version-check install caproto==1.3.0 >/dev/null 2>&1
python3 -m venv "$dir/with"
"$dir/with/bin/pip" --quiet --disable-pip-version-check install caproto==1.3.0 numpy==2.2.6 >/dev/null 2>&1
cat >"$dir/try.py" <<'PY'
import asyncio
import sys

from caproto import ChannelByte, ChannelType


async def read(octets: bytes) -> str:
    channel = ChannelByte(value=octets, max_length=len(octets))
    try:
        _, data = await channel.read(ChannelType.CHAR)
    except OverflowError as error:
        return type(error).__name__
    return bytes(data).hex()


found = [asyncio.run(read(bytes.fromhex(octets))) for octets in ("107f", "1080")]
print(f"{sys.argv[1]}: 10 7f gives {found[0]}, 10 80 gives {found[1]}")
assert found == ["107f", sys.argv[2]], "the behaviour has changed"
PY
"$dir/without/bin/python" "$dir/try.py" "without numpy" OverflowError
"$dir/with/bin/python" "$dir/try.py" "with numpy" 1080
# output seen:
# without numpy: 10 7f gives 107f, 10 80 gives OverflowError
# with numpy: 10 7f gives 107f, 10 80 gives 1080
