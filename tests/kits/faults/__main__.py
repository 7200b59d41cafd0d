"""Writes the lines of the fault matrix, or prints its table; ``faults.matrix`` says how."""

from __future__ import annotations

import sys
from pathlib import Path


def main(arguments: list[str]) -> None:
    from faults.matrix import table, write
    from faults.rows import FAULTS

    if arguments == ["--table"]:
        print(table(FAULTS))
    else:
        write(FAULTS, [a for a in arguments if a != "--quick"], quick="--quick" in arguments)


if __name__ == "__main__":
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    main(sys.argv[1:])
