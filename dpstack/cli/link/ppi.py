"""``dpstack ppi``: values, mode and clock of an S7-200."""

from __future__ import annotations

import argparse
import datetime
import functools
import shlex
from collections.abc import Awaitable, Callable
from typing import Final

from dpstack.api.ppi.cpu import Cpu
from dpstack.cli import options
from dpstack.cli.commands import on_bus
from dpstack.cli.link.station import add_own_station, station_for
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.cli.terminal.signals import run_to_result
from dpstack.errors import PortBusyError, SlaveTimeout, UsageError
from dpstack.ppi.addresses import PpiAddress, PpiValue, parse_address
from dpstack.text import brief, decimal
from dpstack.units import baud_text

_ACTIONS: Final = ("read", "write", "run", "stop", "clock", "set-time")
#: actions that the plant notices
_ACTING: Final = ("write", "run", "stop", "set-time")
_station: Final = options.number(decimal, 0, 126, "station address, 0..125")


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
    parser.value("action", "ACTION", "read, write, run, stop, clock or set-time", choices=_ACTIONS)
    parser.value("words", "WORD", "of the action", nargs="*", default=[])
    parser.flag("--yes", "write, run, stop and set-time act on the plant: it is meant")
    rate = "the rate (default 9600, as delivered; 19200 and 187500 are the others of an S7-200)"
    add_own_station(parser, "", rate, 9600)
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 if the CPU refuses or does not answer."""
    on_bus.check_port(args)
    act = _act_of(args)
    if args.action in _ACTING and not args.yes:
        raise UsageError(f"{args.action} acts on the plant of CPU {args.station}: add --yes if that is meant")

    lines = run_to_result(_carry_out(args, act), f"{args.action} was done")
    for line in lines:
        if args.json:
            output.json_line({"address": args.station, "action": args.action, **line})
        else:
            output.line(str(line["text"]))
    return 0


Act = Callable[[Cpu], Awaitable[list[dict[str, object]]]]


def _act_of(args: argparse.Namespace) -> Act:
    """The coroutine function of the action, its words checked before the port is opened. Raises UsageError."""
    words: list[str] = args.words
    match args.action:
        case "read":
            if not words:
                raise UsageError("read needs addresses, for instance: read VW100 M0.3")
            return functools.partial(_read, addresses=[parse_address(word) for word in words])
        case "write":
            if len(words) != 2:
                raise UsageError("write needs an address and a value, for instance: write VW100 250")
            address = parse_address(words[0])
            return functools.partial(_write, address=address, value=_value(address, words[1]))
        case "set-time":
            if len(words) > 1:
                raise UsageError("set-time takes one time, for instance 2026-11-28T12:00")
            return functools.partial(_set_clock, text=words[0] if words else None)
    if words:
        raise UsageError(f"{args.action} takes no {brief(words[0])}: leave it out")
    return {"run": _run, "stop": _stop, "clock": _clock}[args.action]


def _value(address: PpiAddress, text: str) -> PpiValue:
    """The value that ``text`` means at ``address``. Raises UsageError."""
    value: PpiValue
    try:
        if address.size == 1:
            value = {"1": True, "true": True, "on": True, "0": False, "false": False, "off": False}[text.lower()]
        elif not address.code:
            value = bytes.fromhex(text)
        else:
            value = float(text) if address.code == "f" else int(text, 0)
    except (KeyError, ValueError):
        wanted = "0 or 1" if address.size == 1 else "octets in hex" if not address.code else "a number"
        raise UsageError(f"{address.text}: {brief(text)} is no value; {wanted} is wanted") from None
    address.octets(value)
    return value


async def _carry_out(args: argparse.Namespace, act: Act) -> list[dict[str, object]]:
    try:
        async with station_for(args) as station:
            return await act(Cpu(station, args.station))
    except PortBusyError as error:
        if "`dpstack run " not in str(error):
            raise
        ctl = f"dpstack ctl {shlex.quote(args.port)}"
        how = f"`{ctl} status` shows the values of its plant file, `{ctl} set CPU.NAME=VALUE` writes one"
        raise PortBusyError(f"{error}; or let that run ask: {how}") from None
    except SlaveTimeout as error:
        used = "" if args.baud == "auto" else f" (asked at {baud_text(args.baud)}: --baud)"
        raise SlaveTimeout(args.station, f"{error}{used}") from None


async def _read(cpu: Cpu, addresses: list[PpiAddress]) -> list[dict[str, object]]:
    values = await cpu.read_all([address.text for address in addresses])
    return [_shown(address, value) for address, value in zip(addresses, values, strict=True)]


def _shown(address: PpiAddress, value: PpiValue) -> dict[str, object]:
    if isinstance(value, bytes):
        return {"name": address.text, "value": value.hex(), "text": f"{address.text}: {value.hex(' ').upper()}"}
    text = str(int(value)) if isinstance(value, bool) else f"{value:g}" if isinstance(value, float) else str(value)
    return {"name": address.text, "value": value, "text": f"{address.text}: {text}"}


async def _write(cpu: Cpu, address: PpiAddress, value: PpiValue) -> list[dict[str, object]]:
    await cpu.write(address.text, value)
    return [_shown(address, value) | {"text": f"{_shown(address, value)['text']}, written"}]


async def _run(cpu: Cpu) -> list[dict[str, object]]:
    await cpu.run()
    return [{"text": f"CPU {cpu.address} is in RUN"}]


async def _stop(cpu: Cpu) -> list[dict[str, object]]:
    await cpu.stop()
    return [{"text": f"CPU {cpu.address} is in STOP"}]


async def _clock(cpu: Cpu) -> list[dict[str, object]]:
    time = await cpu.clock()
    return [{"time": time.isoformat(), "text": f"CPU {cpu.address}: {time:%Y-%m-%d %H:%M:%S}"}]


async def _set_clock(cpu: Cpu, text: str | None) -> list[dict[str, object]]:
    try:
        time = datetime.datetime.now().astimezone() if text is None else datetime.datetime.fromisoformat(text)
    except ValueError:
        raise UsageError(f"{brief(text)} is no time; for instance 2026-11-28T12:00") from None
    await cpu.set_clock(time)
    return [{"time": time.isoformat(), "text": f"CPU {cpu.address}: set to {time:%Y-%m-%d %H:%M:%S}"}]
