"""A simulated modular I/O station: slots that are pulled and plugged, channels with faults, alarms, records, I&M.

- ``modules``: The module types of the I/O station as in its GSD file, and a slot with the module plugged into it
- ``station``: The simulated I/O station: a head and up to eight modules
"""

from dpstack.sim.io_station.modules import MODULES, IoModule
from dpstack.sim.io_station.station import IDENT, IoStation

#: the GSD file, as ``package:file name``
GSD = "dpstack.sim.io_station:io-station.gsd"
#: its name if a GSD file is named
NAME = "io-station"

__all__ = ["GSD", "IDENT", "MODULES", "NAME", "IoModule", "IoStation"]
