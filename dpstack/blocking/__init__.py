"""The names of dpstack without ``await``, for scripts, the REPL, Jupyter and test benches (docs/how-to/blocking.md).

::

    with dpstack.blocking.open_bus("plant.toml") as bus:
        bus.operate()
        mixer = bus.drive("mixer")
        mixer.start()
        for event in bus.events(timeout=5):
            print(event.text)

Each class here has the methods and properties of the class of the same name in dpstack. A call is carried out in an
event loop, which runs in a thread of its own, and waits for the result; an asynchronous iterator is an iterator, and
``async with`` is ``with``. Ctrl-C in a waiting call cancels that call, and the bus goes on.

- ``portal``: The event loop in a thread of its own, and calls into it
- ``proxies``: The classes and functions made from the asynchronous ones
"""

import functools
from typing import Any as _Any

from dpstack.api import streams as _streams
from dpstack.api.bus import bus as _bus
from dpstack.api.bus import find_baud as _find_baud
from dpstack.api.bus import live as _live
from dpstack.api.bus import opening as _opening
from dpstack.api.bus import recording as _recording
from dpstack.api.bus import sync_freeze as _sync_freeze
from dpstack.api.bus.driver_choice import is_free_for_process as _is_free_for_process
from dpstack.api.connectors import publishing as _publishing
from dpstack.api.fdl import fdl as _fdl
from dpstack.api.fdl import sap as _sap
from dpstack.api.fdl_station import station as _station
from dpstack.api.pa import device as _pa_device
from dpstack.api.ppi import cpu as _cpu
from dpstack.api.ppi import plant_cpu as _plant_cpu
from dpstack.api.slave import alarms as _alarms
from dpstack.api.slave import class2 as _class2
from dpstack.api.slave import drive as _drive
from dpstack.api.slave import hart as _hart
from dpstack.api.slave import record_parameters as _record_parameters
from dpstack.api.slave import slave as _slave
from dpstack.api.slave_side import slave_server as _server
from dpstack.blocking.proxies import Items as Items
from dpstack.blocking.proxies import blocking_class as _class
from dpstack.blocking.proxies import blocking_function as _function

Reader = _class(_streams.Reader)
EventStream = _class(_streams.EventStream)
LiveStream = _class(_live.LiveStream)
AlarmStream = _class(_alarms.AlarmStream)
SlaveAlarm = _class(_alarms.SlaveAlarm)
RecordParameters = _class(_record_parameters.RecordParameters)
HartDevice = _class(_hart.HartDevice)
PaDevice = _class(_pa_device.PaDevice)
Slave = _class(_slave.Slave)
Drive = _class(_drive.Drive)
Group = _class(_sync_freeze.Group)
Connection = _class(_class2.Connection)
Class2 = _class(_class2.Class2)
BusRecording = _class(_recording.BusRecording)
Sap = _class(_sap.Sap)
Fdl = _class(_fdl.Fdl)
FdlStation = _class(_station.FdlStation)
Cpu = _class(_cpu.Cpu)
CpuConnection = _class(_station.CpuConnection)
PlantCpu = _class(_plant_cpu.PlantCpu)
Bus = _class(_bus.Bus)
Publishing = _class(_publishing.Publishing)
ServedSlave = _class(_server.ServedSlave)
SlaveServer = _class(_server.SlaveServer)


def _opening_function(opens: _Any, config_of: _Any) -> _Any:
    """``opens`` with the process driver as its default, if the configuration of what it has made (``config_of``)
    leaves the driver open."""

    @functools.wraps(opens)
    def opened(*args: _Any, **given: _Any) -> _Any:
        given |= {name: tuple(given[name]) for name in ("slaves", "ppi") if name in given}  # read twice
        found = opens(*args, **given)
        if given.get("world") is None and _is_free_for_process(config_of(found)):
            found = opens(*args, **given | {"driver": "process"})
        return found

    return _function(opened)


open_bus = _opening_function(_opening.open_bus, lambda bus: bus.config)
open_fdl = _opening_function(_station.open_fdl, lambda fdl: fdl.config)
open_ppi = _opening_function(_station.open_ppi, lambda cpu: cpu.station.config)
publish = _function(_publishing.publish)
find_baud = _function(_find_baud.find_baud)
serve_slave = _function(_server.serve_slave)
serve_slaves = _function(_server.serve_slaves)

__all__ = sorted(name for name, value in globals().items() if name[0].isalpha() and callable(value))
