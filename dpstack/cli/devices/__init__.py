"""The commands about kinds of drives and devices, and the files that describe them.

- ``check``: ``dpstack device check``: the mistakes of a device file, its examples, its drive in the simulation
- ``device``: ``dpstack device``: device files checked, shown, listed and begun
- ``drives``: ``dpstack drives``: the drives and devices that are known here, and the packages that bring them
- ``new``: ``dpstack device new``: a first device file from a GSD file
- ``show``: ``dpstack device list`` and ``show``: device files as tables and JSON
"""
