"""Real-time drivers of one protocol machine on one serial port: event loops, timers, echo, port latency.

- ``answer_timing``: Expected time of an answer, learned from earlier answers to requests with the same header
- ``asyncio_runtime``: The asyncio driver: runs one protocol machine on one serial port
- ``echo``: Echo filter for adapters that return the transmitted octets
- ``last_clear``: Clear without the protocol machine, sent by a driver whose machine has failed
- ``line_runtime``: Common part of the real-time drivers: steps the protocol machine, dispatches its events
- ``port_latency``: Latency of a port: how late the first octets after a transmission arrive
- ``port_watch``: A look at the port when slaves fell silent: has another program changed its settings, does it read
  along?
- ``rate``: Baud rate of an open port, which follows its machine; pauses between attempts to open a lost port
- ``select_loop``: Event loop of the bus process on select(): file descriptors, deadlines in nanoseconds, signals
- ``select_runtime``: The driver on select(), without asyncio: runs one protocol machine on one serial port
- ``shutdown``: The ordered end of a bus: safe values, Clear twice, class 2 connections given back, out of the ring
- ``timers``: Timers for deadlines in an event loop (timerfd on Linux, else the loop's own); the clock of system sleep
"""
