"""Commands below DP: services of the link layer.

- ``fdl``: ``dpstack fdl``: one FDL service by hand
- ``ppi``: ``dpstack ppi``: values, mode and clock of an S7-200
"""
