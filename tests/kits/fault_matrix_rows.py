"""All faults of the fault matrix, in the order of its snapshot."""

from __future__ import annotations

from fault_matrix import Fault
from fault_matrix_stations import STATION_FAULTS
from fault_matrix_wire import WIRE_FAULTS
from line_faults import LINE_FAULTS

FAULTS: list[Fault] = [*WIRE_FAULTS, *STATION_FAULTS, *LINE_FAULTS]
