#!/bin/sh
# A value with another quality than Good, published by OPC UA (asyncua 2.1.0) and read by the two clients for Python, asyncua
# itself and its forerunner opcua 0.98.13. The value 2.5 stands on the server with Good, Uncertain and Bad.
# Guess: an Uncertain value is a value ("usable, with a reservation"): read_value() returns it; a Bad one keeps its last value.
# Both clients raise on Uncertain as on Bad. Only asyncua's read_data_value(raise_on_bad_status=False) and a subscription show
# the value; opcua has no way to read it, get_data_value() raises too. With Bad the server itself throws the value away when it
# is written: nobody can read the last one.
# A gateway that publishes "uncertain, last usable value" has to expect clients for which that is an error.
set -eu
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 -m venv "$dir/env"
"$dir/env/bin/pip" --quiet --disable-pip-version-check install asyncua==2.1.0 opcua==0.98.13 >/dev/null 2>&1
cat >"$dir/old.py" <<'PY'
import logging
import sys

from opcua import Client

logging.disable(logging.CRITICAL)
client = Client(sys.argv[1])
client.connect()
for name in ("good", "uncertain", "bad"):
    for read in ("get_value", "get_data_value"):
        try:
            value = getattr(client.get_node(f"ns=2;s={name}"), read)()
            print(name, read, value if read == "get_value" else value.Value.Value)
        except Exception as error:
            print(name, read, "raises", type(error).__name__)
client.disconnect()
PY
cat >"$dir/try.py" <<'PY'
import asyncio
import logging
import socket
import sys

from asyncua import Client, Server, ua

logging.disable(logging.CRITICAL)
CODES = {"good": "Good", "uncertain": "UncertainLastUsableValue", "bad": "BadSensorFailure"}


async def main():
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        url = f"opc.tcp://127.0.0.1:{one.getsockname()[1]}/plant"
    server = Server()
    await server.init()
    server.set_endpoint(url)
    space = await server.register_namespace("urn:plant")
    for name, code in CODES.items():
        node = await server.nodes.objects.add_variable(ua.NodeId(name, space), name, 0.0)
        status = ua.StatusCode(getattr(ua.StatusCodes, code))
        await node.write_value(ua.DataValue(ua.Variant(2.5, ua.VariantType.Double), StatusCode=status))
    lines = []
    async with server, Client(url) as client:
        for name in CODES:
            node = client.get_node(ua.NodeId(name, space))
            try:
                lines.append(f"asyncua: {name} read_value {await node.read_value()}")
            except ua.UaStatusCodeError as error:
                lines.append(f"asyncua: {name} read_value raises {type(error).__name__}")
            data = await node.read_data_value(raise_on_bad_status=False)
            lines.append(f"asyncua: {name} read_data_value {data.Value.Value}")
        old = await asyncio.create_subprocess_exec(sys.executable, sys.argv[1], url, stdout=asyncio.subprocess.PIPE)
        lines += [f"opcua: {line}" for line in (await old.communicate())[0].decode().splitlines()]
    print(*lines, sep="\n")
    assert lines == [
        "asyncua: good read_value 2.5",
        "asyncua: good read_data_value 2.5",
        "asyncua: uncertain read_value raises UaStatusCodeError",
        "asyncua: uncertain read_data_value 2.5",
        "asyncua: bad read_value raises BadSensorFailure",
        "asyncua: bad read_data_value None",
        "opcua: good get_value 2.5",
        "opcua: good get_data_value 2.5",
        "opcua: uncertain get_value raises UaStatusCodeError",
        "opcua: uncertain get_data_value raises UaStatusCodeError",
        "opcua: bad get_value raises BadSensorFailure",
        "opcua: bad get_data_value raises BadSensorFailure",
    ], "the behaviour has changed"


asyncio.run(main())
PY
timeout 120 "$dir/env/bin/python" "$dir/try.py" "$dir/old.py"
# output seen: the twelve lines that are expected above
