"""Explained telegrams on the screen or as JSON lines, and the argument of ``--filter``."""

from __future__ import annotations

import argparse

from dpstack.cli.terminal import output
from dpstack.decode.filter import Match, parse_filter
from dpstack.decode.telegram import Explained
from dpstack.errors import UsageError
from dpstack.units import NS_PER_S


def filter_argument(text: str) -> Match:
    """The type of the argument EXPR of ``--filter``."""
    try:
        return parse_filter(text)
    except UsageError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def show(one: Explained, *, json: bool) -> None:
    """Print a transmission: its time and octets, the telegram in words, its fields."""
    if json:
        output.json_line(one.as_dict())
        return
    sent = one.transmission
    time = "" if sent.t_ns is None else f"{sent.t_ns // NS_PER_S}.{sent.t_ns % NS_PER_S:09}  "
    output.line(f"{one.number:>6}  {time}{sent.octets.hex(' ')}")
    output.line(f"        {one.text}")
    for name, value in one.fields.items():
        output.line(f"          {name}: {_plain(value)}")


def _plain(value: object) -> str:
    """A field's value in words."""
    match value:
        case bool():
            return "yes" if value else "no"
        case None:
            return "none"
        case list():
            return "; ".join(map(_plain, value)) or "none"
        case dict():
            return ", ".join(f"{key} {_plain(inner)}" for key, inner in value.items())
    return str(value) or "none"
