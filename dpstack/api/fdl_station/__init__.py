"""A station with the FDL services and without DP.

- ``station``: ``open_fdl`` and ``FdlStation``
"""
