"""A rack of the simulated PA devices on one bus in virtual time, read over class 2 connections.

``read`` is for :mod:`pa_walkers`: programs of others read the rack through their gateway, for instance by
``PYTHONPATH=tests/kits python -m pa_walkers jannusch CHECKOUT 3 --read pa_rack:read``.
"""

from __future__ import annotations

import asyncio
import functools
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final

from dpstack.devices.pa.device import PaDevice
from dpstack.testing.bus import BusFactory, SimulatedBus, VirtualTime

#: address, device file. Not 7: the programs of others take it for a device of their laboratory
RACK: Final = {
    3: "pa-pressure",
    4: "pa-temperature",
    5: "pa-level",
    6: "pa-flow",
    8: "pa-positioner",
    9: "pa-valve",
}
#: Siemens: a program of others knows two makers only
SIEMENS: Final = 42


def slave(address: int, device: str, **simulated: object) -> dict[str, Any]:
    """The table of a simulated device with DP-V1."""
    table = {"name": device, "address": address, "device": device, "user_prm": "00 00 00", "dpv1": {}}
    return table | ({"simulated": simulated} if simulated else {})


class Rack:
    """The devices of :data:`RACK`; ``simulated``: options of each."""

    def __init__(self, **simulated: object) -> None:
        self.time = VirtualTime()
        slaves = [slave(address, name, **simulated) for address, name in RACK.items()]
        self.bus: SimulatedBus = BusFactory(self.time)(slaves=slaves)
        self._connections: dict[int, Any] = {}
        for address in RACK:
            self.device(address).model.physical.put("device_man_id", SIEMENS)

    def close(self) -> None:
        self.bus.close()
        self.time.close()

    def device(self, address: int) -> PaDevice:
        return self.bus.device(address).process

    def read(self, address: int, slot: int, index: int) -> bytes:
        """A parameter over the device's connection of class 2. Raises the refusal."""
        if address not in RACK:
            raise LookupError(f"nobody at {address}")
        octets: bytes = self.bus.run(self._read(address, slot, index))
        return octets

    async def _read(self, address: int, slot: int, index: int) -> bytes:
        if address not in self._connections:
            self._connections[address] = await self.bus.master.class2.connect(address)
        octets: bytes = await self._connections[address].read(slot, index)
        return octets


#: the virtual time of the rack has a thread of its own: it runs while the program's loop waits
_THREAD: Final = ThreadPoolExecutor(1)


@functools.cache
def _rack() -> Rack:
    return Rack(records="one")


def _read(address: int, slot: int, index: int) -> bytes:
    return _rack().read(address, slot, index)


async def read(address: int, slot: int, index: int) -> bytes:
    """A parameter of the rack whose directories have one record, which all programs read."""
    return await asyncio.get_running_loop().run_in_executor(_THREAD, _read, address, slot, index)
