#!/bin/sh
# pyprofibus 1.13 (pyserial 3.5) as the only master of a bus with one slave, at 9600 bit/s on a pty.
# Guess: before a request it waits until the line has been idle for 33 bit times (T_SYN, 3.4 ms), by which every station finds
# the beginning of a telegram; and as a master alone it passes the token to itself after each round.
# Its next request follows the answer at once, and there is no token at all.
# So its rotations are shorter than the rules allow: a line that keeps the idle time by itself (bench rotation) has to hold its
# requests back, and a real slave has to find their beginning without the pause.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install pyprofibus==1.13 pyserial==3.5 >/dev/null 2>&1
cat >"$dir/master.py" <<'PY'
import sys
from types import SimpleNamespace

from pyprofibus.dp import DpCfgDataElement
from pyprofibus.dp_master import DPM1, DpSlaveDesc
from pyprofibus.phy_serial import CpPhySerial

phy = CpPhySerial(port=sys.argv[1])
phy.setConfig(baudrate=9600)
master = DPM1(phy=phy, masterAddr=2)
gsd = SimpleNamespace(getIdentNumber=lambda: 0x4711)
conf = SimpleNamespace(gsd=gsd, addr=8, name="s", index=0, inputSize=2, outputSize=2, diagPeriod=0)
slave = DpSlaveDesc(conf)
slave.setCfgDataElements([DpCfgDataElement(0x31)])
master.addSlave(slave)
master.initialize()
slave.setMasterOutData(bytes(2))
while True:
    if master.run() is not None:
        slave.setMasterOutData(bytes(2))
PY
cat >"$dir/try.py" <<'PY'
import os
import subprocess
import sys
import time
import tty
from statistics import median

BIT = 1 / 9600
line, far = os.openpty()
tty.setraw(far)
master = subprocess.Popen([sys.executable, sys.argv[1], os.ttyname(far)], stdout=subprocess.DEVNULL)
buffer = b""


def telegram():
    """One telegram of the master, and when it was read."""
    global buffer
    while True:
        size = {0x10: 6, 0xDC: 3, 0x68: buffer[1] + 6 if len(buffer) > 1 else 99}[buffer[0]] if buffer else 99
        if len(buffer) >= size:
            got, buffer = buffer[:size], buffer[size:]
            return got, time.monotonic()
        buffer += os.read(line, 300)


def answer_to(got):
    """That of a slave at address 8 which accepts everything: 2 octets each way."""
    if got[0] == 0x10:
        body = bytes((2, 8, 0))
        return bytes((0x10, *body, sum(body) & 0xFF, 0x16))
    saps = got[7:9] if got[4] & 0x80 else b""
    if saps[:1] in (b"\x3d", b"\x3e"):
        return b"\xe5"
    if saps[:1] == b"\x3c":
        body = bytes((0x82, 0x88, 8, saps[1], saps[0], 0, 4, 0, 2, 0x47, 0x11))
    else:
        body = bytes((2, 8, 8, 0, 0))
    return bytes((0x68, len(body), len(body), 0x68, *body, sum(body) & 0xFF, 0x16))


gaps, tokens, answered = [], 0, 0.0
try:
    while len(gaps) < 100:
        got, at = telegram()
        if got[0] == 0xDC or got[4 if got[0] == 0x68 else 1] & 0x7F != 8:
            tokens += got[0] == 0xDC and bool(gaps)
            answered = 0.0
            continue
        exchange = got[0] == 0x68 and not got[4] & 0x80
        if exchange and answered:
            gaps.append(at - answered)
        answer = answer_to(got)
        # both telegrams take their time on the line
        time.sleep(11 * BIT * (len(got) + len(answer) + 1))
        os.write(line, answer)
        answered = time.monotonic() if exchange else 0.0
finally:
    master.kill()
    master.wait()
sooner = sum(gap < 33 * BIT for gap in gaps)
print(f"from the end of an answer to the next request: median {1000 * median(gaps):.1f} ms, T_SYN is {33000 * BIT:.1f} ms")
print(f"sooner than T_SYN: {'most' if sooner > 50 else sooner} of {len(gaps)}; tokens: {tokens}")
assert sooner > 50 and not tokens, "the behaviour has changed"
PY
timeout 120 "$dir/env/bin/python" "$dir/try.py" "$dir/master.py"
# output seen:
# from the end of an answer to the next request: median 0.3 ms, T_SYN is 3.4 ms
# sooner than T_SYN: most of 100; tokens: 0
