"""A station with the FDL services and without DP.

- ``station``: ``open_fdl`` and ``FdlStation``; ``open_ppi``: an S7-200, and the station of its own that asks it
"""
