"""``python -m dpstack``: the program ``dpstack`` of this interpreter."""

from __future__ import annotations

import sys

from dpstack.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
