"""What makes a bus process punctual: rights, its share of the processor, the collector.

- ``cpu_budget``: How much a driver with real-time priority may take of its processor
- ``gc_control``: Garbage collection out of the cycle: by hand, where nothing is due for longer than it takes
- ``rights``: What a process asks of Linux to be punctual; each refusal is a notice that says what to do
"""
