"""Virtual time: its event loop, and the driver of a station on a simulated bus.

- ``loop``: Asyncio event loop in virtual time: exact, deterministic, and as fast as the computer allows
- ``runtime``: The virtual driver: one station of a simulated bus, driven by the application's event loop
"""
