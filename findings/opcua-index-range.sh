#!/bin/sh
# One element of an array, read and written by its IndexRange (OPC 10000-4, 7.27), at a server of asyncua 2.1.0.
# Guess: the server gives and sets that element, or answers that it cannot (BadIndexRangeInvalid, BadIndexRangeNoData, or
# BadWriteNotSupported, which the standard has for writes with an IndexRange).
# It answers Good and ignores the range, though the same package's client has an argument for it: a read gives the whole array,
# with an impossible range, too, and a write of element 1 replaces all four elements by the one that was sent.
# dpstack, which stands on asyncua, refuses both (BadWriteNotSupported, BadIndexRangeNoData): its values are no arrays.
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
BEFORE = [1.0, 2.0, 3.0, 4.0]


async def main():
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        url = f"opc.tcp://127.0.0.1:{one.getsockname()[1]}/plant"
    server = Server()
    await server.init()
    server.set_endpoint(url)
    space = await server.register_namespace("urn:plant")
    node = await server.nodes.objects.add_variable(space, "limits", BEFORE)
    await node.set_writable()
    async with server, Client(url) as client:
        item = client.get_node(node.nodeid)
        seen = {}
        for part in ("1", "1:2", "9"):
            data = await item.read_attribute(ua.AttributeIds.Value, part)
            seen[part] = (data.StatusCode.name, data.Value.Value)
            print(f"read [{part}]: {data.StatusCode.name} {data.Value.Value}")
        element = ua.DataValue(ua.Variant([9.0], ua.VariantType.Double))
        await item.write_attribute(ua.AttributeIds.Value, element, "1")  # raises if it is refused
        after = await node.read_value()
        print(f"write [1] = 9.0: {BEFORE} became {after}")
    assert seen == dict.fromkeys(seen, ("Good", BEFORE)), "the behaviour has changed"
    assert after == [9.0], "the behaviour has changed"


asyncio.run(main())
PY
timeout 120 "$dir/env/bin/python" "$dir/try.py"
# output seen:
# read [1]: Good [1.0, 2.0, 3.0, 4.0]
# read [1:2]: Good [1.0, 2.0, 3.0, 4.0]
# read [9]: Good [1.0, 2.0, 3.0, 4.0]
# write [1] = 9.0: [1.0, 2.0, 3.0, 4.0] became [9.0]
