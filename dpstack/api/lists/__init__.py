"""Parameter lists in files: dumped from a drive or device, loaded, compared.

- ``list_file``: File format of parameter lists: TOML, one line an entry
- ``parameter_list``: ``ParameterList``: the parameters of a drive, dumped into a file and compared with it
- ``record_list``: ``RecordList``: all parameters that a device lists (record 47, 980 to 989)
"""
