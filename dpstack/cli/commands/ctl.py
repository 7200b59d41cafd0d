"""``dpstack ctl``: gives orders to a running program."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any, Final

from dpstack.api.control.client import connect
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.errors import UsageError

#: commands that are streams of items without end, and the command for people instead
_ENDLESS: Final = {
    "tap": "to see the telegrams: dpstack capture --port {port}",
    "live": "to see the plant: dpstack web CONFIG",
}
#: longest line (characters) in which an entry is shown whole
_LINE: Final = 130
_GOOD: Final = "good"
#: keys of the quality of a value: those of :class:`dpstack.plant.items.QualityValues`, which is slow to load
_QUALITY: Final = frozenset({"quality", "reason", "text", "since", "remedy"})


def add_to(parser: Parser) -> None:
    parser.epilog = "example: dpstack ctl /tmp/bus/0 trip 3 F2100\n         dpstack ctl /tmp/bus noise 1e-4"
    parser.value(
        "port",
        "PORT",
        "the port of run or sim, the directory of segment, or virtual (of several runs there: virtual:PID)",
    )
    parser.value("order", "COMMAND", "what to do", nargs="?", default="help")
    parser.value("args", "ARG", "its arguments", nargs="*", default=[])
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    if args.order in _ENDLESS:
        instead = _ENDLESS[args.order].format(port=args.port)
        raise UsageError(f"{args.order} goes on without end and is for programs; {instead}")
    with connect(args.port) as client:
        result = client.help() if args.order == "help" and not args.args else client.call(args.order, *args.args)
    if args.json:
        output.json_line({"result": result})
    elif args.order == "help":
        output.line(f"{result['kind']} on {result.get('name', result['port'])} (pid {result['pid']})", "bold")
        if result.get("config"):
            output.line(f"configuration: {result['config']}")
        rows = [(f"{one['command']} {one['args']}".rstrip(), one["text"]) for one in result["commands"]]
        output.table("", ("command", "does"), rows)
    else:
        _show(result)
    return 0


def _show(result: Any, indent: str = "") -> None:
    """Print nested data as indented lines; None is printed as ``ok``."""
    if result is None:
        output.line("ok")
        return
    if not isinstance(result, Mapping):
        output.line(f"{indent}{result}")
        return
    for key, value in result.items():
        if key == "masters" and isinstance(value, list):
            own = result.get("address")
            value = ", ".join(f"station {one}{' (this one)' if one == own else ''}" for one in value)
        if key == "fields" and isinstance(value, Mapping):
            value = _with_qualities(value, result.get("qualities"))
        if isinstance(value, Mapping) and value.keys() == _QUALITY:
            # of a good value it is the time of its octets
            lasts = value["since"] is not None and value["quality"] != _GOOD
            since = f" (since {value['since']} s)" if lasts else ""
            remedy = f"; {value['remedy']}" if value["remedy"] else ""
            output.line(f"{indent}{key}: {value['quality']}: {value['text']}{since}{remedy}")
        elif isinstance(value, Mapping) and value:
            line = _line(value)
            if line is not None and len(indent) + len(str(key)) + len(line) <= _LINE:
                output.line(f"{indent}{key}: {line}")
                continue
            output.line(f"{indent}{key}:")
            _show(value, indent + "  ")
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            for number, entry in enumerate(value):
                output.line(f"{indent}{key} {number}:")
                _show(entry, indent + "  ")
        else:
            output.line(f"{indent}{key}: {_text(value)}")


def _with_qualities(fields: Mapping[str, Any], qualities: Any) -> dict[str, str]:
    """The values with the word of their quality if they are not good, else with their meaning if they have one."""
    known = qualities if isinstance(qualities, Mapping) else {}
    words = {name: one["text"] if one["quality"] == _GOOD else one["quality"] for name, one in known.items()}
    return {name: f"{_text(value)}{f' ({words[name]})' if words.get(name) else ''}" for name, value in fields.items()}


def _line(entry: Mapping[str, Any]) -> str | None:
    """A flat entry as one line; None for an entry that contains entries or lists of them."""
    members = [one for value in entry.values() for one in (value if isinstance(value, list) else [value])]
    if any(isinstance(one, (Mapping, list)) for one in members):
        return None
    return ", ".join(f"{key} {_text(value, ' ')}" for key, value in entry.items())


def _text(value: Any, between: str = ", ") -> str:
    if isinstance(value, list):
        texts = list(map(str, value))
        return ("; " if any(" " in text for text in texts) else between).join(texts) or "none"
    return "none" if value is None or value == "" else str(value)
