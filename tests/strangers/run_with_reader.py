"""``dpstack run`` with an application beside it in the same program, which writes what the API says into a file.

``python run_with_reader.py FILE run CONFIG ...``
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import sys
from pathlib import Path
from typing import Any

from dpstack.api.bus import bus as of_bus
from dpstack.cli import main
from dpstack.errors import DpError

FILE = Path(sys.argv[1])


class WatchedBus(of_bus.Bus):
    """The bus of the run, with a reader."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._reading = asyncio.get_running_loop().create_task(self._read())

    async def _read(self) -> None:
        while True:
            await asyncio.sleep(0.3)
            with contextlib.suppress(DpError):  # not open yet
                found = {name: slave.value(name) for slave in self.slaves for name in slave}
                part = FILE.with_suffix(".part")
                part.write_text(json.dumps({name: [one.value, one.quality, one.text] for name, one in found.items()}))
                os.replace(part, FILE)


if __name__ == "__main__":
    from dpstack.cli.commands import run

    setattr(run, "Bus", WatchedBus)  # noqa: B010 - the command takes the bus from there
    sys.exit(main.main(sys.argv[2:]))
