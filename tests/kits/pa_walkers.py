"""Three programs of others as judges of PROFIBUS PA devices; each runs from a checkout, and reads through a gateway.

``PYTHONPATH=tests/kits python -m pa_walkers PROGRAM CHECKOUT [ADDRESS]`` lets one read the toy device of this module,
or with ``--read MODULE:FUNCTION`` any other. The checkouts are no part of dpstack:
docs/development/foreign.md#process-devices names them with their commits and the packages that they need.
"""

from __future__ import annotations

import argparse
import asyncio
import importlib
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Final, NamedTuple

from pa_gateway import Read, gateway

#: a program that takes longer hangs: one of them waits 20 s for an answer
HANGS_S: Final = 60.0


class Walker(NamedTuple):
    """``driver``: a program of ours that runs in the checkout, with the gateway's port and the device's address as
    arguments. ``typed``: what a person types into it."""

    driver: str
    typed: str = ""


#: reads the addresses 0 to 9, then prints maker, blocks, unit and value of those that answer
_HABLIX: Final = Walker(
    """
import runpy, sys, time
time.sleep = lambda seconds: None
sys.path.insert(0, ".")
runpy.run_path("acyclic_profibus.py")
""",
    "127.0.0.1:{port}\n3\n{address}\n\n4\n",
)
#: the page of the device, then of each block on it; the program starts Flask, here its pages are asked for directly
_BROWSER: Final = Walker(
    """
import html, re, sys
sys.path.insert(0, ".")
import connection, server
server.conn = connection.Connection("127.0.0.1", int(sys.argv[1]))
client = server.app.test_client()

def page(path):
    answer = client.get(path)
    text = re.sub(r"<!--.*?-->|<[^>]*>", " ", answer.get_data(as_text=True), flags=re.DOTALL)
    print(path, answer.status_code, " ".join(html.unescape(text).split()))
    return answer.get_data(as_text=True)

for path in re.findall(r'href="(/block[^"]*)"', page("/device?addr=" + sys.argv[2])):
    page(path)
"""
)
#: header, directory, then every block with each parameter that it knows of the block's class
_JANNUSCH: Final = Walker(
    """
import socket, sys
sys.path.insert(0, ".")
import Device, Block
from scapy.all import Raw, UDP
line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
line.settimeout(30)
line.connect(("127.0.0.1", int(sys.argv[1])))

def ask(packet, **options):
    line.send(bytes(packet[Raw]))
    return Raw(line.recv(1024))

Device.sr1 = ask
device = Device.Device(int(sys.argv[2]), Device.PrintLevel.FULL)
device.request_header()
device.request_composit_list_directory()
for kind, blocks in (("pb", device.slot_index_pb), ("tb", device.slot_index_tb), ("fb", device.slot_index_fb)):
    for number, place in enumerate(blocks):
        block = device.inspect_block(number, kind)
        print(kind, number, place["slot"], place["index"], block.parent_class.name, block.block_class.name)
        known = Block.blockViewAdapting(block.block_class) or ()
        answers = device.request_additional_information(place, {one.name: one for one in known})
        for name, answer in answers.items():
            print(" ", name, answer)
"""
)
WALKERS: Final[Mapping[str, Walker]] = {"hablix": _HABLIX, "browser": _BROWSER, "jannusch": _JANNUSCH}


class Walk(NamedTuple):
    """``text``: what the program printed, errors last. ``asked``: the parameters that it read."""

    code: int
    text: str
    asked: list[tuple[int, int, int]]
    refused: dict[tuple[int, int, int], str]


async def walk(name: str, checkout: Path, read: Read, address: int, python: str = sys.executable) -> Walk:
    """Let the program ``name`` of :data:`WALKERS` read the device ``address`` through ``read``."""
    walker = WALKERS[name]
    async with gateway(read) as served:
        process = await asyncio.create_subprocess_exec(
            python,
            "-c",
            walker.driver,
            str(served.port),
            str(address),
            cwd=checkout,
            env={**os.environ, "TERM": "xterm", "PYTHONDONTWRITEBYTECODE": "1", "PYTHONIOENCODING": "utf-8"},
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
        )
        typed = walker.typed.format(port=served.port, address=address)
        try:
            async with asyncio.timeout(HANGS_S):
                out, err = await process.communicate(typed.encode())
        except TimeoutError:
            process.kill()
            out, err = await process.communicate()
        text = (out + err).decode("utf-8", "replace")
        return Walk(process.returncode or 0, text, served.asked, served.refused)


# --- a toy device ---------------------------------------------------------------------------------------------------

#: a temperature transmitter in 17 parameters; its directory has one record of entries, which all three programs read
TOY: Final[Mapping[tuple[int, int], str]] = {
    (1, 0): "0000 0001 0001 0006 0001 0003",
    (1, 1): "0104 0001 0105 0001 0106 0001 0010 001B 0150 0033 0110 0024",
    # physical block: Siemens, DIAGNOSIS maintenance required
    (0, 16): "FA 01 01 FA 00000000 0000 4002 0301 00 001B 0031 01",
    (0, 26): "002A",
    (0, 27): "546F7954 31202020 20202020 20202020",
    (0, 29): "00200000",
    (0, 34): "0999",
    # transducer block: temperature, resistance thermometer
    (1, 80): "FA 03 02 02 00000000 0000 4002 0301 00 0033 018C 01",
    (1, 88): "41C80000 80",
    (1, 89): "03E9",
    # function block: analog input
    (1, 16): "FA 02 01 01 00000000 0000 4002 0301 00 0024 013D 01",
    (1, 26): "41C80000 80",
    (1, 28): "42C80000 00000000 03E9 02",
    (1, 22): "08 98 08",
    (1, 51): "64656743 20202020 20202020 20202020",
}
TOY_ADDRESS: Final = 6


async def read_toy(address: int, slot: int, index: int) -> bytes:
    """The toy device at :data:`TOY_ADDRESS`; a LookupError for every other parameter."""
    if address != TOY_ADDRESS or (slot, index) not in TOY:
        raise LookupError(f"no parameter {slot}/{index} at {address}")
    return bytes.fromhex(TOY[slot, index])


def _read_function(name: str) -> Read:
    module, _, function = name.partition(":")
    found: Read = getattr(importlib.import_module(module), function)
    return found


def main() -> int:
    """Print what the program says, then what it asked for."""
    parser = argparse.ArgumentParser(prog="pa_walkers", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("program", choices=WALKERS)
    parser.add_argument("checkout", type=Path)
    parser.add_argument("address", type=int, nargs="?", default=TOY_ADDRESS)
    parser.add_argument("--read", type=_read_function, default=read_toy, metavar="MODULE:FUNCTION")
    parser.add_argument("--python", default=sys.executable, help="the interpreter that has the program's packages")
    given = parser.parse_args()
    done = asyncio.run(walk(given.program, given.checkout, given.read, given.address, given.python))
    print(done.text)
    print("asked:", *(f"{address}:{slot}/{index}" for address, slot, index in done.asked))
    print("refused:", *(f"{address}:{slot}/{index}" for address, slot, index in done.refused))
    return done.code


if __name__ == "__main__":
    sys.exit(main())
