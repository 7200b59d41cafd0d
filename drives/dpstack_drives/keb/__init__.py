"""KEB COMBIVERT F5 with its PROFIBUS operator, ``keb-f5``: a profile of its own. Its facts are in ``keb-f5.toml``."""

from __future__ import annotations

from typing import Final

from dpstack.devices.finding import find
from dpstack.devices.profiles import DevicePython
from dpstack_drives.keb import table as t
from dpstack_drives.keb import telegrams
from dpstack_drives.keb.plugin import KebCore

#: behind the device file, at the entry point ``keb-f5``
PYTHON: Final = DevicePython(
    KebCore, "dpstack_drives.keb.simulator:KebDevice", "dpstack_drives.keb.description:describe", telegrams.FAMILY
)
DRIVE: Final = find(str(t.FILE.path))
