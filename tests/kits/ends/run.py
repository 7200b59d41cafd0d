"""``dpstack`` with the face ``[probe]`` of ``probe_face``, for ``ends.rows``: ``python -m ends.run run PLANT ...``."""

from __future__ import annotations

import sys

import probe_face

from dpstack.cli.main import main

if __name__ == "__main__":
    probe_face.register()
    sys.exit(main())
