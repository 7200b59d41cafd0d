"""``open_ppi``: an S7-200, and the station of its own that asks it."""

from __future__ import annotations

from typing import Any

from dpstack.api.fdl_station.station import FdlStation, open_fdl
from dpstack.api.ppi.cpu import USUAL_S, Cpu


class CpuConnection(Cpu):
    """One S7-200, and the station of its own that asks it. Made by :func:`open_ppi`."""

    def __init__(self, station: FdlStation, address: int, *, timeout: float) -> None:
        super().__init__(station, address, timeout=timeout)
        self._station = station
        self._seal(CpuConnection)

    async def __aenter__(self) -> CpuConnection:
        await self.open()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def open(self) -> None:
        """Join the token ring, or make it on a silent line. Raises PortError, BusError."""
        await self._station.open()

    async def close(self) -> None:
        """Leave the ring in order and release the port. May be repeated."""
        await self._station.close()

    @property
    def station(self) -> FdlStation:
        """The station that asks: its ring, its live list, its events."""
        return self._station


def open_ppi(
    address: int = 2, *, own: int = 0, baud: int = 9600, timeout: float = USUAL_S, **fdl: Any
) -> CpuConnection:
    """The S7-200 at ``address``, asked by a station of its own: ``async with open_ppi(2, port="/dev/ttyUSB0") as cpu``.

    ``own``: address of this station, 0 as Siemens' tools have it; ``baud``: 9600 as delivered, 19200 or 187500.
    ``fdl``: other arguments of :func:`dpstack.open_fdl`. With other masters on the wire (PPI advanced) the station
    joins their token ring. Raises ConfigError and UsageError here; PortError and BusError on entering.
    """
    return CpuConnection(open_fdl(address=own, baud=baud, **fdl), address, timeout=timeout)
