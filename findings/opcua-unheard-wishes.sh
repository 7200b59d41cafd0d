#!/bin/sh
# Three parameters of OPC UA (OPC 10000-4) by which a client wants less, at a server of asyncua 2.1.0: the monitoring mode Sampling
# (values are queued, and not reported), timestampsToReturn of Read, and requestedMaxReferencesPerNode of Browse.
# Guess: the server does less, or answers that it cannot.
# An item in the mode Sampling reports each change as one in the mode Reporting does. Each read value has both time stamps, for Source,
# Server and Neither, too. Browse with a maximum of two references gives all 26 of the node, without a continuation point. The
# status is Good each time: a client that reserves room by its own request, or has switched its reports off, gets more than it asked for.
# dpstack, which stands on asyncua, reports nothing in the mode Sampling; time stamps and Browse are as here.
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


class Seen:
    def __init__(self):
        self.values = []

    def datachange_notification(self, node, value, data):
        self.values.append(value)


async def sampled(client, variable):
    seen = Seen()
    subscription = await client.create_subscription(200, seen)
    value = ua.ReadValueId(variable.nodeid, ua.AttributeIds.Value)
    how = ua.MonitoringParameters(ClientHandle=7, QueueSize=5)
    await subscription.create_monitored_items([ua.MonitoredItemCreateRequest(value, ua.MonitoringMode.Sampling, how)])
    await asyncio.sleep(1)
    await variable.write_value(1.0)
    await asyncio.sleep(1)
    await subscription.delete()
    return seen.values


async def stamps(client, variable, wanted):
    value = ua.ReadValueId(variable.nodeid, ua.AttributeIds.Value)
    (read,) = await client.uaclient.read(ua.ReadParameters(0, wanted, [value]))
    return [name for name in ("SourceTimestamp", "ServerTimestamp") if getattr(read, name) is not None]


async def browsed(client):
    server = ua.NodeId(ua.ObjectIds.Server)
    every = ua.NodeId(ua.ObjectIds.References)
    wanted = ua.BrowseDescription(server, ua.BrowseDirection.Forward, every, True, 0, 63)
    (found,) = await client.uaclient.browse(ua.BrowseParameters(ua.ViewDescription(), 2, [wanted]))
    return len(found.References), found.ContinuationPoint


async def main():
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        url = f"opc.tcp://127.0.0.1:{one.getsockname()[1]}"
    server = Server()
    await server.init()
    server.set_endpoint(url)
    variable = await server.nodes.objects.add_variable(2, "level", 0.0)
    async with server, Client(url) as client:
        reported = await sampled(client, variable)
        print(f"mode Sampling: reported {reported} (right: nothing)")
        assert reported == [0.0, 1.0], "the behaviour has changed"
        for wanted in (ua.TimestampsToReturn.Source, ua.TimestampsToReturn.Server, ua.TimestampsToReturn.Neither):
            got = await stamps(client, variable, wanted)
            print(f"timestampsToReturn {wanted.name}: {' and '.join(got)}")
            assert got == ["SourceTimestamp", "ServerTimestamp"], "the behaviour has changed"
        count, point = await browsed(client)
        print(f"Browse, two references at most: {count}, continuation point {point}")
        assert (count, point) == (26, None), "the behaviour has changed"


asyncio.run(main())
PY
"$dir/env/bin/python" "$dir/try.py"
# output seen:
# mode Sampling: reported [0.0, 1.0] (right: nothing)
# timestampsToReturn Source: SourceTimestamp and ServerTimestamp
# timestampsToReturn Server: SourceTimestamp and ServerTimestamp
# timestampsToReturn Neither: SourceTimestamp and ServerTimestamp
# Browse, two references at most: 26, continuation point None
