"""A simulated modular I/O station: slots that are pulled and plugged, channels with faults, alarms, records, I&M.

- ``modules``: The modules of the I/O station as its GSD file has them, and one slot with what is plugged into it
- ``records``: The records of the I/O station: parameters and state of a module, I&M of every slot
- ``station``: The I/O station: a head and up to eight modules. What happens to it from outside is a method each
"""

from dpstack.sim.io_station.modules import MODULES, IoModule
from dpstack.sim.io_station.station import IDENT, IoStation

#: the GSD file, as ``package:file name``
GSD = "dpstack.sim.io_station:io-station.gsd"
#: what it is called where a GSD file is named
NAME = "io-station"

__all__ = ["GSD", "IDENT", "MODULES", "NAME", "IoModule", "IoStation"]
