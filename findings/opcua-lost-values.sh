#!/bin/sh
# A monitored item with a queue of three, and seven values within one publishing interval, at a server of asyncua 2.1.0.
# Guess: three values arrive, and one of them says that others were lost. OPC 10000-4, 5.12.1.5 (version 1.04): if the queue is
# larger than one, the Overflow bit of a status code is set, in the oldest value that is left; with discardOldest = false the two
# oldest ones stay, and the newest replaces the third. A requested size of 0 means a queue of one (7.16).
# The server keeps the newest three in both cases, each with the status Good without the bit: a client that counts pulses or
# looks for the first edge cannot know that it has not got them all. A size of 0 is a queue of 10000: all seven arrive.
# dpstack, which stands on asyncua, sets the bit, keeps the oldest if the client wants them, and makes 0 a queue of one.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install asyncua==2.1.0 >/dev/null 2>&1
cat >"$dir/try.py" <<'PY'
import asyncio
import logging
import socket

from asyncua import Client, Server, ua

logging.disable(logging.CRITICAL)
VALUES = [float(number) for number in range(1, 8)]


class Seen:
    def __init__(self):
        self.values = []

    def datachange_notification(self, node, value, data):
        self.values.append((value, data.monitored_item.Value.StatusCode.value))


async def arrived(client, variable, size, discards_oldest):
    await variable.write_value(0.0)
    seen = Seen()
    subscription = await client.create_subscription(1000, seen)
    wanted = ua.MonitoredItemCreateRequest(
        ua.ReadValueId(variable.nodeid, ua.AttributeIds.Value),
        ua.MonitoringMode.Reporting,
        ua.MonitoringParameters(ClientHandle=7, QueueSize=size, DiscardOldest=discards_oldest),
    )
    (number,) = await subscription.create_monitored_items([wanted])
    while not seen.values:
        await asyncio.sleep(0.01)
    seen.values.clear()
    for value in VALUES:
        await variable.write_value(value)
    await asyncio.sleep(2.5)
    await subscription.delete()
    return seen.values


async def main():
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        url = f"opc.tcp://127.0.0.1:{one.getsockname()[1]}"
    server = Server()
    await server.init()
    server.set_endpoint(url)
    variable = await server.nodes.objects.add_variable(2, "pulses", 0.0)
    async with server, Client(url) as client:
        return {case: await arrived(client, variable, *case) for case in ((3, True), (3, False), (0, True))}


found = asyncio.run(main())
for (size, discards_oldest), values in found.items():
    print(f"queue size {size}, discardOldest {discards_oldest}: {values}")
newest = [(value, 0) for value in VALUES[-3:]]
every = [(value, 0) for value in VALUES]
assert found == {(3, True): newest, (3, False): newest, (0, True): every}, "the behaviour has changed"
PY
"$dir/env/bin/python" "$dir/try.py"
# output seen:
# queue size 3, discardOldest True: [(5.0, 0), (6.0, 0), (7.0, 0)]
# queue size 3, discardOldest False: [(5.0, 0), (6.0, 0), (7.0, 0)]
# queue size 0, discardOldest True: [(1.0, 0), (2.0, 0), (3.0, 0), (4.0, 0), (5.0, 0), (6.0, 0), (7.0, 0)]
