"""Options and argument types that several commands share."""

from __future__ import annotations

import argparse
import contextlib
import functools
import importlib.util
import math
from collections.abc import Callable
from typing import Final, TypeVar

from dpstack.cli.parser import Parser
from dpstack.errors import UsageError
from dpstack.text import decimal, shortened
from dpstack.units import AUTO, BAUD_RATES

_T = TypeVar("_T")
_N = TypeVar("_N", bound=float)


def add_other_port(parser: Parser) -> None:
    """``--port`` and ``--baud`` instead of those of the configuration."""
    parser.value("--port", "P", "another port")
    parser.value("--baud", "B|auto", 'another rate; "auto": listens', type=baud_or_auto)


def add_own_address(parser: Parser, when: str) -> None:
    """``--address``, ``when`` the command is a master of its own beside the others."""
    text = f"{when}ask from this address (default: the lowest not heard)"
    parser.value("--address", "A", text, type=address)


def require(module: str, what: str, extra: str) -> None:
    """Raises UsageError if the package ``module`` is not installed, which ``what`` needs and ``extra`` brings."""
    if importlib.util.find_spec(module) is None:
        raise UsageError(f"{what} needs {module}: pip install 'dpstack[{extra}]'")


def baud(text: str) -> int:
    try:
        value = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no baud rate in bit/s, for instance 500000") from None
    if value not in BAUD_RATES:
        near = min(BAUD_RATES, key=lambda rate: abs(rate - value))
        raise argparse.ArgumentTypeError(f"{value} is no PROFIBUS rate, nearest is {near}")
    return value


def baud_or(word: str) -> Callable[[str], int | str]:
    """The type of an argument: a baud rate, or ``word``."""
    return lambda text: text if text == word else baud(text)


baud_or_auto: Final = baud_or(AUTO)


def parsed(read: Callable[[str], _T]) -> Callable[[str], _T]:
    """The type of an argument that ``read`` reads, which raises UsageError."""

    def checked(text: str) -> _T:
        try:
            return read(text)
        except UsageError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return checked


def number(read: Callable[[str], _N | None], low: float, below: float, what: str) -> Callable[[str], _N]:
    """The type of an argument: ``low`` and more, less than ``below``. ``what``: what a refused text is not."""

    def checked(text: str) -> _N:
        with contextlib.suppress(ValueError):
            value = read(text)
            if value is not None and low <= value < below:
                return value
        raise argparse.ArgumentTypeError(f"{shortened(text)!r} is no {what}")

    return checked


_MORE_THAN_0: Final = math.ulp(0.0)
seconds = number(float, _MORE_THAN_0, 1e9, "number of seconds above 0")
milliseconds = number(float, _MORE_THAN_0, 1e9, "number of milliseconds above 0")
count = number(decimal, 1, math.inf, "whole number from 1 on")
whole = number(decimal, 0, math.inf, "whole number from 0 on")
jobs = number(decimal, 1, 65, "number of processes, 1..64")
address = number(decimal, 0, 126, "station address, 0..125")
#: 126 is the address of a slave as delivered
slave_address = number(decimal, 0, 127, "address of a slave, 0..126")
#: in hex, with or without 0x, as GSD files and scans show it
ident = number(functools.partial(int, base=16), 0, 0x10000, "ident number, for instance 0x0696")
