"""A bus as its user sees it: made from a configuration, opened, planned, watched, closed.

- ``bus``: The bus as an application sees it
- ``compose``: From a configuration to running parts: parameters, plan, master, station, and what keeps them running
- ``cycles``: The cycles of a bus as an application sees them: one picture of all inputs at a time, the latest wins
- ``driver_choice``: Which driver keeps a bus going: what is asked for, or for "auto" what was measured to be better
- ``events_json``: Every event an application may meet, and the JSON lines they become
- ``find_baud``: The baud rate of a bus, found by listening only
- ``open_bus``: The way to a bus: from a configuration file, or from arguments alone
- ``parts``: The parts of a bus, which are there once its baud rate is known
- ``plan_checks``: What the plan of a bus takes from the configuration beside the slaves
- ``remote_plugins``: Drive plugins of a bus that runs in a process of its own: named here, working there
- ``ring_entry``: Beside other masters: joining their ring, how long it may take, why it failed, and what they need
- ``scan``: The live list of a running bus, and of a port that nobody holds yet
- ``shutdown``: The end of a bus by its application: through cancellations and Ctrl-C
- ``statistics``: Counters and rotation times of a bus, as one picture
- ``streams``: Handing events to the application without ever letting a slow reader hold up the bus
- ``sync_freeze``: SYNC and FREEZE as an application sees them: orders that return when they have been sent
- ``temporary_master``: Visiting a bus for one errand: into its token ring at an address that nobody uses
- ``virtual``: Running an unmodified program in virtual time
"""
