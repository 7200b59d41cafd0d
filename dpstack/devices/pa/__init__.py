"""Device files of PROFIBUS PA devices: blocks in slots, their values with status, set points with status.

- ``configurations``: Configurations of a PA device: modules in slots by name, by identifier octets, and their values
- ``core``: Master side of a PA device: set points go out with a good status only while a value stands
- ``device``: The simulated PA device of a device file: the blocks in its slots, what they measure or move, its cyclic
  values
- ``examples``: The examples of a PA device's file: octets received and their values, set points and their octets
- ``layout``: Places of the values in the octets of a configuration: names, types, status, words
- ``model``: A device file of a PA device as data: modules, slots, bits, maker's parameters
- ``profile``: A device file of a PA device as a profile: configurations by modules or by identifier octets
- ``reader``: Device files of PA devices read and checked
"""
