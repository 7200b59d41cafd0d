"""Two controllers exchange data over FDL, without DP: each sends blocks to the other and takes what comes (FDL send and
receive).

``python examples/fdl_controllers.py``: both controllers, simulated, in virtual time.

``python examples/fdl_controllers.py /dev/ttyUSB0 1 2``: station 1 on a bus, with station 2 as its partner: this
program on another computer (``... 2 1``), or a controller whose FDL connection has SAP 20 at both ends.
"""

import asyncio
import sys
from collections.abc import AsyncIterator

import dpstack
from dpstack.fdl import FdlError, FdlIndicated, FdlStation

SAP = 20
BAUD = 187_500


class Controller:
    """One end: ``send`` blocks of up to 244 octets, ``received`` yields those of the partner."""

    def __init__(self, fdl: FdlStation, partner: int) -> None:
        self.fdl = fdl
        self.partner = partner

    async def send(self, block: bytes) -> bool:
        """Whether the partner has taken the block. It may be busy (RR) or not there yet (NA, RS): try again."""
        for pause in (0.01, 0.05, 0.2, 1.0):
            try:
                await self.fdl.sda(self.partner, block, dsap=SAP, ssap=SAP)
            except FdlError as error:
                print(f"station {self.fdl.params.address}: {error}")
                if error.status not in ("RR", "NA", "RS", "LR"):
                    return False
                await asyncio.sleep(pause)
            else:
                return True
        return False

    async def received(self) -> AsyncIterator[FdlIndicated]:
        """The blocks of the partner; no other station, and no other SAP, may send any."""
        async with await self.fdl.sap(SAP, services=["sda"], access=self.partner, access_sap=SAP, queue=8) as sap:
            async for indication in sap.indications():
                yield indication


async def exchange(fdl: FdlStation, partner: int, blocks: int) -> None:
    """Send ``blocks`` blocks to the partner and take as many from it."""
    controller = Controller(fdl, partner)

    async def take() -> None:
        taken = 0
        async for indication in controller.received():
            print(f"station {fdl.params.address} has received {indication.data!r} from {indication.source}")
            taken += 1
            if taken == blocks:
                break

    taking = asyncio.create_task(take())
    for number in range(blocks):
        if not await controller.send(f"block {number}".encode()):
            print(f"station {partner} takes nothing")
    await taking


async def simulated(blocks: int = 3) -> None:
    world = dpstack.World()
    first = dpstack.open_fdl(world=world, baud=BAUD, address=1, hsa=5)
    second = dpstack.open_fdl(world=world, baud=BAUD, address=2, hsa=5)
    async with first, second:
        await asyncio.gather(exchange(first, 2, blocks), exchange(second, 1, blocks))


async def on_a_port(port: str, own: int, partner: int) -> None:
    async with dpstack.open_fdl(port=port, baud=BAUD, address=own, on_event=lambda event: print(event.text)) as fdl:
        await exchange(fdl, partner, 1_000_000)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        asyncio.run(on_a_port(sys.argv[1], int(sys.argv[2]), int(sys.argv[3])))
    else:
        dpstack.run_virtual(simulated())
