"""Commands below DP: services of the link layer.

- ``fdl``: ``dpstack fdl``: one FDL service by hand
- ``ppi``: ``dpstack ppi``: values, mode and clock of an S7-200
- ``station``: The FDL station of a command: it joins the ring on the port for as long as the command asks
"""
