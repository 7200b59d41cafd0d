"""The interface for applications: configuration, bus, slaves, drives.

- ``bus/``: The ``Bus`` of the public API: opening, plan, cycles, events, statistics, end
- ``commissioning/``: Commissioning: from the stations of a scan to the text of a configuration
- ``config/``: Configurations: a TOML file or a dict, checked key by key
- ``connectors/``: The connectors of a running bus, which publish its plant: made from tables, fed, ended
- ``control/``: Orders to running programs over a Unix socket with JSON lines
- ``fdl/``: FDL services for programs: requests to any station, service access points of one's own
- ``fdl_station/``: A station with the FDL services and without DP
- ``listen/``: Listening to a bus without sending: on an own port, or through the program that holds it
- ``lists/``: Parameter lists in files: dumped from a drive or device, loaded, compared
- ``pa/``: Process devices of PROFIBUS PA over the records of a slave: blocks, values in words, writes, dumps
- ``ppi/``: S7-200 over PPI for programs: the CPU behind FDL services
- ``recording/``: Files of a running bus: recordings of process data, logs of events, written by threads
- ``slave/``: ``Slave`` and ``Drive`` of the public API
- ``slave_side/``: Slaves in this program: the user's own, and simulated ones
- ``doctor``: Checks of this computer: adapters, permissions, latency, rates, real-time rights, and advice
- ``files``: Files: read up to a size limit, written atomically, never over somebody else's file
- ``gsd_folder``: The GSD files of a folder: found with limits, listed by ident number, read when they are needed
- ``gsd_info``: GSD files from disk, and their contents as plain data
- ``gsd_orders``: The GSD files of a folder by file name, ident number and order number, as an importer asks for them
- ``injected``: Events of people and scenarios that act on simulated slaves
- ``measure``: Measurement of an adapter without a bus: turn-around, rates made, marks of damaged octets
- ``refused_orders``: Orders from outside that were refused, as events of the bus: accounted for, and counted
- ``streams``: Event streams, waiters and ``on_event``: a slow reader never holds up the bus
- ``user_code``: Objects in modules of the user, by ``module:name``: functions of simulated slaves, slaves of one's own
"""
