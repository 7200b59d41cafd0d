"""``dpstack doctor``: checks of adapters, permissions, latency and real-time rights."""

from __future__ import annotations

import argparse

from dpstack.api.doctor import Level, examine
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.errors import UsageError
from dpstack.service import host_setup

_STYLES = {Level.OK: "", Level.NOTE: "yellow", Level.FINDING: "red"}


def add_to(parser: Parser) -> None:
    parser.epilog = "example: dpstack doctor --port /dev/ttyUSB0"
    parser.value("--port", "P", "only this port (default: every adapter)")
    parser.flag("--fix", "print the steps that set this computer up: udev rule, group, real-time rights, systemd unit")
    parser.flag("--yes", "with --fix: carry the steps out; needs root")
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 when a check has a finding, or a step failed."""
    if args.yes:
        return _set_up(json=args.json, fix=args.fix)
    checks = examine(args.port)
    findings = sum(check.level is Level.FINDING for check in checks)
    steps = host_setup.steps() if args.fix else []
    if args.json:
        more = {"steps": steps, "done": False} if args.fix else {}
        output.json_line({"findings": findings, "checks": [check.as_dict() for check in checks], **more})
    else:
        for check in checks:
            output.line(f"{check.level.value:7}  {check.topic}: {check.text}", _STYLES[check.level])
            if check.todo:
                output.line(f"         {check.todo}")
        if args.fix:
            output.line("the set-up has these steps, and changes nothing else:")
            _show(steps)
            output.line(f"to carry them out: {host_setup.command_for_root()}")
    return 1 if findings else 0


def _set_up(*, json: bool, fix: bool) -> int:
    """Carry the set-up out."""
    if not fix:
        raise UsageError("--yes carries out what --fix prints: give both")
    steps = host_setup.carry_out()
    if json:
        output.json_line({"steps": steps, "done": True})
    else:
        _show(steps)
        output.line("done: plug the adapter in again and log in again, then look with: dpstack doctor")
    return 0


def _show(steps: list[str]) -> None:
    for step in steps:
        output.line(f"  {step}")
