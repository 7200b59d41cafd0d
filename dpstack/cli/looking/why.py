"""``dpstack why``: why a slave is not in data exchange."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

from dpstack.api.bus.bus import Bus, core_of
from dpstack.api.bus.why import untold
from dpstack.api.commissioning.live_list import joined
from dpstack.api.config.config import Config, load_config
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.control.remote import why_through_run
from dpstack.cli import options
from dpstack.cli.commands import on_bus
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.cli.terminal.causes import columns
from dpstack.cli.terminal.signals import run_to_result
from dpstack.errors import BusError
from dpstack.why.story import HEALTHY, Story, story_lines


def add_to(parser: Parser) -> None:
    parser.epilog = (
        "examples: dpstack why plant.toml valves\n"
        "          dpstack why plant.toml\n"
        "It asks through the run that holds the port, otherwise as a class 2 master beside the others. It never "
        "parameterises."
    )
    parser.value("config", "CONFIG", "configuration file")
    parser.value("slave", "NAME", "the slave, by its name or address there; left out: every slave", nargs="?")
    options.add_own_address(parser, "without a run: ")
    options.add_other_port(parser)
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 unless all slaves asked are healthy. Without NAME a healthy slave has one line."""
    config = load_config(args.config).with_bus(port=args.port, baud=args.baud)
    slaves = config.slaves if args.slave is None else (on_bus.slave_of(config, args.slave),)
    healthy = True
    for slave in slaves:
        story = run_to_result(_ask(config, slave, args.address), "the slave was asked")
        is_healthy = story["causes"][0]["cause"] == HEALTHY
        healthy = healthy and is_healthy
        if args.json:
            output.json_line(story)
            continue
        lines = story_lines(story, columns())
        for line in lines[:1] if is_healthy and args.slave is None else lines:
            output.line(line + (", healthy" if is_healthy and args.slave is None else ""))
    return 0 if healthy else 1


async def _ask(config: Config, slave: SlaveConfig, address: int | None) -> Mapping[str, Any]:
    story = await why_through_run(config, slave.address)
    if story is not None:
        return story
    return (await _ask_beside(config, slave, address)).as_dict()


async def _ask_beside(config: Config, slave: SlaveConfig, address: int | None) -> Story:
    """The story of a class 2 look at the bus, beside the other masters. If the ring cannot be joined, it says so.

    ``address``: of the asking station, None: the lowest one that is not heard and not in the configuration.
    """
    made: list[Bus] = []
    make_bus = on_bus.class2_maker(config, slaves=config.slaves)

    def kept(own: int) -> Bus:
        made.append(make_bus(own))
        return made[-1]

    try:
        async with joined(kept, address, avoid=on_bus.stations_of(config)) as bus:
            # the slaves of a configuration that is read only have another master, the PLC for instance
            return await bus.why(slave.address, master=None if config.bus.read_only else config.bus.address)
    except BusError as error:
        if not made or made[-1].searching:
            raise
        return untold(core_of(made[-1]), made[-1].slave(slave.address), config.bus.address, str(error))
