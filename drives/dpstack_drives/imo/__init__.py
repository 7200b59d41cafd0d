"""IMO HD2 with its HD2-E-PDP card, ``imo-hd2``: codes instead of command bits. Its facts are in ``imo-hd2.toml``."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from dpstack.devices.finding import find
from dpstack.devices.profiles import DevicePython
from dpstack_drives.imo.plugin import ImoCore

#: behind the device file, at the entry point ``imo-hd2``
PYTHON: Final = DevicePython(
    ImoCore, "dpstack_drives.imo.simulator:ImoDevice", "dpstack_drives.imo.description:describe"
)
DRIVE: Final = find(str(Path(__file__).with_name("imo-hd2.toml")))
