"""Commands for what the tests in this folder hold.

python tests/why symptoms [show]              writes the texts of docs/how-to/symptoms.md anew, or prints them
python tests/why score [FAULT,...] [SEEDS]    the score of the diagnosis on the table of faults
"""

from __future__ import annotations

import sys
from pathlib import Path


def main(words: list[str]) -> None:
    from tests.why import fault_score, symptom_plants

    match words:
        case ["symptoms", *rest]:
            symptom_plants.write(rest)
        case ["score", *rest]:
            fault_score.main(rest)
        case _:
            print(__doc__)


if __name__ == "__main__":
    root = Path(__file__).resolve().parents[2]
    sys.path[:1] = [str(root), str(root / "tests" / "kits")]
    main(sys.argv[1:])
