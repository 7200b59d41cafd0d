"""A bus in a process of its own, and its application at the other end of a socket.

- ``__main__``: The bus process: ``python -m dpstack.drivers.process``; started by ``client``
- ``channel``: The channel between an application and its bus process: one process, one socket, orders and answers, news
- ``client``: The process driver: the bus runs in a process of its own, and the application's is told
- ``client_errors``: Why a bus process is no more, and what that means at the slaves; for people
- ``messages``: What a bus process and its parent say to each other: JSON with a length in front, never pickle
- ``order_types``: The orders that the machines of a bus know, all of them plain data
- ``outbox``: Messages on their way to the other process, which may have stopped reading
- ``plugins``: Cyclic units by name, for a process that is handed no objects
- ``server``: The bus process from the inside: machines and driver of one bus, and what is told to the application
- ``shared_image``: The process image in memory that two processes share: whole pictures, never torn
"""
