"""KEB COMBIVERT F5 with its PROFIBUS operator, ``keb-f5``: a profile of its own. Its facts are in ``keb-f5.toml``."""

from __future__ import annotations

from typing import Final

from dpstack.devices.finding import find
from dpstack.devices.profiles import DevicePython
from dpstack_drives.keb import table as t
from dpstack_drives.keb import telegrams
from dpstack_drives.keb.description import describe
from dpstack_drives.keb.plugin import KebCore
from dpstack_drives.keb.simulator import KebDevice

#: behind the device file, at the entry point ``keb-f5``
PYTHON: Final = DevicePython(KebCore, KebDevice, describe, telegrams.FAMILY)
DRIVE: Final = find(str(t.FILE.path))
