"""Device files: any device as a TOML file, on the bases PROFIdrive, DRIVECOM, bits, encoder.

- ``description``: The commissioning sheet of a device file
- ``drive_core``: Master side of a drive that a device file describes
- ``drive_device``: The simulated drive of a device file
- ``finding``: Drives by name or path: plugins of packages, and device files in folders
- ``keys``: The keys of a device file: names, types and limits
- ``machines``: State machines of simulated drives
- ``maps``: The maps of a device file: fields of the process data, and the parameters that say which
- ``model``: A device file as data
- ``profiles``: A device file as a drive profile
- ``reader``: Device files read and checked, every mistake by line
"""
