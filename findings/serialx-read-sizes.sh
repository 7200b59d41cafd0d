#!/bin/sh
# The arguments min_read_size and inter_byte_timeout of serialx 1.15.1 on a pty: an answer of six octets, three and three with 50 ms
# in between, while the program waits for up to eight.
# Guess: a read ends after eight octets or after a pause of inter_byte_timeout, whichever comes first, so it gives all six.
# Below 0.1 s (0.01 s is the default) the time is rounded to none, and Linux then holds the octets back until there are eight: the
# read ends empty at its own timeout, though all six are there. From 0.1 s on it gives the first three at once, because the port is
# not blocking, and Linux then counts neither octets nor the pause. There is no value with which both work.
# And reconfigure_port(baudrate=...) throws away octets that wait; pyserial 3.5 keeps them.
# A program has to leave min_read_size at 1 and find the end of a telegram itself, as dpstack does.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install serialx==1.15.1 pyserial==3.5 >/dev/null 2>&1
cat >"$dir/try.py" <<'PY'
import os
import threading
import time
import tty

import serial
import serialx

ANSWER = bytes.fromhex("100302494e16")


def line():
    far, near = os.openpty()
    tty.setraw(near)
    return far, os.ttyname(near)


def send(far):
    for half in (ANSWER[:3], ANSWER[3:]):
        os.write(far, half)
        time.sleep(0.05)


def reads(pause):
    far, path = line()
    with serialx.Serial(path, baudrate=9600, min_read_size=8, inter_byte_timeout=pause, read_timeout=1) as port:
        sender = threading.Thread(target=send, args=(far,))
        sender.start()
        first = port.read(64)
        sender.join()
        return first.hex(), port.num_unread_bytes()


found = {pause: reads(pause) for pause in (0.09, 0.2, 0.5)}
for pause, (first, waiting) in found.items():
    print(f"inter_byte_timeout={pause}: the first read gives {first or 'nothing'}, then {waiting} octets wait")
assert found == {0.09: ("", 6), 0.2: ("100302", 3), 0.5: ("100302", 3)}, "the behaviour has changed"

far, path = line()
with serialx.Serial(path, baudrate=9600, read_timeout=1) as port:
    send(far)
    before = port.num_unread_bytes()
    port.reconfigure_port(baudrate=19200)
    kept = {"serialx": (before, port.num_unread_bytes())}
far, path = line()
with serial.Serial(path, 9600, timeout=1) as port:
    send(far)
    before = port.in_waiting
    port.baudrate = 19200
    kept["pyserial"] = before, port.in_waiting
print(f"octets that wait before and after a new baud rate: {kept}")
assert kept == {"serialx": (6, 0), "pyserial": (6, 6)}, "the behaviour has changed"
PY
"$dir/env/bin/python" "$dir/try.py"
# output seen:
# inter_byte_timeout=0.09: the first read gives nothing, then 6 octets wait
# inter_byte_timeout=0.2: the first read gives 100302, then 3 octets wait
# inter_byte_timeout=0.5: the first read gives 100302, then 3 octets wait
# octets that wait before and after a new baud rate: {'serialx': (6, 0), 'pyserial': (6, 6)}
