"""Lists in files: parameters dumped from a drive or device, loaded, compared; the I/O list of a configuration.

- ``io_list``: The I/O list of a configuration: a row for each named value and each channel without a name, as CSV
- ``io_list_reader``: An I/O list that people have edited, taken back into the text of its configuration
- ``list_file``: File format of parameter lists: TOML, one line an entry
- ``parameter_list``: ``ParameterList``: the parameters of a drive, dumped into a file and compared with it
- ``record_list``: ``RecordList``: all parameters that a device lists (record 47, 980 to 989)
"""
