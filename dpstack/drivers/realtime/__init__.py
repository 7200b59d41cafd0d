"""Real-time operation of a bus process: scheduling rights, processor budget, garbage collection.

- ``cpu_budget``: Limit of the processor time that a driver with real-time priority takes
- ``gc_control``: Garbage collection outside the cycle: in pauses that are longer than a collection
- ``rights``: Real-time rights on Linux: priority, locked memory, exact timers, processors
"""
