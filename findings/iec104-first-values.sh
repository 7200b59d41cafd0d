#!/bin/sh
# The quality of a measured value at a client of IEC 60870-5-104 made with c104 2.2.1, before a station has sent it, and after the
# connection has gone. The server, made with c104 too, has the point 3 and no point 9.
# Guess: "good" means that the station has said so. Before, and for a point that the station does not have, the quality is
# invalid or missing; after the connection has gone it is not topical (the standard's bits IV and NT, 60870-5-101, 7.2.6.3).
# A new point is 0.0 with a good quality and the present time as processed_at: before any connection, and for ever at the address 9,
# a slip in a list of addresses. If the connection goes, the last value stays good. So a pressure of 0 bar that nobody has measured is
# as good as one that a station has sent. The server's side of a point that no program has set yet is sent as 0.0 and good.
# A program has to remember itself what has come (on_receive), and to look at the connection's state. dpstack's values are stale until
# the slave has sent them, and once it is silent.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install c104==2.2.1 >/dev/null 2>&1
cat >"$dir/try.py" <<'PY'
import socket
import time

import c104

with socket.socket() as one:
    one.bind(("127.0.0.1", 0))
    port = one.getsockname()[1]
server = c104.Server(ip="127.0.0.1", port=port, tick_rate_ms=100)
station = server.add_station(47)
pressure = station.add_point(3, c104.Type.M_ME_NC_1)
pressure.value = 21.5
station.add_point(4, c104.Type.M_ME_NC_1)

client = c104.Client(tick_rate_ms=100, command_timeout_ms=5000)
connection = client.add_connection("127.0.0.1", port, init=c104.Init.NONE)
remote = connection.add_station(47)
points = {address: remote.add_point(address, c104.Type.M_ME_NC_1) for address in (3, 4, 9)}
found = {}


def look(when):
    found[when] = {address: (one.value, one.quality.is_good()) for address, one in points.items()}
    print(f"{when}: {found[when]}")


def wait_for(condition, what):
    until = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < until, what
        time.sleep(0.1)


print("address: (value, is it good)")
look("before any connection")
server.start()
client.start()
wait_for(lambda: connection.is_connected, "no connection")
connection.unmute()
wait_for(lambda: connection.interrogation(common_address=47, wait_for_response=True), "no answer")
wait_for(lambda: points[3].value == 21.5, "no value came")
time.sleep(1)
look("connected")
server.stop()
wait_for(lambda: not connection.is_connected, "the connection stays")
time.sleep(1)
look("without the server")
client.stop()
nothing = (0.0, True)
assert set(found["before any connection"].values()) == {nothing}, "the behaviour has changed"
for when in ("connected", "without the server"):
    assert found[when] == {3: (21.5, True), 4: nothing, 9: nothing}, "the behaviour has changed"
PY
timeout 120 "$dir/env/bin/python" "$dir/try.py"
# output seen:
# address: (value, is it good)
# before any connection: {3: (0.0, True), 4: (0.0, True), 9: (0.0, True)}
# connected: {3: (21.5, True), 4: (0.0, True), 9: (0.0, True)}
# without the server: {3: (21.5, True), 4: (0.0, True), 9: (0.0, True)}
