"""``dpstack fdl``: one FDL service by hand, through the run that holds the port or as a master station without DP."""

from __future__ import annotations

import argparse
import functools
from typing import Final

from dpstack.api.control.remote import fdl_through_run
from dpstack.api.fdl.orders import ALL, LAST_SAP, SENDING, SERVICES, FdlOrder, carry_out
from dpstack.cli import options
from dpstack.cli.commands import on_bus
from dpstack.cli.link.station import add_own_station, station_for
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.cli.terminal.signals import run_to_result
from dpstack.errors import FdlError, UsageError
from dpstack.text import decimal, shortened
from dpstack.units import AUTO

_DP_SAPS: Final = range(48, 64)


_station: Final = options.number(decimal, 0, ALL + 1, "station address, 0..126, or 127 for all")
_sap: Final = options.number(functools.partial(int, base=0), 0, LAST_SAP + 1, "SAP, 0..63 or 0x00..0x3F")


def _octets(text: str) -> bytes:
    try:
        return bytes.fromhex(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{shortened(text)!r} is no hex: write 01FF or '01 FF'") from None


def add_to(parser: Parser) -> None:
    parser.epilog = (
        "example: dpstack fdl /dev/ttyUSB0 status 5 --baud 187500\n"
        "         dpstack fdl /dev/ttyUSB0 srd 5 0102 --dsap 20 --ssap 20\n"
        "         dpstack fdl /dev/ttyUSB0 sdn 127 FF --dsap 20 --yes\n\nservices:\n"
        "  sda    HEX    data with acknowledgement\n"
        "  sdn    HEX    data without acknowledgement; ADDRESS 127: to all\n"
        "  srd    [HEX]  data, and the station's reply data\n"
        "  msrd   [HEX]  as srd; the station sends its reply to all (DP-V2)\n"
        "  status        the type of the station\n"
        "  ident         vendor, controller, hardware and software of the station\n"
        "  lsap          the configuration of its SAP --dsap"
    )
    parser.value("port", "PORT", "the port")
    parser.value("service", "SERVICE", "sda, sdn, srd, msrd, status, ident or lsap", choices=SERVICES)
    parser.value("station", "ADDRESS", "the station, 0..126; 127: all (sdn)", type=_station)
    parser.value("data", "HEX", "the data of the request", nargs="?", type=_octets, default=b"")
    parser.value("--dsap", "N", "the SAP of the station (default: its default SAP)", type=_sap)
    parser.value("--ssap", "N", "the SAP that it is sent from (default: the default SAP)", type=_sap)
    parser.flag("--high", "high priority")
    parser.flag("--yes", "send it to SAPs of DP (48 to 62), or to all stations: slaves may act on it")
    add_own_station(parser, "without a run: ", on_bus.RATE, AUTO)
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 for a confirmation that is not positive."""
    order = FdlOrder(args.service, args.station, args.data, args.dsap, args.ssap, args.high)
    if not args.yes:
        _refuse_acting(order)
    try:
        line = run_to_result(_carry_out(args, order), f"{args.service} was done")
    except FdlError as error:
        if not args.json:
            raise
        output.json_line({**order.as_dict(), "status": error.status, "data": error.data.hex(), "text": str(error)})
        return 1
    if args.json:
        output.json_line({**order.as_dict(), **line})
    else:
        output.line(str(line["text"]))
    return 0


def _refuse_acting(order: FdlOrder) -> None:
    """Raises UsageError for a request that slaves act on."""
    if order.service not in SENDING:
        return
    if order.address == ALL:
        raise UsageError("address 127 is all stations, and slaves act on such telegrams: add --yes if that is meant")
    for name, sap in (("--dsap", order.dsap), ("--ssap", order.ssap)):
        if sap in _DP_SAPS:
            raise UsageError(f"{name} {sap}: DP parameterises and commands slaves by it: add --yes if that is meant")


async def _carry_out(args: argparse.Namespace, order: FdlOrder) -> dict[str, object]:
    """By the station of the run that holds the port, beside its DP master; else by one of the command."""
    answer = await fdl_through_run(args.port, order.words)
    if answer is not None:
        return {**answer, "through": "run"}
    on_bus.check_port(args)
    async with station_for(args) as station:
        return {**await carry_out(station, order), "through": "station"}
