"""LS ELECTRIC LSLV-S100 with CPDP-S100, ``ls-s100``: PROFIdrive, LS Drive profile or plain words.

Its facts are in ``ls-s100.toml``.
"""

from __future__ import annotations

from typing import Final

from dpstack.devices.finding import find
from dpstack.devices.profiles import DevicePython
from dpstack_drives.ls import table as t
from dpstack_drives.ls import telegrams
from dpstack_drives.ls.plugin import LsCore

#: behind the device file, at the entry point ``ls-s100``
PYTHON: Final = DevicePython(
    LsCore, "dpstack_drives.ls.simulator:LsDevice", "dpstack_drives.ls.description:describe", telegrams.FAMILY
)
DRIVE: Final = find(str(t.FILE.path))
