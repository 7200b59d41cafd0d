"""Drivers keep a machine running: an event loop on a port, a process of its own, or virtual time.

- ``line/``: A machine on a port of this process: event loops, timers, the lateness of ports
- ``process/``: A bus in a process of its own, and its application at the other end of a socket
- ``realtime/``: Punctuality of a bus process: rights, its share of the processor, garbage collection
- ``segment/``: A segment made of ptys: stations of other programs on one simulated line
- ``virtual/``: A machine in virtual time
- ``futures``: Waiting for futures of asyncio through cancellations; orders that take effect at once
- ``runtime``: The interface of all drivers to the API, and their events
- ``snapshots``: Snapshots of a bus for its application, the same with every driver
- ``stack``: The machines of one bus, made from plain data, and their snapshots
- ``tap``: Tap: a bounded ring with the octets that a running machine receives and sends, for programs that look on
"""
