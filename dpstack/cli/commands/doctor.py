"""``dpstack doctor``: checks of adapters, permissions, latency and real-time rights."""

from __future__ import annotations

import argparse

from dpstack.api.doctor import Level, examine
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output

_STYLES = {Level.OK: "", Level.NOTE: "yellow", Level.FINDING: "red"}


def add_to(parser: Parser) -> None:
    parser.epilog = "example: dpstack doctor --port /dev/ttyUSB0"
    parser.value("--port", "P", "only this port (default: every adapter)")
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 when a check has a finding."""
    checks = examine(args.port)
    findings = sum(check.level is Level.FINDING for check in checks)
    if args.json:
        output.json_line({"findings": findings, "checks": [check.as_dict() for check in checks]})
    else:
        for check in checks:
            output.line(f"{check.level.value:7}  {check.topic}: {check.text}", _STYLES[check.level])
            if check.todo:
                output.line(f"         {check.todo}")
    return 1 if findings else 0
