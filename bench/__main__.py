"""``python -m bench [NAME] [--json]``."""

from __future__ import annotations

import argparse
import importlib
import sys

#: name -> (module with ``run(argv) -> Report``, what it measures)
BENCHMARKS = {
    "codec": ("bench.codec", "encoding and decoding of telegrams, beside pyprofibus and construct"),
    "cycle": ("bench.cycle", "turn-around and CPU time per exchange over a pty at 12 Mbit/s parameters"),
    "gsd": ("bench.gsd", "reading a made-up set of 689 GSD files, and the largest ones"),
    "scale": ("bench.scale", "what one exchange costs the master, from 1 to 100 slaves"),
    "virtual": ("bench.virtual", "simulated seconds of the bus per second of CPU time"),
}


def main() -> int:
    """Run one benchmark, or list them."""
    parser = argparse.ArgumentParser(prog="python -m bench", description="dpstack benchmarks (in a checkout)")
    parser.add_argument("name", nargs="?", help="which one; without it they are listed")
    parser.add_argument("--json", action="store_true", help="one JSON object instead of lines")
    args, rest = parser.parse_known_args()
    if args.name is None:
        for name, (_, what) in BENCHMARKS.items():
            print(f"{name:<10} {what}")
        return 0
    if args.name not in BENCHMARKS:
        print(f"bench: no benchmark {args.name!r}; there are: {', '.join(BENCHMARKS)}", file=sys.stderr)
        return 2
    report = importlib.import_module(BENCHMARKS[args.name][0]).run(rest)
    print(report.as_json() if args.json else report.as_text())
    return 0


if __name__ == "__main__":
    sys.exit(main())
