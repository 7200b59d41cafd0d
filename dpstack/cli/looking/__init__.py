"""Commands that look at a plant: on a page, on the screen, in words.

- ``diag``: ``dpstack diag``: diagnosis, configuration, inputs and outputs of any station
- ``fleet``: ``dpstack fleet``: all segments of a broker
- ``fleet_view``: Its table on a terminal, and its lines elsewhere
- ``gsd_diff``: ``dpstack gsd diff``: two GSD files compared
- ``gsd_find``: ``dpstack gsd find``: GSD files by words
- ``hart``: ``dpstack hart``: a HART transmitter behind remote I/O
- ``import``: ``dpstack import``: a configuration from the project of another engineering tool
- ``names``: ``dpstack names``: the I/O list of a configuration
- ``pa``: ``dpstack pa``: a process device of PROFIBUS PA
- ``plot``: ``dpstack plot``: a recording drawn
- ``sheet``: ``dpstack sheet``: commissioning sheets of the drives and devices of a configuration
- ``web``: ``dpstack web``: the page in the browser
- ``why``: ``dpstack why``: why a slave is not in data exchange
"""
