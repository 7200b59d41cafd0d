"""Commands below DP: services of the link layer.

- ``fdl``: ``dpstack fdl``: one FDL service by hand
"""
