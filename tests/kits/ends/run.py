"""``dpstack`` with the connector ``[probe]`` of ``probe_connector``, for ``ends.rows``: ``python -m ends.run run PLANT
...``."""

from __future__ import annotations

import sys

import probe_connector

from dpstack.cli.main import main

if __name__ == "__main__":
    probe_connector.register()
    sys.exit(main())
