#!/bin/sh
# A read of six octets that is given up after a time (asyncio.wait_for), when four have come; then the other octets arrive, and the
# next read. Packages for serial ports in asyncio on a pty: aioserial 1.3.1, auserial 1.0.1, serialx 1.15.1, pyserial-asyncio 0.6.
# Guess: a read that is cancelled takes nothing away: the next one begins with the first octet that nobody has got.
# So it is with the streams of serialx and pyserial-asyncio. aioserial reads in a thread, whose four octets are dropped with the
# cancelled task: the next read begins in the middle. auserial's cancelled read stays registered: what comes before the next
# read is read for nobody (it gives back what is there, so here nothing comes before the first read ends).
# pyserial 3.5 itself: cancel_read() while nobody reads ends the next read, at once and empty, though octets are there.
# A program that waits with a limit of time has to read without one, into a buffer of its own; dpstack does.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install \
    aioserial==1.3.1 auserial==1.0.1 serialx==1.15.1 pyserial-asyncio==0.6 pyserial==3.5 >/dev/null 2>&1
cat >"$dir/try.py" <<'PY'
import asyncio
import contextlib
import os
import tty

import aioserial
import auserial
import serial
import serial_asyncio
import serialx


def line():
    far, near = os.openpty()
    tty.setraw(near)
    return far, os.ttyname(near)


async def resumed(far, read, begin, rest):
    os.write(far, begin)
    with contextlib.suppress(asyncio.TimeoutError):
        await asyncio.wait_for(read(6), 0.3)
    for octets in rest:
        os.write(far, octets)
        await asyncio.sleep(0.1)
    return (await asyncio.wait_for(read(6), 5)).decode()


async def main():
    found = {}
    four, none = (b"abcd", (b"ef", b"ghijkl")), (b"", (b"abc", b"defghi"))
    far, path = line()
    port = aioserial.AioSerial(port=path, baudrate=9600)
    found["aioserial"] = await resumed(far, port.read_async, *four)
    port.close()
    far, path = line()
    async with auserial.AUSerial(path) as port:
        found["auserial"] = await resumed(far, port.read, *none)
    for module in (serialx, serial_asyncio):
        far, path = line()
        reader, writer = await module.open_serial_connection(url=path, baudrate=9600)
        found[module.__name__] = await resumed(far, reader.readexactly, *four)
        writer.close()
    far, path = line()
    with serial.Serial(path, 9600, timeout=1) as port:
        port.cancel_read()
        os.write(far, b"abcdef")
        await asyncio.sleep(0.1)
        found["pyserial"] = [port.read(6).decode(), port.read(6).decode()]
    return found


found = asyncio.run(main())
for name, octets in found.items():
    print(f"{name}: {octets}")
assert found.pop("pyserial") == ["", "abcdef"], "the behaviour has changed"
expected = {"aioserial": "efghij", "auserial": "defghi", "serialx": "abcdef", "serial_asyncio": "abcdef"}
assert found == expected, "the behaviour has changed"
PY
"$dir/env/bin/python" "$dir/try.py"
# output seen:
# aioserial: efghij
# auserial: defghi
# serialx: abcdef
# serial_asyncio: abcdef
# pyserial: ['', 'abcdef']
