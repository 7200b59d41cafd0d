"""The FDL station of a command: it joins the ring on the port for as long as the command asks."""

from __future__ import annotations

import argparse
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from dpstack.api.commissioning.live_list import joined
from dpstack.api.config.config import make_config
from dpstack.api.fdl_station.station import FdlStation
from dpstack.cli import options
from dpstack.cli.commands import on_bus
from dpstack.cli.parser import Parser


def add_own_station(parser: Parser, when: str, rate: str, default: int | str) -> None:
    """``--baud`` (its text: ``rate``) and ``--address``; ``when`` the command joins the ring with its own station."""
    parser.value("--baud", "B|auto", when + rate, type=options.baud_or_auto, default=default)
    options.add_own_address(parser, when)


@asynccontextmanager
async def station_for(args: argparse.Namespace) -> AsyncIterator[FdlStation]:
    """A station without DP at ``args.address``, or at a free one, that asks ``args.station``. Raises PortError,
    BusError."""
    baud = await on_bus.rate_of(args)

    def make_station(address: int) -> FdlStation:
        config = make_config(args.port, baud, address, where=args.command)
        return FdlStation(config, on_event=on_bus.once(on_bus.teller(args)))

    async with joined(make_station, args.address, avoid=(args.station,)) as station:
        yield station
