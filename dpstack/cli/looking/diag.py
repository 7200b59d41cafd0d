"""``dpstack diag``: diagnosis, configuration, inputs and outputs of any station, in words."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from dpstack.api.commissioning.live_list import joined
from dpstack.api.config.config import Config, load_config
from dpstack.api.control.remote import reading_through_run
from dpstack.api.slave.station_report import KnownDevices, StationReading, read_station, station_report
from dpstack.cli import options
from dpstack.cli.commands import on_bus
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.cli.terminal.signals import run_to_result
from dpstack.errors import UsageError
from dpstack.text import octets_text

#: octets in one line, so that the line has fewer than 60 characters
_IN_A_LINE = 16


def add_to(parser: Parser) -> None:
    parser.epilog = (
        "examples: dpstack diag plant.toml valves\n"
        "          dpstack diag plant.toml 8 --gsd plant/gsd\n"
        "          dpstack diag --port /dev/ttyUSB0 --baud 500000 8"
    )
    parser.value(
        "where", "CONFIG ADDRESS", "the configuration file (not needed with --port), and the station", nargs="+"
    )
    options.add_other_port(parser)
    parser.value("--gsd", "DIR", "folder of GSD files: models, modules and texts by ident number")
    options.add_own_address(parser, "without a run: ")
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 if there is a finding, or no answer."""
    config, station = _target(args)
    slave = None if config is None else config.find(station)
    address = slave.address if slave is not None else station_address(station, config)
    devices = KnownDevices(() if config is None else config.slaves, args.gsd, output.warn)
    reading = run_to_result(_Request(args, config, address).read(), "the station was read")
    report = station_report(reading, slave, devices)
    if args.json:
        output.json_line(report)
    else:
        for line in report_lines(report):
            output.line(line)
    return 0 if report["healthy"] else 1


def _target(args: argparse.Namespace) -> tuple[Config | None, str]:
    """The configuration, None with ``--port`` alone, and the station as typed. Raises UsageError, ConfigError."""
    if len(args.where) > 2 or (len(args.where) == 1 and args.port is None):
        raise UsageError("diag takes CONFIG ADDRESS, or --port P ADDRESS; for instance: dpstack diag plant.toml 8")
    station = args.where[-1]
    if len(args.where) == 2:
        return load_config(args.where[0]).with_bus(port=args.port, baud=args.baud), station
    return None, station


def station_address(station: str, config: Config | None) -> int:
    """The address of a station that no slave of ``config`` is. Raises UsageError."""
    try:
        return options.slave_address(station)
    except argparse.ArgumentTypeError:
        names = "" if config is None else ", ".join(f"{one.name} ({one.address})" for one in config.slaves)
        known = f"; the configuration has {names}" if names else ""
        raise UsageError(f"{station!r} is no station: give its address, 0..126{known}") from None


class _Request(NamedTuple):
    """The reading of the station ``address``. ``config``: None if only the port is known."""

    args: argparse.Namespace
    config: Config | None
    address: int

    async def read(self) -> StationReading:
        """Through the run that holds the port, else as master of class 2 beside all others."""
        port = self.args.port if self.config is None else self.config.port
        reading = await reading_through_run(port, self.config, str(self.address))
        if reading is not None:
            return reading
        args, config, avoid = self.args, self.config, {self.address}
        if config is None:
            on_bus.check_port(args)
            if args.baud is None:
                args.baud = "auto"
            baud = await on_bus.rate_of(args)
            make_bus = on_bus.bus_maker(args, baud, read_only=True)
        else:
            make_bus = on_bus.class2_maker(config)
            avoid |= on_bus.stations_of(config)
        async with joined(make_bus, args.address, avoid=avoid) as bus:
            return await read_station(bus.class2, self.address, bus.params.address, "class2", bus.snapshot.las)


# --- lines for people -------------------------------------------------------------------------------------------------


def report_lines(report: Mapping[str, Any]) -> Iterator[str]:
    """The report as lines for people."""
    who = (
        f"station {report['address']}" if report["slave"] is None else f"slave {report['address']} ({report['slave']})"
    )
    asked = f"asked by the run, master {report['own']}" if report["source"] == "run" else f"asked by {report['own']}"
    yield f"{who}, {asked}"
    if report["ident"] is not None:
        device = " ".join(filter(None, (report["vendor"], report["model"]))) or "unknown device"
        yield f"  {device}, ident {report['ident']}"
        master = "no master" if report["master"] is None else f"master {report['master']}"
        yield f"  {report['state']}, {master}"
    diagnosis = report["diagnosis"]
    if diagnosis is not None:
        yield f"diagnosis: {', '.join(diagnosis['flags']) or 'no flag is set'}"
        for text in diagnosis["texts"]:
            yield f"  {text}"
    if report["config"] is not None:
        yield from _config_lines(report["config"])
    for key in ("inputs", "outputs"):
        if report[key] is not None:
            yield from _data_lines(key, report[key])
    for text in report["errors"].values() if report["diagnosis"] is not None else ():
        yield f"not read: {text}"
    if report["healthy"]:
        yield "healthy: in data exchange, nothing reported"
    for text in report["findings"]:
        yield f"finding: {text}"


def _config_lines(config: Mapping[str, Any]) -> Iterator[str]:
    if config["finding"] is not None:
        yield f"configuration: {_hex(config['octets'])}, which cannot be read: {config['finding']}"
        return
    yield f"configuration: {octets_text(config['input_len'])} of inputs, {octets_text(config['output_len'])} of outputs"
    for module in config["modules"]:
        yield f"  {module['text']} ({_hex(module['config'])})"


def _data_lines(key: str, data: Mapping[str, Any]) -> Iterator[str]:
    octets = bytes.fromhex(data["octets"])
    yield f"{key}: {octets_text(len(octets))}"
    for at in range(0, len(octets), _IN_A_LINE):
        yield f"  {at:3}  {octets[at : at + _IN_A_LINE].hex(' ').upper()}"
    for name, value in data["fields"].items():
        quality = data["qualities"].get(name)
        said = "" if quality is None else f"  {quality['quality']}: {quality['text']}"
        yield f"  {name} = {value}{data['units'].get(name, '') and ' '}{data['units'].get(name, '')}{said}"


def _hex(octets: str) -> str:
    return bytes.fromhex(octets).hex(" ").upper()
