"""A station with the FDL services and without DP.

- ``ppi``: ``open_ppi``: an S7-200, and the station of its own that asks it
- ``station``: ``open_fdl`` and ``FdlStation``
"""
