#!/bin/sh
# Programs of Debian 12 that open a serial port at a rate given on the command line, at four rates of PROFIBUS, on a pty: minicom 2.8-2,
# screen 4.9.0-4, picocom 3.1-4, tio 2.5-1, and mbpoll 1.4.11 with libmodbus 3.1.6 (Modbus RTU). They are unpacked into a temporary
# folder; this needs apt-get with the lists of Debian 12 and dpkg-deb.
# Guess: each sets the rate, or ends with an error. 500 kbit/s has a constant in termios; 45.45, 93.75 and 187.5 kbit/s have none, and
# Linux sets them through TCSETS2.
# picocom and tio set all four. minicom takes 115200 for the three without a constant, screen and mbpoll take 9600, and none says so:
# mbpoll even prints "187500-8E1". Whoever tries an adapter with them finds garbage, or a slave that does not answer.
# `stty -F PORT` shows the rate that a port has. dpstack sets the rate through TCSETS2, and reads it back.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 - "$dir" <<'PY'
import subprocess
import sys

names = ["minicom=2.8-2", "screen=4.9.0-4", "picocom=3.1-4", "tio=2.5-1", "libinih1=55-1", "mbpoll=1.4.11+dfsg-2"]
names += ["libmodbus5=3.1.6-2.1+deb12u1", "libtinfo6=6.4-4"]
got = subprocess.run(["apt-get", "download", "-q", *names], cwd=sys.argv[1], capture_output=True, text=True)
sys.exit(got.stderr if got.returncode else 0)
PY
for package in "$dir"/*.deb; do dpkg-deb -x "$package" "$dir/root"; done
cat >"$dir/try.py" <<'PY'
import fcntl
import os
import subprocess
import sys
import time
import tty
from pathlib import Path

TCGETS2 = 0x802C542A
FIRST = 38400  # of a new pty
folder = Path(sys.argv[1])
programs = {
    "minicom": ["-b", "RATE", "-o", "-D", "PORT"],
    "screen": ["PORT", "RATE"],
    "picocom": ["-b", "RATE", "PORT"],
    "tio": ["-b", "RATE", "PORT"],
    "mbpoll": ["-m", "rtu", "-b", "RATE", "-P", "even", "-o", "0.1", "PORT"],
}
env = {"PATH": os.environ["PATH"], "TERM": "vt100", "HOME": str(folder), "SCREENDIR": str(folder / "screens")}
env["LD_LIBRARY_PATH"] = str(next((folder / "root/usr/lib").glob("*-linux-gnu")))
(folder / "screens").mkdir(mode=0o700)


def rate_of(port):
    settings = bytearray(44)
    fcntl.ioctl(port, TCGETS2, settings)
    return int.from_bytes(settings[40:44], sys.byteorder)


def rate_set_by(name, rate):
    """The rate of the port while the program has it, or None if it refuses; and what it printed."""
    line, port = os.openpty()
    screen, keyboard = os.openpty()
    tty.setraw(port)
    given = {"RATE": str(rate), "PORT": os.ttyname(port)}
    command = [folder / "root/usr/bin" / name, *(given.get(word, word) for word in programs[name])]
    streams = {"stdin": keyboard, "stdout": keyboard, "stderr": keyboard}
    program = subprocess.Popen(command, **streams, env=env, start_new_session=True)
    try:
        until = time.monotonic() + 20
        while rate_of(port) == FIRST and program.poll() is None and time.monotonic() < until:
            time.sleep(0.05)
        time.sleep(0.5)
        found = rate_of(port)
        os.set_blocking(screen, False)
        printed = os.read(screen, 65536)
    finally:
        program.terminate()
        try:
            program.wait(5)
        except subprocess.TimeoutExpired:
            program.kill()
            program.wait()
        for one in (line, port, screen, keyboard):
            os.close(one)
    return None if found == FIRST else found, printed


rates = (45450, 93750, 187500, 500000)
for name in programs:
    found, printed = zip(*(rate_set_by(name, rate) for rate in rates))
    print(f"{name}: {dict(zip(rates, found))}{', says 187500-8E1' if b'187500-8E1' in printed[2] else ''}")
    other = {"minicom": 115200, "screen": 9600, "mbpoll": 9600}.get(name)
    assert found == ((other,) * 3 + (500000,) if other else rates), "the behaviour has changed"
    assert name != "mbpoll" or b"187500-8E1" in printed[2], "the behaviour has changed"
PY
timeout 300 python3 "$dir/try.py" "$dir"
# output seen:
# minicom: {45450: 115200, 93750: 115200, 187500: 115200, 500000: 500000}
# screen: {45450: 9600, 93750: 9600, 187500: 9600, 500000: 500000}
# picocom: {45450: 45450, 93750: 93750, 187500: 187500, 500000: 500000}
# tio: {45450: 45450, 93750: 93750, 187500: 187500, 500000: 500000}
# mbpoll: {45450: 9600, 93750: 9600, 187500: 9600, 500000: 500000}, says 187500-8E1
