"""A simulated modular I/O station: slots that are pulled and plugged, channels with faults, alarms, records, I&M.

- ``modules``: The module types of the I/O station as in its GSD file, and a slot with the module plugged into it
- ``station``: The simulated I/O station: a head and up to eight modules
"""

from typing import Final

#: the GSD file, as ``package:file name``
GSD: Final = "dpstack.sim.io_station:io-station.gsd"
#: its name if a GSD file is named
NAME: Final = "io-station"
#: its ident number
IDENT: Final = 0x10D5
