#!/bin/sh
# A subscription with an absolute dead band at a server of asyncua 2.1.0, and a value whose quality changes.
# Guess: the dead band holds back small changes of the value only; a new status code is always reported. OPC 10000-4, 7.22.2:
# the trigger StatusValue reports "if either the StatusCode or the value change", and the dead band counts for the value.
# The server applies the dead band to changes of the status, too: a client with a dead band never learns that its value became
# Uncertain, as long as the number stays within the band. With Bad the number is null, and the difference to it raises a TypeError,
# which the server only logs: neither Bad nor the good number after it is sent, whatever the band is. Without one all arrive.
# dpstack, which stands on asyncua, decides itself, so that a new status always comes.
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
LAST = 99.0  # outside any band and good: it arrives in any case, behind all that arrived before
WRITTEN = [
    (50.0, "UncertainLastUsableValue"),
    (50.0, "BadSensorFailure"),
    (50.0, "Good"),
    (60.0, "Good"),
    (60.2, "BadCommunicationError"),
    (60.2, "Good"),
    (LAST, "Good"),
]


class Changes:
    def __init__(self):
        self.seen = asyncio.Queue()

    def datachange_notification(self, node, value, data):
        self.seen.put_nowait((value, data.monitored_item.Value.StatusCode.name))


async def main():
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        url = f"opc.tcp://127.0.0.1:{one.getsockname()[1]}/plant"
    server = Server()
    await server.init()
    server.set_endpoint(url)
    space = await server.register_namespace("urn:plant")
    node = await server.nodes.objects.add_variable(space, "pressure", 50.0)
    found = {}
    async with server, Client(url) as client:
        for band in (None, 1.0):
            await node.write_value(50.0)
            changes = Changes()
            subscription = await client.create_subscription(10, changes)
            item = client.get_node(node.nodeid)
            if band is None:
                await subscription.subscribe_data_change(item, queuesize=100)
            else:
                await subscription.deadband_monitor(item, band, deadbandtype=1, queuesize=100)
            seen = [await asyncio.wait_for(changes.seen.get(), 10)]
            for number, name in WRITTEN:
                status = ua.StatusCode(getattr(ua.StatusCodes, name))
                await node.write_value(ua.DataValue(ua.Variant(number, ua.VariantType.Double), StatusCode=status))
            while seen[-1][0] != LAST:
                seen.append(await asyncio.wait_for(changes.seen.get(), 10))
            await subscription.delete()
            found[band] = seen
            print(f"dead band {band}: {', '.join(f'{number} {name}' for number, name in seen)}")
    first = (50.0, "Good")
    assert found[None] == [first, *((None if name.startswith("Bad") else number, name) for number, name in WRITTEN)]
    assert found[1.0] == [first, (60.0, "Good"), (LAST, "Good")], "the behaviour has changed"


asyncio.run(main())
PY
timeout 120 "$dir/env/bin/python" "$dir/try.py"
# output seen:
# dead band None: 50.0 Good, 50.0 UncertainLastUsableValue, None BadSensorFailure, 50.0 Good, 60.0 Good, None BadCommunicationError, 60.2 Good, 99.0 Good
# dead band 1.0: 50.0 Good, 60.0 Good, 99.0 Good
