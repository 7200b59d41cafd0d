"""Measures rows of docs/explanation/ends.md; the package says how."""

from __future__ import annotations

import sys
from pathlib import Path

if __name__ == "__main__":
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    from ends.rows import main

    main(sys.argv[1:])
