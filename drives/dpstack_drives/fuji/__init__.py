"""Fuji FRENIC-Multi with OPC-E1-PDP, ``fuji-frenic``: PROFIdrive V2. Its facts are in ``fuji-frenic.toml``."""

from __future__ import annotations

from typing import Final

from dpstack.devices.finding import find
from dpstack.devices.profiles import DevicePython
from dpstack_drives.fuji import table as t
from dpstack_drives.fuji.plugin import FujiCore

#: behind the device file, at the entry point ``fuji-frenic``
PYTHON: Final = DevicePython(FujiCore, "dpstack_drives.fuji.simulator:FujiDevice")
DRIVE: Final = find(str(t.FILE.path))
