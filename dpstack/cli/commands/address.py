"""``dpstack address``: gives a slave another station address."""

from __future__ import annotations

import argparse

from dpstack.api.commissioning.live_list import joined
from dpstack.cli import options
from dpstack.cli.commands import on_bus
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.cli.terminal.signals import run_to_result


def add_to(parser: Parser) -> None:
    parser.epilog = "example: dpstack address 126 5 --ident 0x0696 --port /dev/ttyUSB0 --baud 500000"
    parser.value("old", "OLD", "its address, 126 as delivered", type=options.slave_address)
    parser.value("new", "NEW", "its new address, 0..125", type=options.address)
    parser.value("--ident", "I", "only the device with this ident number", type=options.ident)
    parser.flag("--no-change", "for good: it shall refuse any further change of its address")
    on_bus.add_port(parser)
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 when the slave does not have the new address afterwards."""
    on_bus.check_port(args)
    ident = run_to_result(
        _change(args), f"the address was changed and verified: look for the slave at {args.old} and {args.new}"
    )
    if args.json:
        output.json_line({"old": args.old, "new": args.new, "ident": f"0x{ident:04X}", "no_change": args.no_change})
    else:
        output.line(f"slave {args.old} has address {args.new} now: ident 0x{ident:04X}, verified there")
    return 0


async def _change(args: argparse.Namespace) -> int:
    """Give the slave its new address. Returns its ident number."""
    make_bus = on_bus.bus_maker(args, await on_bus.rate_of(args))
    async with joined(make_bus, args.address, avoid=(args.old, args.new)) as bus:
        found = await bus.class2.set_address(args.old, args.new, ident=args.ident, no_change=args.no_change)
        return found.ident
