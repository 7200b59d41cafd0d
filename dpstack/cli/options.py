"""Arguments that several commands share, and their checks."""

from __future__ import annotations

import argparse
import math
from typing import TYPE_CHECKING

from dpstack.api.config.bus import AUTO
from dpstack.text import decimal, shortened
from dpstack.units import BAUD_RATES

if TYPE_CHECKING:
    Commands = argparse._SubParsersAction[argparse.ArgumentParser]


def command(commands: Commands, name: str, text: str, example: str) -> argparse.ArgumentParser:
    """A command with its description and, in its help, an example."""
    return commands.add_parser(
        name,
        help=text,
        description=text,
        epilog=f"example: {example}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def add_json(parser: argparse.ArgumentParser) -> None:
    """``--json``."""
    parser.add_argument("--json", action="store_true", help="print JSON lines")


def baud(text: str) -> int:
    """A rate of PROFIBUS in bit/s."""
    try:
        value = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no baud rate in bit/s, for instance 500000") from None
    if value not in BAUD_RATES:
        near = min(BAUD_RATES, key=lambda rate: abs(rate - value))
        raise argparse.ArgumentTypeError(f"{value} is no PROFIBUS rate, nearest is {near}")
    return value


def baud_or_auto(text: str) -> int | str:
    """As :func:`baud`, or "auto"."""
    return text if text == AUTO else baud(text)


def seconds(text: str) -> float:
    """A time in seconds, more than 0."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < 1e9:
        raise argparse.ArgumentTypeError(f"{text!r} is no number of seconds above 0")
    return value


def milliseconds(text: str) -> float:
    """A time in milliseconds, more than 0."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < 1e9:
        raise argparse.ArgumentTypeError(f"{text!r} is no number of milliseconds above 0")
    return value


def count(text: str) -> int:
    """A whole number from 1 on."""
    value = decimal(text)
    if not value:
        raise argparse.ArgumentTypeError(f"{shortened(text)!r} is no whole number from 1 on")
    return value


def whole(text: str) -> int:
    """A whole number from 0 on."""
    value = decimal(text)
    if value is None:
        raise argparse.ArgumentTypeError(f"{shortened(text)!r} is no whole number from 0 on")
    return value


def address(text: str) -> int:
    """A station address."""
    value = decimal(text)
    if value is None or value > 125:
        raise argparse.ArgumentTypeError(f"{shortened(text)!r} is no station address, 0..125")
    return value


def slave_address(text: str) -> int:
    """The address of a slave, 126 as delivered included."""
    value = decimal(text)
    if value is None or value > 126:
        raise argparse.ArgumentTypeError(f"{shortened(text)!r} is no address of a slave, 0..126")
    return value


def ident(text: str) -> int:
    """An ident number, in hex with or without 0x as GSD files and scans show it."""
    try:
        value = int(text, 16)
    except ValueError:
        value = -1
    if not 0 <= value <= 0xFFFF:
        raise argparse.ArgumentTypeError(f"{text!r} is no ident number, for instance 0x0696")
    return value
