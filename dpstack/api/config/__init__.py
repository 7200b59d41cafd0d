"""Configurations: a TOML file or a dict, checked key by key.

- ``bus``: The [bus] table of a configuration: the keys of the bus as a whole
- ``config``: The configuration file: TOML in, checked settings out
- ``dpv1``: The key ``dpv1`` of a [[slave]] table: DP-V1 on or off, what else DPV1_Status says, class 2 connections
- ``gsd_choice``: Choices made from a GSD file as a [[slave]] table that a configuration accepts
- ``gsd_slave``: A [[slave]] table that names a GSD file: its modules, parameters and what follows from them
- ``slave``: One [[slave]] table: its keys, read and checked, also those that change while the bus runs
- ``slave_source``: What a [[slave]] table stands on: a known drive, a GSD file, a drive as its maker's GSD file has it
- ``table``: Typed reading of a configuration table: every refusal is one line that says where, what, and what to do
- ``toml``: TOML: read behind limits, values by tomllib with the line of every key, which it does not tell
"""
