"""What keeps a machine running: an asyncio loop on a port, or the virtual world.

- ``line/``: A machine on a port of this process: event loops, timers, the lateness of ports
- ``process/``: A bus in a process of its own, and its application at the other end of a socket
- ``realtime/``: What makes a bus process punctual: rights, its share of the processor, the collector
- ``segment/``: A segment made of ptys: stations of other programs on one simulated line
- ``virtual/``: A machine in virtual time
- ``futures``: Futures of asyncio as the drivers use them
- ``runtime``: What every driver offers to the API: one machine kept running on one line inside an asyncio loop
- ``shutdown``: The ordered end of a bus: safe values, Clear twice, class 2 connections given back, out of the ring
- ``snapshots``: What an application sees of its bus. The bus side makes them, and they are the same with every driver
- ``stack``: The machines of one bus, from plain data, and their snapshots: what every driver runs, in whichever process
"""
