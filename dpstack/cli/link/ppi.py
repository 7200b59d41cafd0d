"""``dpstack ppi``: values, mode and clock of a CPU, through the run that holds the port or as a station without DP."""

from __future__ import annotations

import argparse
from typing import Final

from dpstack.api.control.remote import ppi_through_run
from dpstack.api.ppi.cpu import Cpu
from dpstack.api.ppi.orders import ACTING, ACTIONS, LAST_CPU, Line, PpiOrder, carry_out, ppi_order
from dpstack.cli import options
from dpstack.cli.commands import on_bus
from dpstack.cli.link.station import add_own_station, station_for
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.cli.terminal.signals import run_to_result
from dpstack.errors import SlaveTimeout, UsageError
from dpstack.text import decimal
from dpstack.units import baud_text

_station: Final = options.number(decimal, 0, LAST_CPU + 1, "station address, 0..125")


def add_to(parser: Parser) -> None:
    parser.epilog = (
        "example: dpstack ppi /dev/ttyUSB0 2 read VW100 VD8:real M0.3 T37\n"
        "         dpstack ppi /dev/ttyUSB0 2 write VW100 250 --yes\n"
        "         dpstack ppi /dev/ttyUSB0 2 stop --yes\n\nactions:\n"
        "  read ADDRESS...       values; VW100:int and VD8:real name another type, VB0[16] octets\n"
        "  write ADDRESS VALUE   a value; octets in hex\n"
        "  run, stop             the mode of the CPU\n"
        "  clock                 its clock\n"
        "  set-time [TIME]       set it, for instance 2026-11-28T12:00; without TIME to this computer's local time"
    )
    parser.value("port", "PORT", "the port")
    parser.value("station", "ADDRESS", "the CPU, 0..125; 2 as delivered", type=_station)
    parser.value("action", "ACTION", "read, write, run, stop, clock or set-time", choices=ACTIONS)
    parser.value("words", "WORD", "of the action", nargs="*", default=[])
    parser.flag("--yes", "write, run, stop and set-time act on the plant: it is meant")
    rate = "the rate (default 9600, as delivered; 19200 and 187500 are the others of an S7-200)"
    add_own_station(parser, "without a run: ", rate, 9600)
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 if the CPU refuses or does not answer."""
    order = ppi_order(args.action, args.station, args.words)
    if order.action in ACTING and not args.yes:
        raise UsageError(f"{order.action} acts on the plant of CPU {order.address}: add --yes if that is meant")
    through, lines = run_to_result(_carry_out(args, order), f"{order.action} was done")
    for line in lines:
        if args.json:
            output.json_line({"address": order.address, "action": order.action, **line, "through": through})
        else:
            output.line(str(line["text"]))
    return 0


async def _carry_out(args: argparse.Namespace, order: PpiOrder) -> tuple[str, list[Line]]:
    """By the station of the run that holds the port, beside its DP master; else by one of the command."""
    lines = await ppi_through_run(args.port, order.control_words)
    if lines is not None:
        return "run", lines
    on_bus.check_port(args)
    try:
        async with station_for(args) as station:
            return "station", await carry_out(Cpu(station, args.station), order)
    except SlaveTimeout as error:
        used = "" if args.baud == "auto" else f" (asked at {baud_text(args.baud)}: --baud)"
        raise SlaveTimeout(args.station, f"{error}{used}") from None
