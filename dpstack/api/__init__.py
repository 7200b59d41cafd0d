"""The interface for applications: configuration, bus, slaves, drives.

- ``bus/``: A bus as its user sees it: made from a configuration, opened, planned, watched, closed
- ``config/``: Configurations: a TOML file or a dict, checked key by key
- ``control/``: Talking to running programs: a Unix socket with JSON lines
- ``lists/``: Lists of parameters in files: written from a drive, compared, loaded
- ``server/``: Slaves served: user slaves, simulated ones, a whole virtual bench
- ``slave/``: A slave and a drive of a bus as their user sees them
- ``doctor``: Is this computer fit for a bus: adapters, permissions, latency, rates, real-time rights
- ``files``: Ordinary files: read with a limit, written whole or not at all and never over a file of somebody else
- ``gsd_info``: GSD files from disk, and what they say as plain data
- ``streams``: Handing events to the application without ever letting a slow reader hold up the bus
"""
