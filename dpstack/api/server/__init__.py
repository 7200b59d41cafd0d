"""Slaves in this program: the user's own, and simulated ones.

- ``async_device``: Async functions that serve the records of a slave: a task for each request
- ``server``: The user's own slaves: made from a GSD file, served on a real port or in a virtual world
- ``simulation``: Simulated slaves behind a real port (``dpstack sim``)
- ``virtual_bench``: Simulated slaves that commands silence and switch off and on; those of a bus in virtual time
"""
