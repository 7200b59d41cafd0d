"""Parameter lists in files: dumped from a drive or device, loaded, compared.

- ``dump_compare``: Dump and comparison of all parameters of a drive
- ``list_file``: File format of parameter lists: TOML, one line an entry
- ``parameter_list``: ``ParameterList``: the parameters of a drive
- ``record_list``: ``RecordList``: all parameters that a device lists (record 47, 980 to 989)
"""
