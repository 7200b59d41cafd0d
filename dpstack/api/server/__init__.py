"""Slaves served: user slaves, simulated ones, a whole virtual bench.

- ``async_device``: Records of a slave served by async functions: each request is a task, whose end answers it
- ``server``: The user's own slaves: made from a GSD file, and served on a real port or in a virtual world
- ``simulation``: Simulated slaves behind a real port (``dpstack sim``)
- ``virtual_bench``: Simulated slaves that can be silenced and switched off and on; those of a bus in virtual time
"""
