"""Lists of parameters in files: written from a drive, compared, loaded.

- ``dump_compare``: Reading all parameters of a drive, into a file and against a file; the cyclic data go on meanwhile
- ``list_file``: A list of parameters as a file: TOML, a head and one line an entry, read with every doubt named
- ``parameter_list``: Parameters of a drive in a file: TOML, one line a parameter
- ``record_list``: All parameters of a device's own list (record 47, 980 to 989) in a file: TOML, a line a parameter
"""
