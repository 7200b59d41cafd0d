"""Configurations: a TOML file or a dict, checked key by key.

- ``broadcast``: The links between the slaves of a configuration (data exchange broadcast): publishers, filters, checks
- ``bus``: The [bus] table: keys of the whole bus
- ``channel_names``: The slots of a slave, and names for their channels, as lines of a configuration
- ``config``: ``Config``: configuration files, read and checked
- ``connectors``: The tables of the connectors that publish a plant
- ``cpu``: The entries of ``ppi``: S7-200 CPUs of a plant, with names for values in their memory
- ``device_draft``: A first device file, written from a GSD file
- ``dpv1``: The table [slave.dpv1]: DPV1_Status, alarms, class 2 connections
- ``drive_source``: A [[slave]] table with a drive, alone or with its maker's GSD file
- ``drives_source``: A [[slave]] table with several drives: `drives = [...]`, an axis each
- ``field_names``: The keys ``inputs`` and ``outputs`` of a [[slave]] table: names for its process data
- ``gsd_choice``: A [[slave]] table from the modules and parameters chosen in a GSD file
- ``gsd_source``: A [[slave]] table with a GSD file: modules, user parameters, limits
- ``simulate``: The table [slave.simulate]: inputs of a simulated slave from a recording or from a function
- ``slave``: The [[slave]] table: keys, checks, changes while the bus runs
- ``slave_source``: The base of a [[slave]] table without drive and GSD file; keys and types of the others
- ``subscribes``: The key ``subscribes`` of [[slave]]: values that a slave takes from other slaves
- ``toml_edit``: Changes of single keys in the text of a TOML file, whose other lines stay as they are
"""
