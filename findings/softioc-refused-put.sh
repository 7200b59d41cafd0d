#!/bin/sh
# A put with completion to an output record of softioc 4.7.2 that the program refuses: in `validate`, and in a blocking
# `on_update` that raises. Client: aioca 2.1, caput with wait=True.
# Guess: the put fails for the client.
# Both puts are successful for the client. The refused value of `validate` is not stored; the one of `on_update` is, and
# the record shows it as a good value without an alarm.
# A server of orders on softioc cannot tell its clients that an order was refused: dpstack serves EPICS with caproto.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install softioc==4.7.2 aioca==2.1 >/dev/null 2>&1
cat >"$dir/ioc.py" <<'PY'
import sys

from softioc import asyncio_dispatcher, builder, softioc

dispatcher = asyncio_dispatcher.AsyncioDispatcher()
builder.SetDeviceName("DP")


async def refuse(value):
    raise ValueError("the plant refuses it")


builder.aOut("VALIDATED", initial_value=0, validate=lambda record, value: value < 5)
builder.aOut("UPDATED", initial_value=0, on_update=refuse, blocking=True)
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

ioc = subprocess.Popen(
    [sys.executable, sys.argv[1]], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
)


async def put(name):
    result = await aioca.caput(name, 7, wait=True, throw=False, timeout=20)
    value = await aioca.caget(name, format=aioca.FORMAT_TIME, timeout=20)
    return result.ok, float(value), value.severity


async def both():
    return [await put(f"DP:{name}") for name in ("VALIDATED", "UPDATED")]


try:
    while ioc.stdout.readline() != "up\n":
        assert ioc.poll() is None, "the IOC has ended"
    found = asyncio.run(both())
finally:
    ioc.kill()
    ioc.wait()
for where, (ok, value, severity) in zip(("validate", "on_update"), found):
    print(f"refused in {where}: put {'successful' if ok else 'failed'}, value {value}, severity {severity}")
assert found == [(True, 0.0, 0), (True, 7.0, 0)], "the behaviour has changed"
PY
# the library remarks on stderr that the IOC has gone at the end
timeout 120 "$dir/env/bin/python" "$dir/try.py" "$dir/ioc.py" 2>"$dir/stderr" || { cat "$dir/stderr" >&2; exit 1; }
# output seen:
# refused in validate: put successful, value 0.0, severity 0
# refused in on_update: put successful, value 7.0, severity 0
