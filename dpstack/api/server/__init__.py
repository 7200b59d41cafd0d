"""Slaves served: user slaves, simulated ones, a whole virtual bench.

- ``async_device``: Records and alarms of a slave that async functions serve: each request is a task
- ``server``: Slaves of one's own on a bus: on a real port, or in a virtual world
- ``simulation``: Simulated slaves behind a real port, and the segment that ports can be joined by
- ``slave_from_gsd``: A slave of one's own from a GSD file and a function
- ``virtual_bench``: Simulated slaves that can be treated from outside: silenced, switched off and on
"""
