"""``dpstack doctor``: checks of adapters, permissions, latency and real-time rights."""

from __future__ import annotations

import argparse
import json

from dpstack.api.doctor import Grade, examine
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.errors import UsageError
from dpstack.service import host_setup

_STYLES = {Grade.OK: "", Grade.NOTE: "yellow", Grade.FINDING: "red"}


def add_to(parser: Parser) -> None:
    parser.epilog = "example: dpstack doctor --port /dev/ttyUSB0"
    parser.value("--port", "P", "only this port (default: every adapter)")
    parser.flag("--fix", "print the steps that set this computer up: udev rule, group, real-time rights, systemd unit")
    parser.flag("--measure", "measure the adapter of --port without a bus: turn-around, rates made, marks (JSON)")
    parser.add_argument(
        "--loop",
        nargs="?",
        const="",
        metavar="P",
        help="with --measure: the port hears what it sends, or P is the port at the other end of the line",
    )
    parser.flag("--yes", "with --fix: carry the steps out, needs root; with --loop: nothing else is connected, send")
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 when a check has a finding, or a step failed."""
    if args.measure or args.loop is not None:
        return _measure(args)
    if args.yes:
        return _set_up(json=args.json, fix=args.fix)
    checks = examine(args.port)
    findings = sum(check.level is Grade.FINDING for check in checks)
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


def _measure(args: argparse.Namespace) -> int:
    """Measure an adapter. Nothing is sent without ``--yes``: silence does not prove that a bus is empty."""
    if not args.measure or args.port is None:
        raise UsageError("--measure needs --port P, and --loop needs --measure")
    if args.fix:
        raise UsageError("--measure and --fix are two things: give one of them")
    if args.loop is not None and not args.yes:
        raise UsageError(
            "--loop sends on the port: where nothing but the loop is connected, say so with --yes (silence does not "
            "prove that a bus is empty)"
        )
    from dpstack.api.measure import measure  # opens ttys, which the checks of a computer need not

    found = measure(args.port, args.loop)
    if args.json:
        output.json_line(found)
    else:
        output.raw(json.dumps(found, indent=2))
    return 0


def _set_up(*, json: bool, fix: bool) -> int:
    """Carry the set-up out."""
    if not fix:
        raise UsageError("--yes carries out what --fix prints: give both")
    steps = host_setup.carry_out()
    if json:
        output.json_line({"steps": steps, "done": True})
    else:
        _show(steps)
        output.line("done: log in again (for the group), then look with: dpstack doctor")
    return 0


def _show(steps: list[str]) -> None:
    for step in steps:
        output.line(f"  {step}")
