#!/bin/sh
# A percent dead band (OPC 10000-8, 6.2: a share of the variable's EURange) at a server of asyncua 2.1.0.
# Guess: with an EURange the server reports changes above the share, without one it answers BadDeadbandFilterInvalid.
# The server accepts the filter in both cases and reports every change: the dead band does nothing.
# dpstack, which stands on asyncua, refuses such a filter (BadMonitoredItemFilterUnsupported) instead of accepting it.
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


class Changes:
    def __init__(self):
        self.values = asyncio.Queue()

    def datachange_notification(self, node, value, data):
        self.values.put_nowait(value)


async def main():
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        url = f"opc.tcp://127.0.0.1:{one.getsockname()[1]}/plant"
    server = Server()
    await server.init()
    server.set_endpoint(url)
    space = await server.register_namespace("urn:plant")
    bare = await server.nodes.objects.add_variable(space, "bare", 50.0)
    ranged = await server.nodes.objects.add_variable(space, "ranged", 50.0)
    await ranged.add_property(0, "EURange", ua.Range(0.0, 100.0))
    async with server, Client(url) as client:
        for name, node in (("without EURange", bare), ("EURange 0 to 100", ranged)):
            changes = Changes()
            subscription = await client.create_subscription(10, changes)
            await subscription.deadband_monitor(client.get_node(node.nodeid), 10.0, deadbandtype=2)
            seen = [await asyncio.wait_for(changes.values.get(), 10)]
            for value in (51.0, 52.0, 70.0):  # 1 %, 1 % and 18 %
                await node.write_value(value)
                seen.append(await asyncio.wait_for(changes.values.get(), 10))
            print(f"{name}, dead band 10 %: {seen}")
            assert seen == [50.0, 51.0, 52.0, 70.0], "the behaviour has changed"


asyncio.run(main())
PY
timeout 120 "$dir/env/bin/python" "$dir/try.py"
# output seen:
# without EURange, dead band 10 %: [50.0, 51.0, 52.0, 70.0]
# EURange 0 to 100, dead band 10 %: [50.0, 51.0, 52.0, 70.0]
