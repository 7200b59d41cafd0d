"""A machine in virtual time.

- ``loop``: An asyncio event loop whose time is virtual: exact, deterministic, and as fast as the machine can compute
- ``runtime``: The virtual driver: one station of a simulated bus, driven by the application's event loop
"""
