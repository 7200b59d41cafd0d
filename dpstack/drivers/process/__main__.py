"""``python -m dpstack.drivers.process SOCKET MEMORY PARENT``: runs :mod:`dpstack.drivers.process.program`."""

from __future__ import annotations

import gc
import sys

if __name__ == "__main__":
    gc.disable()  # modules stay: to look for garbage among them takes a tenth of the start
    from dpstack.late_imports import spare_imports

    spare_imports()
    from dpstack.drivers.process.program import main

    sys.exit(main(sys.argv[1:]))
