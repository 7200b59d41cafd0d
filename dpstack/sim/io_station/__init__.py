"""A simulated modular I/O station: slots that are pulled and plugged, channels with faults, alarms, records, I&M."""

from dpstack.sim.io_station.modules import MODULES, IoModule
from dpstack.sim.io_station.station import IDENT, IoStation

#: the GSD file, as ``package:file name``
GSD = "dpstack.sim.io_station:io-station.gsd"
#: what it is called where a GSD file is named
NAME = "io-station"

__all__ = ["GSD", "IDENT", "MODULES", "NAME", "IoModule", "IoStation"]
