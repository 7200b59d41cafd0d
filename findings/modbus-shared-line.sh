#!/bin/sh
# A slave with the address 1 on a line with a second slave (RS-485: it hears the requests and the answers of the other one), made with
# pymodbus 3.16.1, umodbus 1.0.4 and modbus-tk 1.1.5, on a pty. "Modbus over Serial Line" 1.02, 2.1: the addressed slave alone answers,
# and nobody answers a broadcast (address 0).
# Guess: each answers its own requests, is silent at all others, and loses nothing because others have talked.
# modbus-tk does that. pymodbus answers requests to the other slave, and the broadcast, by an exception under the address of that slave,
# which sends its own answer at the same time; it also answers the answers of others that look like a request (function 6). Its option
# ignore_missing_devices=True changes nothing in this. After a function 16 of others its own request stays without answer.
# umodbus does the same with each telegram that it reads alone, and it takes for one telegram what comes within half a second: its
# answers are up to that late, and an own request soon after a telegram of others is lost.
# With one slave on the line both work. dpstack has no Modbus.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install pymodbus==3.16.1 umodbus==1.0.4 modbus-tk==1.1.5 \
    pyserial==3.5 >/dev/null 2>&1
cat >"$dir/slave.py" <<'PY'
import asyncio
import sys
import time

import serial

kind, port = sys.argv[1:]


def with_pymodbus():
    from pymodbus.framer import FramerType
    from pymodbus.server import StartAsyncSerialServer
    from pymodbus.simulator import DataType, SimData, SimDevice

    device = SimDevice(1, simdata=[SimData(0, count=100, values=7, datatype=DataType.REGISTERS)])
    more = {"ignore_missing_devices": True} if kind == "pymodbus-ignoring" else {}
    asyncio.run(StartAsyncSerialServer(device, framer=FramerType.RTU, port=port, baudrate=19200, **more))


def with_umodbus():
    from umodbus.server.serial import get_server
    from umodbus.server.serial.rtu import RTUServer

    server = get_server(RTUServer, serial.Serial(port, 19200))

    @server.route(slave_ids=[1], function_codes=[3], addresses=range(100))
    def value(slave_id, function_code, address):
        return 7

    server.serve_forever()


def with_modbus_tk():
    from modbus_tk import defines, modbus_rtu

    server = modbus_rtu.RtuServer(serial.Serial(port, 19200))
    server.start()
    device = server.add_slave(1)
    device.add_block("all", defines.HOLDING_REGISTERS, 0, 100)
    device.set_values("all", 0, [7] * 100)
    time.sleep(300)


{"umodbus": with_umodbus, "modbus-tk": with_modbus_tk}.get(kind, with_pymodbus)()
PY
cat >"$dir/try.py" <<'PY'
import os
import select
import struct
import subprocess
import sys
import time
import tty


def telegram(*octets):
    value = 0xFFFF
    for octet in octets:
        value ^= octet
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return bytes(octets) + struct.pack("<H", value)


OWN, ANSWER = telegram(1, 3, 0, 0, 0, 1), telegram(1, 3, 2, 0, 7)
OTHERS = {
    "read": (telegram(2, 3, 0, 0, 0, 2), telegram(2, 3, 4, 0, 1, 0, 2)),
    "write 6": (telegram(2, 6, 0, 5, 1, 44), telegram(2, 6, 0, 5, 1, 44)),
    "write 16": (telegram(2, 16, 0, 0, 0, 2, 4, 0, 1, 0, 2), telegram(2, 16, 0, 0, 0, 2)),
    "broadcast": (telegram(0, 6, 0, 5, 1, 44),),
}


class Line:
    """The far end of a slave's port."""

    def __init__(self, kind):
        self._line, far = os.openpty()
        tty.setraw(far)
        self._slave = subprocess.Popen(
            [sys.executable, sys.argv[1], kind, os.ttyname(far)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        self._far = far
        until = time.monotonic() + 30
        while self.asked(OWN, 1.5) != ANSWER:
            assert time.monotonic() < until, f"{kind} does not answer"

    def asked(self, octets, seconds):
        """The answer that begins within `seconds`; empty if none does."""
        os.write(self._line, octets)
        got = b""
        while select.select([self._line], [], [], 0.1 if got else seconds)[0]:
            got += os.read(self._line, 300)
        return got

    def close(self):
        self._slave.kill()
        self._slave.wait()
        os.close(self._line)
        os.close(self._far)


def judged(kind, patience):
    """Traffic of others: (how many of its telegrams are answered, how many own requests of three are not)."""
    line, found = Line(kind), {}
    try:
        for name, telegrams in {"nobody": (), **OTHERS}.items():
            answered = lost = 0
            for _ in range(3):
                answered += sum(bool(line.asked(one, patience)) for one in telegrams)
                lost += line.asked(OWN, patience) != ANSWER
            found[name] = (answered, lost)
    finally:
        line.close()
    print(f"{kind}: {found}")
    return found


def late_and_lost(kind):
    """The longest time to an answer in s, of ten; and how many of ten requests have none, 20 ms after a telegram of others."""
    line, times, lost = Line(kind), [], 0
    try:
        for _ in range(10):
            begin = time.monotonic()
            assert line.asked(OWN, 2) == ANSWER, "the behaviour has changed"
            times.append(time.monotonic() - begin - 0.1)
            time.sleep(0.13)
        for _ in range(10):
            line.asked(OTHERS["read"][1], 0.02)
            lost += line.asked(OWN, 1) != ANSWER
    finally:
        line.close()
    share = "most" if lost > 5 else lost
    print(f"{kind}: up to {max(times):.1f} s to an answer; 20 ms after others {share} of 10 requests lost")
    return max(times), lost


print("three times each: (telegrams of others that it answers, own requests that it does not)")
assert set(judged("modbus-tk", 0.3).values()) == {(0, 0)}, "the behaviour has changed"
for kind in ("pymodbus", "pymodbus-ignoring"):
    found = judged(kind, 0.3)
    assert found["nobody"] == (0, 0) and found["read"] == (3, 0), "the behaviour has changed"
    assert found["write 6"] == (6, 0) and found["broadcast"] == (3, 0), "the behaviour has changed"
    assert found["write 16"][1] == 3, "the behaviour has changed"
found = judged("umodbus", 1.5)
time_s, lost = late_and_lost("umodbus")
assert (found["nobody"], found["read"], found["broadcast"]) == ((0, 0), (6, 0), (3, 0)), "the behaviour has changed"
assert time_s > 0.15 and lost > 5, "the behaviour has changed"
PY
timeout 300 "$dir/env/bin/python" "$dir/try.py" "$dir/slave.py"
# output seen:
# three times each: (telegrams of others that it answers, own requests that it does not)
# modbus-tk: {'nobody': (0, 0), 'read': (0, 0), 'write 6': (0, 0), 'write 16': (0, 0), 'broadcast': (0, 0)}
# pymodbus: {'nobody': (0, 0), 'read': (3, 0), 'write 6': (6, 0), 'write 16': (1, 3), 'broadcast': (3, 0)}
# pymodbus-ignoring: {'nobody': (0, 0), 'read': (3, 0), 'write 6': (6, 0), 'write 16': (1, 3), 'broadcast': (3, 0)}
# umodbus: {'nobody': (0, 0), 'read': (6, 0), 'write 6': (6, 0), 'write 16': (6, 0), 'broadcast': (3, 0)}
# umodbus: up to 0.4 s to an answer; 20 ms after others most of 10 requests lost
