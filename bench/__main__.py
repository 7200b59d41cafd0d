"""``python -m bench [NAME] [--json]``, ``python -m bench compare NAME --commit OLD``,
``python -m bench goals [--commit OLD]``."""

from __future__ import annotations

import argparse
import importlib
import sys
from typing import Final

from bench import goals
from bench.report import Report
from bench.rounds import compare_with_commit

#: name -> (module with ``run(argv) -> Report``, what it measures)
BENCHMARKS = {
    "acyclic": ("bench.acyclic", "what permanent Read and Write does to rotation and cycle, and what it carries"),
    "application": ("bench.application", "a control loop by cycle in virtual time, as a test of the kit"),
    "codec": ("bench.codec", "encoding and decoding of telegrams, beside pyprofibus and construct"),
    "cycle": ("bench.cycle", "turn-around, CPU time and whole exchanges over a pty at 12 Mbit/s parameters"),
    "connectors": ("bench.plant.connectors", "what all connectors cost the bus: CPU time, messages, fixed cycle"),
    "fleet": ("bench.plant.fleet", "50 gateways and a broker: messages, CPU time, from a loss to its DDEATH, recovery"),
    "jitter": ("bench.jitter", "how late the rounds of a fixed cycle begin, beside an idle, blocking, busy program"),
    "listen": ("bench.listen", "cutting, counting, writing, reading and decoding of what is heard on a bus"),
    "live": ("bench.live", "what readers of the live stream add to an exchange's CPU time; snapshots of 125 slaves"),
    "parameters": ("bench.parameters", "reading a device's own list of 1000 parameters over record 47"),
    "peers": ("bench.peers.table", "CPU time and rotation of dpstack, pyprofibus and profirust as masters, in turn"),
    "ring": ("bench.ring", "two masters in a token ring at the highest rate of two bare loops (needs a C compiler)"),
    "rotation": ("bench.rotation", "bus rotation time on a paced bus beside the time on the wire; CPU time there"),
    "scale": ("bench.scale", "what one exchange costs the master, from 1 to 100 slaves"),
    "startup": ("bench.startup", "time until 32 slaves are in data exchange"),
    "usb": ("bench.usb", "the rotation behind a USB adapter's habits: wire, adapter and stack apart"),
    "virtual": ("bench.virtual", "the CPU time of an exchange and of a second of the simulated bus"),
}

_EPILOG: Final = """\
python -m bench rotation --json > now.json     one object with machine, versions and figures
python -m bench compare virtual --commit OLD   measures a commit and the tree as it stands in turn
python -m bench goals --commit OLD             the goals of speed in one table, both measured in turn
"""


def main(argv: list[str] | None = None) -> int:
    """Run one benchmark, compare two reports, or list what there is.

    1: something became worse, or nothing was measured; 2: wrong use.
    """
    words = sys.argv[1:] if argv is None else argv
    parser = argparse.ArgumentParser(
        prog="python -m bench",
        description="dpstack benchmarks (in a checkout); what else is given goes to the benchmark",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,  # what is not known here is the benchmark's
        add_help=len(words) < 2 or words[0].startswith("-"),  # behind a name: the benchmark's own
    )
    parser.add_argument("name", nargs="?", help="which one, compare or goals; without it they are listed")
    parser.add_argument("--json", action="store_true", help="one JSON object instead of lines")
    parser.add_argument("--markdown", action="store_true", help="a table for a page")
    args, rest = parser.parse_known_args(words)
    if args.name is None:
        for name, (_, what) in BENCHMARKS.items():
            print(f"{name:<10} {what}")
        return 0
    try:
        if args.name == "compare":
            return _compare(rest, as_json=args.json)
        if args.name == "goals":
            return goals.main([*rest, *(["--markdown"] if args.markdown else [])], as_json=args.json)
        report = run(args.name, rest)
        print(report.as_json() if args.json else report.as_markdown() if args.markdown else report.as_text())
    except ValueError as error:
        print(f"bench: {error}", file=sys.stderr)
        return 2
    except RuntimeError as error:
        print(f"bench: {error}", file=sys.stderr)
        return 1
    return 0


def run(name: str, argv: list[str]) -> Report:
    """The report of one benchmark with its own options. Raises ValueError for one that does not exist."""
    if name not in BENCHMARKS:
        raise ValueError(f"no benchmark {name!r}; there are: {', '.join(BENCHMARKS)}; and the commands compare, goals")
    report: Report = importlib.import_module(BENCHMARKS[name][0]).run(argv)
    return report.finished()


def _compare(argv: list[str], *, as_json: bool) -> int:
    parser = argparse.ArgumentParser(prog="python -m bench compare", epilog="1: something became slower")
    parser.add_argument("name")
    parser.add_argument("--commit", required=True, metavar="OLD", help="measure it and the tree as it stands in turn")
    parser.add_argument("--rounds", type=int, help="10 at least")
    args = parser.parse_args(argv)
    if args.name not in BENCHMARKS:
        raise ValueError(f"no benchmark {args.name!r}; there are: {', '.join(BENCHMARKS)}")
    result = compare_with_commit(args.name, args.commit, args.rounds)
    print(result.as_json() if as_json else result.as_text())
    return 1 if result.slower else 0


if __name__ == "__main__":
    sys.exit(main())
