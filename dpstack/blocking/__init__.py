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

from __future__ import annotations

import functools
from typing import Any

from dpstack.api import streams as _streams
from dpstack.api.bus import bus as _bus
from dpstack.api.bus import find_baud as _find_baud
from dpstack.api.bus import live as _live
from dpstack.api.bus import opening as _opening
from dpstack.api.bus import recording as _recording
from dpstack.api.bus import sync_freeze as _sync_freeze
from dpstack.api.bus.driver_choice import is_free_for_process as _is_free_for_process
from dpstack.api.connectors import publishing as _publishing
from dpstack.api.slave import alarms as _alarms
from dpstack.api.slave import class2 as _class2
from dpstack.api.slave import drive as _drive
from dpstack.api.slave import record_parameters as _record_parameters
from dpstack.api.slave import slave as _slave
from dpstack.api.slave_side import slave_server as _server
from dpstack.blocking.proxies import Items, blocking_class, blocking_function

__all__ = [
    "AlarmStream",
    "Bus",
    "BusRecording",
    "Class2",
    "Connection",
    "Drive",
    "EventStream",
    "Group",
    "Items",
    "LiveStream",
    "Publishing",
    "Reader",
    "RecordParameters",
    "ServedSlave",
    "Slave",
    "SlaveAlarm",
    "SlaveServer",
    "find_baud",
    "open_bus",
    "publish",
    "serve_slave",
    "serve_slaves",
]

Reader = blocking_class(_streams.Reader)
EventStream = blocking_class(_streams.EventStream)
LiveStream = blocking_class(_live.LiveStream)
AlarmStream = blocking_class(_alarms.AlarmStream)
SlaveAlarm = blocking_class(_alarms.SlaveAlarm)
RecordParameters = blocking_class(_record_parameters.RecordParameters)
Slave = blocking_class(_slave.Slave)
Drive = blocking_class(_drive.Drive)
Group = blocking_class(_sync_freeze.Group)
Connection = blocking_class(_class2.Connection)
Class2 = blocking_class(_class2.Class2)
BusRecording = blocking_class(_recording.BusRecording)
Bus = blocking_class(_bus.Bus)
Publishing = blocking_class(_publishing.Publishing)
ServedSlave = blocking_class(_server.ServedSlave)
SlaveServer = blocking_class(_server.SlaveServer)


@functools.wraps(_opening.open_bus)
def _open_bus(config: Any = None, *, slaves: Any = (), **given: Any) -> _bus.Bus:
    slaves = tuple(slaves)
    bus = _opening.open_bus(config, slaves=slaves, **given)
    if given.get("world") is None and _is_free_for_process(bus.config):
        bus = _opening.open_bus(config, slaves=slaves, **given | {"driver": "process"})
    return bus


open_bus = blocking_function(_open_bus)
publish = blocking_function(_publishing.publish)
find_baud = blocking_function(_find_baud.find_baud)
serve_slave = blocking_function(_server.serve_slave)
serve_slaves = blocking_function(_server.serve_slaves)
