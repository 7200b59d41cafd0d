"""``dpstack hart``: a HART transmitter behind remote I/O."""

from __future__ import annotations

import argparse
from typing import Final

from dpstack.api.config.config import load_config
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.control.record_orders import ALL_CHANNELS, FORMATS, parse_order
from dpstack.cli.commands import on_bus
from dpstack.cli.commands.acyclic import RecordOrder, add_master_options, master_of, show_hart
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.errors import ConfigError, UsageError
from dpstack.gsd.identifiers import parse_identifiers

_COMMAND: Final = "command"


def add_to(parser: Parser) -> None:
    parser.epilog = (
        "examples: dpstack hart plant.toml io\n"
        "          dpstack hart plant.toml io 0\n"
        "          dpstack hart plant.toml io 0 --class 2\n"
        "          dpstack hart plant.toml io 0 command 3\n"
        "          dpstack hart plant.toml io 0 command 35 07 41200000 00000000 --slot 2\n"
        "Without a command: tag, variables with units, range, status, identity (commands 0, 3, 13, 15, 20, 48)."
    )
    parser.value("config", "CONFIG", "configuration file")
    parser.value("slave", "NAME", "the slave, by its name or address there")
    parser.value("channel", "CHANNEL", "channel of the module, from 0; left out: all", nargs="?", default=ALL_CHANNELS)
    parser.value("order", "ORDER", "command N [HEX]: one HART command, with its data in hex", nargs="*", default=[])
    parser.value("--slot", "S", "the module; left out: the only one with HART channels")
    parser.flag("--compact", "requests in compact format")
    add_master_options(parser)
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 if the transmitter, its module or the slave does not answer or refuses."""
    config = load_config(args.config).with_bus(port=args.port, baud=args.baud)
    slave = on_bus.slave_of(config, args.slave)
    master = master_of(args, slave)
    word, *rest = args.order or [_COMMAND]
    if word != _COMMAND or (args.order and not rest):
        raise UsageError("behind CHANNEL write command N [HEX], for instance: command 3; or nothing, to read all")
    texts = [args.slot or _slots_of(slave), args.channel, FORMATS[args.compact], *rest[:1]]
    if len(rest) > 1:
        texts.append("".join(rest[1:]))
    order = parse_order("hart", texts, class2=master == 2, who="dpstack hart")
    answer = RecordOrder(config, slave, order, "hart", master, args.address).answer()
    if args.json:
        output.json_line(answer)
    else:
        show_hart(answer)
    return 0


def _slots_of(slave: SlaveConfig) -> str:
    """The slots of its configuration: ``1-4``."""
    try:
        count = len(parse_identifiers(slave.params.config))
    except ConfigError:
        count = 1
    return f"1-{max(count, 1)}"
