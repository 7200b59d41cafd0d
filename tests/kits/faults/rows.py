"""All faults of the fault matrix, in the order of its snapshot."""

from __future__ import annotations

from faults.broadcast import BROADCAST_FAULTS
from faults.line_faults import LINE_FAULTS
from faults.matrix import Fault
from faults.stations import STATION_FAULTS
from faults.wire import WIRE_FAULTS

FAULTS: list[Fault] = [*WIRE_FAULTS, *STATION_FAULTS, *BROADCAST_FAULTS, *LINE_FAULTS]
