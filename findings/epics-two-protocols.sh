#!/bin/sh
# One record of an EPICS IOC (softioc 4.7.2), read over Channel Access (aioca 2.1) and over PV Access (p4p 4.3.0).
# Guess: a client sees the same unit and the same number, whichever of the two protocols it speaks.
# Over Channel Access a unit has 7 characters: "mbar abs" becomes "mbar ab", and a 64-bit number is a double: 2^53 + 1 becomes
# 2^53. Over PV Access both are whole.
# A gateway that publishes counters or units to EPICS has to say so, or to keep within 7 characters and 53 bits.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install softioc==4.7.2 aioca==2.1 p4p==4.3.0 >/dev/null 2>&1
cat >"$dir/ioc.py" <<'PY'
import sys

from softioc import asyncio_dispatcher, builder, softioc

dispatcher = asyncio_dispatcher.AsyncioDispatcher()
builder.SetDeviceName("DP")
builder.aIn("PRESSURE", initial_value=1.25, EGU="mbar abs", PREC=2)
builder.int64In("TELEGRAMS", initial_value=2**53 + 1)
builder.LoadDatabase()
softioc.iocInit(dispatcher)
print("up", flush=True)
sys.stdin.read()
PY
cat >"$dir/try.py" <<'PY'
import asyncio
import os
import socket
import subprocess
import sys

with socket.socket() as one, socket.socket() as two:
    one.bind(("127.0.0.1", 0))
    two.bind(("127.0.0.1", 0))
    ports = one.getsockname()[1], two.getsockname()[1]
for kind, port in zip(("CA", "PVA"), ports):
    os.environ[f"EPICS_{kind}_ADDR_LIST"] = "127.0.0.1"
    os.environ[f"EPICS_{kind}_AUTO_ADDR_LIST"] = "NO"
    os.environ[f"EPICS_{kind}S_INTF_ADDR_LIST"] = "127.0.0.1"
    os.environ[f"EPICS_{kind}_SERVER_PORT"] = os.environ[f"EPICS_{kind}S_SERVER_PORT"] = str(port)
os.environ["EPICS_PVA_BROADCAST_PORT"] = os.environ["EPICS_PVAS_BROADCAST_PORT"] = str(ports[1])

import aioca
from p4p.client.thread import Context

ioc = subprocess.Popen([sys.executable, sys.argv[1]], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
try:
    while ioc.stdout.readline() != "up\n":
        assert ioc.poll() is None, "the IOC has ended"

    async def over_ca():
        pressure = await aioca.caget("DP:PRESSURE", format=aioca.FORMAT_CTRL, timeout=20)
        return pressure.units, int(await aioca.caget("DP:TELEGRAMS", timeout=20))

    ca = asyncio.run(over_ca())
    with Context("pva", nt=False) as context:
        pressure = context.get("DP:PRESSURE", timeout=20)
        pva = pressure.display.units, context.get("DP:TELEGRAMS", timeout=20).value
finally:
    ioc.kill()
    ioc.wait()
print(f"Channel Access: unit {ca[0]!r}, counter {ca[1]}")
print(f"PV Access: unit {pva[0]!r}, counter {pva[1]}")
assert ca == ("mbar ab", 2**53), "the behaviour has changed"
assert pva == ("mbar abs", 2**53 + 1), "the behaviour has changed"
PY
# the libraries remark on stderr that the IOC has gone at the end
timeout 120 "$dir/env/bin/python" "$dir/try.py" "$dir/ioc.py" 2>"$dir/stderr" || { cat "$dir/stderr" >&2; exit 1; }
# output seen:
# Channel Access: unit 'mbar ab', counter 9007199254740992
# PV Access: unit 'mbar abs', counter 9007199254740993
