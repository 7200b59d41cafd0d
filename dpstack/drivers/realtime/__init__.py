"""Real-time operation of a bus process: scheduling rights, processors, processor budget, garbage collection.

- ``cpu_budget``: Limit of the processor time that a driver with real-time priority takes
- ``gc_control``: Garbage collection outside the cycle: in pauses that are longer than a collection
- ``processors``: Processors of this computer on Linux: the ones of the bus process, isolated ones, sleep states,
  interrupts of a port
- ``rights``: Real-time rights on Linux: priority, locked memory, exact timers
"""
