"""``dpstack ports``: the serial adapters of this computer."""

from __future__ import annotations

import argparse

from dpstack.api.doctor import list_adapters
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output


def add_to(parser: Parser) -> None:
    parser.epilog = "example: dpstack ports --json"
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    adapters = list_adapters()
    if args.json:
        output.json_line({"ports": [adapter.as_dict() for adapter in adapters]})
    elif adapters:
        rows = [(a.path, a.chip, a.driver or "", a.holder or "", a.by_id or "") for a in adapters]
        output.table("", ("port", "chip", "driver", "held by", "lasting path"), rows)
        for adapter in adapters:
            output.line("")
            output.line(f"{adapter.path}:")
            for line in adapter.class_lines():
                output.line(f"  {line}")
    else:
        output.line("no serial adapter is plugged in")
    return 0
