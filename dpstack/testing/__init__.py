"""Tests of applications and of drive plugins on simulated buses: pytest fixtures in virtual time, faults, the wire.

- ``bus``: ``SimulatedBus``: a master and simulated slaves in virtual time, for plain (not async) tests
- ``drive_conformance``: ``DriveConformance``: the checks of a drive plugin against its simulated drive
- ``faults``: Faults of simulated slaves by name, and of the line
- ``plugin``: The pytest plugin: fixtures, and the wire log of a failing test
- ``wire``: Observation of a simulated line by its octets: exchanges, services, Clear, safe outputs
"""

from typing import TYPE_CHECKING, Final

from dpstack.namespaces import namespace

if TYPE_CHECKING:
    from dpstack.testing.bus import BusFactory as BusFactory
    from dpstack.testing.bus import SimulatedBus as SimulatedBus
    from dpstack.testing.bus import SimulatedDevice as SimulatedDevice
    from dpstack.testing.bus import VirtualTime as VirtualTime
    from dpstack.testing.drive_conformance import DriveConformance as DriveConformance
    from dpstack.testing.faults import Fault as Fault
    from dpstack.testing.faults import Faults as Faults
    from dpstack.testing.wire import Exchange as Exchange
    from dpstack.testing.wire import Service as Service
    from dpstack.testing.wire import Wire as Wire

#: module and its public names; pytest imports this package at its start, so nothing else is loaded here
_PLACES: Final = """
bus BusFactory SimulatedBus SimulatedDevice VirtualTime
drive_conformance DriveConformance
faults Fault Faults
wire Exchange Service Wire
"""
if not TYPE_CHECKING:  # a type checker knows the names
    __getattr__, __dir__, __all__ = namespace(__name__, _PLACES)
