"""Process devices of PROFIBUS PA over the records of a slave: blocks, values in words, writes, dumps.

- ``device``: ``PaDevice``: the blocks of a process device, their parameters read, written, dumped and compared
- ``orders``: The orders of ``dpstack pa`` with their answers in JSON
- ``overview``: A device at a glance: identity, diagnosis, blocks with their values
- ``pa_list``: ``PaList``: all parameters of a device, in a file and compared with another device
- ``reading``: One reading of a device: each record is read once, with the unit and the coding that its words need
- ``values``: Parameters of a device with value, unit, quality and words; values as users type them
"""
