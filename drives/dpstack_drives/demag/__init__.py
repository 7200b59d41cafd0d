"""Demag Dedrive Compact with CM-PDP-24, ``demag-dedrive``: control by state machine (412 = 1) or contacts (2). Its
facts are in ``demag-dedrive.toml``."""

from __future__ import annotations

from typing import Final

from dpstack.devices.finding import find
from dpstack.devices.profiles import DevicePython
from dpstack_drives.demag import table as t
from dpstack_drives.demag.plugin import DemagCore

#: behind the device file, at the entry point ``demag-dedrive``
PYTHON: Final = DevicePython(DemagCore, "dpstack_drives.demag.simulator:DemagDevice")
DRIVE: Final = find(str(t.FILE.path))
