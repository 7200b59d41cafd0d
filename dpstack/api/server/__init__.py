"""Slaves served: user slaves, simulated ones, a whole virtual bench.

- ``async_device``: Records of a slave served by async functions: each request is a task, whose end answers it
- ``server``: Server for the user's own slaves (:func:`serve_slave`): on a real port, or in a virtual world
- ``simulation``: Simulated slaves behind a real port (``dpstack sim``)
- ``slave_from_gsd``: The user's own slave from a GSD file and a function (:func:`slave_from_gsd`)
- ``virtual_bench``: Simulated slaves that can be silenced and switched off and on; those of a bus in virtual time
"""
