"""A bus in a process of its own, and its application at the other end of a socket.

- ``__main__``: ``python -m dpstack.drivers.process``: runs ``program``
- ``bus_process``: Main object of the bus process: machines and driver of one bus, orders from the application, news to
it
- ``channel``: The application's end of the socket: start and end of the bus process, orders and their answers, news
- ``client``: The process driver, in the application: runtime and snapshots of a bus in a process of its own
- ``early_start``: Start of a bus process, if possible before its configuration is known
- ``messages``: Messages between bus process and application: JSON with a length in front; socket buffers of both ends
- ``plugins``: Drive plugins by name (``package.module:name``): a bus process imports them, because it cannot receive
  objects
- ``program``: The bus process: ``python -m dpstack.drivers.process``; started by ``early_start``
- ``shared_image``: The process image in memory that two processes share: whole pictures, never torn
"""
