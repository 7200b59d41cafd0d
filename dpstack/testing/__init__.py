"""Tests of applications and of drive plugins on simulated buses: pytest fixtures in virtual time, faults, the wire.

- ``bus``: ``SimulatedBus``: a master and simulated slaves in virtual time, for plain (not async) tests
- ``drive_conformance``: ``DriveConformance``: the checks of a drive plugin against its simulated drive
- ``faults``: Faults of simulated slaves by name, and of the line
- ``plugin``: The pytest plugin: fixtures, and the wire log of a failing test
- ``wire``: Observation of a simulated line by its octets: exchanges, services, Clear, safe outputs
"""

from typing import TYPE_CHECKING, Final

from dpstack.namespaces import loader

if TYPE_CHECKING:
    from dpstack.testing.bus import BusFactory, SimulatedBus, SimulatedDevice, VirtualTime
    from dpstack.testing.drive_conformance import DriveConformance
    from dpstack.testing.faults import Fault, Faults
    from dpstack.testing.wire import Exchange, Service, Wire

__all__ = [
    "BusFactory",
    "DriveConformance",
    "Exchange",
    "Fault",
    "Faults",
    "Service",
    "SimulatedBus",
    "SimulatedDevice",
    "VirtualTime",
    "Wire",
]

#: module and its public names; pytest imports this package at its start, so nothing else is loaded here
_PLACES: Final = """
bus BusFactory SimulatedBus SimulatedDevice VirtualTime
drive_conformance DriveConformance
faults Fault Faults
wire Exchange Service Wire
"""
if not TYPE_CHECKING:  # a type checker knows the names
    __getattr__ = loader(__name__, _PLACES)


def __dir__() -> list[str]:
    return __all__
