"""The ``Bus`` of the public API: opening, plan, cycles, events, statistics, end.

- ``bus``: ``Bus``: opening, modes, slaves, events and the end of a running bus
- ``compose``: Construction of the objects behind a bus: plan, master, station, runtime, drive plugins
- ``core``: ``BusCore``: the inside of a ``Bus``: beginning and end, events and failures of the machine
- ``cycles``: ``bus.cycles()``: consistent inputs of all slaves, once a round of data exchange
- ``driver_choice``: The choice of the driver: asyncio, process or virtual
- ``events_json``: Events of a bus for applications: their severity, their JSON, and records of ``logging``
- ``find_baud``: Search for the baud rate of a bus: listens at one rate after the other and never sends
- ``live``: ``bus.live()``: plant, snapshots and events of a bus as one stream
- ``opening``: ``open_bus``, and the early start of a bus process
- ``parts``: Base class of ``BusCore``: the objects behind a bus (created once the baud rate is known), slaves,
  commands, waiting
- ``picture``: State and values of a slave, or of an S7-200, at one moment, made here only
- ``plan_checks``: Inputs of the plan from the configuration, and the refusal of impossible cycles
- ``recording``: ``bus.record()``: process data of each round into files, and the files of ``dpstack run``
- ``ring_entry``: Joining the token ring of other masters: time limit, failure texts, notices
- ``shutdown``: The ordered end of a bus: cancellation, signals, finaliser, fork
- ``statistics``: Counters and rotation times of a bus
- ``sync_freeze``: SYNC and FREEZE: one Global_Control, groups of slaves
- ``virtual``: Programs on simulated buses in virtual time
- ``why``: Evidence for ``dpstack why``: gathered from a running bus, or by a class 2 look at a bus
"""
