"""The UDP gateway for programs of others: requests and answers as octets; and what the programs need of a device."""

from __future__ import annotations

import asyncio
import socket

from pa_gateway import LOCALHOST, gateway
from pa_walkers import TOY, TOY_ADDRESS, WALKERS, read_toy


async def ask(port: int, *requests: str) -> list[str]:
    """Sends all at once, as octets in hex; the answers in their order."""
    loop = asyncio.get_running_loop()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.setblocking(False)
        await loop.sock_connect(line, (LOCALHOST, port))
        for request in requests:
            await loop.sock_sendall(line, bytes.fromhex(request))
        return [(await loop.sock_recv(line, 1024)).hex() for request in requests if len(request) == 8]


async def test_parameters_and_refusals() -> None:
    async with gateway(read_toy) as served:
        answers = await ask(served.port, "01060100", "ff06001a", "2a060063", "00050100")
        assert answers == ["01000000010001000600010003", "ff002a", "2a", "00"]
        assert served.asked == [(6, 1, 0), (6, 0, 26), (6, 0, 99), (5, 1, 0)]
        assert served.refused == {
            (6, 0, 99): "LookupError: no parameter 0/99 at 6",
            (5, 1, 0): "LookupError: no parameter 1/0 at 5",
        }


async def test_other_lengths_get_no_answer() -> None:
    async with gateway(read_toy) as served:
        assert await ask(served.port, "", "010601", "0106010000", "07060022") == ["070999"]
        assert served.asked == [(6, 0, 34)]


async def test_one_read_at_a_time() -> None:
    under_way = most = 0

    async def read(address: int, slot: int, index: int) -> bytes:
        nonlocal under_way, most
        under_way += 1
        most = max(most, under_way)
        await asyncio.sleep(0)
        under_way -= 1
        return bytes((address, slot, index))

    async with gateway(read) as served:
        assert await ask(served.port, "01010203", "02040506", "03070809") == ["01010203", "02040506", "03070809"]
    assert most == 1


async def test_close_with_a_read_under_way() -> None:
    begun = asyncio.Event()

    async def read(address: int, slot: int, index: int) -> bytes:
        begun.set()
        await asyncio.Event().wait()
        return b""

    async with gateway(read) as served:
        asking = asyncio.ensure_future(ask(served.port, "01060100"))
        await begun.wait()
    asking.cancel()
    await asyncio.gather(asking, return_exceptions=True)


async def test_the_toy_is_a_device_that_all_of_them_read() -> None:
    """The directory has one record of entries, block objects have 20 octets, each driver is valid Python."""
    header = await read_toy(TOY_ADDRESS, 1, 0)
    entries = await read_toy(TOY_ADDRESS, 1, 1)
    assert int.from_bytes(header[6:8], "big") * 4 == len(entries)
    for at in range(12, len(entries), 4):
        block = await read_toy(TOY_ADDRESS, entries[at], entries[at + 1])
        assert len(block) == 20
        assert block[15:17] == entries[at + 2 : at + 4]
    assert {len(bytes.fromhex(octets)) for (slot, index), octets in TOY.items() if index == 27} == {16}
    for name, walker in WALKERS.items():
        compile(walker.driver, name, "exec")
