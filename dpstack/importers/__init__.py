"""Importers: projects of other engineering tools as plants.

They read text and make the text of a configuration. A caller hands them the GSD files that it has.

- ``step7_cfg``: Reader of the hardware export of STEP 7 (.cfg): sections with keys, addresses and symbols
- ``step7_layout``: Places of the symbols of an exported slave in its process data: bits, words, numbers
- ``step7_plant``: From an export to a configuration: DP system, bus parameters, the file as text
- ``step7_slaves``: From an exported DP slave to its [[slave]] table, with and without a GSD file
"""
