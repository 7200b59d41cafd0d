#!/bin/sh
# The alarm limits of a number at a server of caproto 1.3.0 (upper and lower alarm limit 5 and -5, warning limits 4 and -4), and of
# a record ai of EPICS base (softioc 4.7.2, read by aioca 2.1).
# Guess: a value above the limit has the alarm HIHI from the start, and NaN has the alarm INVALID, as in EPICS base.
# caproto judges a value when it is written, not the one that the server begins with: 6.0 has no alarm until 6.0 is written again.
# NaN has no alarm at all, since no comparison is true, and it takes an alarm away: 6.0 with MAJOR, a broken sensor's NaN, and
# the screen is without a colour. EPICS base says INVALID for NaN, and MAJOR for the first value.
# A server of process data has to set status and severity itself, as dpstack does.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/caproto"
"$dir/caproto/bin/pip" --quiet --disable-pip-version-check install caproto==1.3.0 >/dev/null 2>&1
python3 -m venv "$dir/softioc"
"$dir/softioc/bin/pip" --quiet --disable-pip-version-check install softioc==4.7.2 aioca==2.1 >/dev/null 2>&1
cat >"$dir/try.py" <<'PY'
import asyncio

from caproto import AlarmSeverity, AlarmStatus, ChannelDouble


async def main():
    limits = {"upper_alarm_limit": 5.0, "upper_warning_limit": 4.0, "lower_warning_limit": -4.0, "lower_alarm_limit": -5.0}
    channel = ChannelDouble(value=6.0, **limits)
    seen = []
    for value in (None, 6.0, float("nan"), 4.5, float("nan")):  # None: the value that it begins with
        if value is not None:
            await channel.write(value)
        seen.append((AlarmStatus(channel.alarm.status).name, AlarmSeverity(channel.alarm.severity).name))
        print(f"caproto, {'6.0 from the start' if value is None else value}: {' '.join(seen[-1])}")
    none = ("NO_ALARM", "NO_ALARM")
    assert seen == [none, ("HIHI", "MAJOR_ALARM"), none, ("HIGH", "MINOR_ALARM"), none], "the behaviour has changed"


asyncio.run(main())
PY
cat >"$dir/ioc.py" <<'PY'
import sys

from softioc import asyncio_dispatcher, builder, softioc

dispatcher = asyncio_dispatcher.AsyncioDispatcher()
builder.SetDeviceName("DP")
limits = {"HIHI": 5, "HIGH": 4, "LOW": -4, "LOLO": -5, "HHSV": "MAJOR", "HSV": "MINOR", "LSV": "MINOR", "LLSV": "MAJOR"}
level = builder.aIn("LEVEL", initial_value=6.0, **limits)
builder.LoadDatabase()
softioc.iocInit(dispatcher)
print("up", flush=True)
for line in sys.stdin:
    level.set(float(line))
PY
cat >"$dir/base.py" <<'PY'
import asyncio
import os
import socket
import subprocess
import sys

with socket.socket() as one, socket.socket() as two:
    ports = []
    for each in (one, two):
        each.bind(("127.0.0.1", 0))
        ports.append(str(each.getsockname()[1]))
os.environ.update(
    EPICS_CA_SERVER_PORT=ports[0],
    EPICS_CA_REPEATER_PORT=ports[1],
    EPICS_CA_AUTO_ADDR_LIST="NO",
    EPICS_CA_ADDR_LIST="127.0.0.1",
    EPICS_CAS_INTF_ADDR_LIST="127.0.0.1",
    EPICS_CAS_AUTO_BEACON_ADDR_LIST="NO",
    EPICS_CAS_BEACON_ADDR_LIST="127.0.0.1",
)
from aioca import FORMAT_TIME, caget  # it reads the environment


async def severity(wanted):
    for _ in range(100):
        value = await caget("DP:LEVEL", format=FORMAT_TIME)
        if str(float(value)) == wanted:
            break
        await asyncio.sleep(0.1)
    return ("none", "MINOR", "MAJOR", "INVALID")[value.severity]


ioc = subprocess.Popen([sys.executable, sys.argv[1]], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
try:
    while "up" not in ioc.stdout.readline():
        pass
    first = asyncio.run(severity("6.0"))
    ioc.stdin.write("nan\n")
    ioc.stdin.flush()
    nan = asyncio.run(severity("nan"))
finally:
    ioc.kill()
print(f"EPICS base, 6.0 from the start: {first}; nan: {nan}")
assert (first, nan) == ("MAJOR", "INVALID"), "the behaviour has changed"
PY
"$dir/caproto/bin/python" "$dir/try.py"
"$dir/softioc/bin/python" "$dir/base.py" "$dir/ioc.py" 2>/dev/null
# output seen:
# caproto, 6.0 from the start: NO_ALARM NO_ALARM
# caproto, 6.0: HIHI MAJOR_ALARM
# caproto, nan: NO_ALARM NO_ALARM
# caproto, 4.5: HIGH MINOR_ALARM
# caproto, nan: NO_ALARM NO_ALARM
# EPICS base, 6.0 from the start: MAJOR; nan: INVALID
