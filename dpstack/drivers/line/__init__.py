"""A machine on a port of this process: event loops, timers, the lateness of ports.

- ``answer_timing``: When an answer is to be expected: requests that begin alike were answered after so long
- ``asyncio_runtime``: The asyncio driver: one machine on one port, inside the application's event loop
- ``baud_search``: Finding the baud rate of a bus: the search listens
- ``echo``: Adapters that echo what they send: recognised at start, removed by comparing octets
- ``line_runtime``: What every real-time driver does, however it waits: step the machine, follow the port
- ``port_latency``: What a port costs: how late the first octets after a transmission arrive
- ``rate``: The state of a port: its rate follows what its machine wants, and a lost one is opened again
- ``select_loop``: An event loop for the bus process: file descriptors, deadlines in nanoseconds, and nothing else
- ``select_runtime``: The plain driver: one machine on one port in a loop of its own, without asyncio
- ``timers``: Deadlines inside an event loop (a timerfd on Linux, the loop's own timer elsewhere)
"""
