"""A bus as its user sees it: made from a configuration, opened, planned, watched, closed.

- ``bus``: The bus as an application sees it
- ``compose``: From a configuration to running parts: parameters, plan, master, station, and what keeps them running
- ``config_from_scan``: A configuration made of what a live list found: a start to be completed
- ``cycles``: The cycles of a bus as an application sees them: one picture of all inputs at a time, the latest wins
- ``driver_choice``: Which driver keeps a bus going: what is asked for, or for "auto" what was measured to be better
- ``events_json``: Every event an application may meet, and the JSON lines they become
- ``find_baud``: The baud rate of a bus, found by listening only
- ``open_bus``: The way to a bus: from a configuration file, or from arguments alone
- ``parts``: What a bus consists of once its baud rate is known: its parts, its slaves, orders to it, waiting for it
- ``plan_checks``: What the plan of a bus takes from the configuration beside the slaves
- ``remote_plugins``: Drive plugins of a bus that runs in a process of its own: named here, working there
- ``ring_entry``: Beside other masters: joining their ring, how long it may take, why it failed, and what they need
- ``scan``: The live list of a running bus
- ``shutdown``: The end of a bus by its application: through cancellations and Ctrl-C
- ``statistics``: Counters and rotation times of a bus, as one picture
- ``sync_freeze``: SYNC and FREEZE as an application sees them: orders that return when they have been sent
- ``temporary_master``: A master for one errand, at an address that nobody uses; the live list of a port
- ``virtual``: Running an unmodified program in virtual time
"""
