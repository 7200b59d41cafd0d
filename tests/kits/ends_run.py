"""``dpstack`` with the face ``[probe]`` of ``probe_face``, for ``ends_rows``: ``python ends_run.py run PLANT ...``."""

from __future__ import annotations

import sys

import probe_face

from dpstack.cli.main import main

if __name__ == "__main__":
    probe_face.register()
    sys.exit(main())
