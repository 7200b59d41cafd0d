#!/bin/sh
# An integer of 16 bits with a sign (a setpoint in 1/min), put over PV Access by a client of p4p 4.3.0 (EPICS) to a server of p4p; and the
# same numbers in values of pvapy 5.6.0.
# Guess: a number that the type cannot hold is refused by an error, as Python's own struct and array do, and nothing is sent.
# p4p cuts it to its low 16 bits without a word, in the client, before the server can judge it: 40000 arrives as -25536, full speed in
# the other direction, and 70000 as 4464. The same happens to a value that a server posts. An array raises OverflowError, since numpy
# judges it. pvapy raises OverflowError for the single number, too.
# A server that checks the limits of its orders sees only what is left. dpstack's server (Channel Access) refuses a number out of range.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install p4p==4.3.0 pvapy==5.6.0 >/dev/null 2>&1
cat >"$dir/try.py" <<'PY'
import pvaccess
from p4p.client.thread import Context
from p4p.nt import NTScalar
from p4p.server import Server
from p4p.server.thread import SharedPV

seen = []
speed = SharedPV(nt=NTScalar("h"), initial=0)
pulses = SharedPV(nt=NTScalar("ah"), initial=[0])


@speed.put
@pulses.put
def on_put(pv, operation):
    seen.append(operation.value())
    pv.post(operation.value())
    operation.done()


def tried(step):
    try:
        return step()
    except OverflowError:
        return "OverflowError"


with Server(providers=[{"DP:SPEED": speed, "DP:PULSES": pulses}], isolate=True) as server:
    with Context("pva", conf=server.conf(), useenv=False) as client:
        got = {}
        for number in (1500, 40000, 70000):
            client.put("DP:SPEED", number)
            got[number] = (int(seen[-1]), int(client.get("DP:SPEED")))
        posted = tried(lambda: speed.post(40000)) or int(client.get("DP:SPEED"))
        array = tried(lambda: client.put("DP:PULSES", [40000]))
other = tried(lambda: pvaccess.PvObject({"value": pvaccess.SHORT}, {"value": 40000}))
print(f"put by p4p: (what the server sees, what a client reads) {got}")
print(f"posted by the server: 40000 -> {posted}; put as an array: {array}; pvapy: {other}")
assert got == {1500: (1500, 1500), 40000: (-25536, -25536), 70000: (4464, 4464)}, "the behaviour has changed"
assert (posted, array, other) == (-25536, "OverflowError", "OverflowError"), "the behaviour has changed"
PY
timeout 120 "$dir/env/bin/python" "$dir/try.py"
# output seen:
# put by p4p: (what the server sees, what a client reads) {1500: (1500, 1500), 40000: (-25536, -25536), 70000: (4464, 4464)}
# posted by the server: 40000 -> -25536; put as an array: OverflowError; pvapy: OverflowError
