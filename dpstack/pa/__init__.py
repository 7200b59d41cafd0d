"""PROFIBUS PA: process devices read as what they are.

Pure: octets in, meanings out. The services that carry the octets are MS1 and MS2 of DP-V1 (``dpstack.api.slave``).

- ``simulated/``: Simulated process devices: their blocks, their directory, their faults, and the DP slave around them
- ``blocks``: Physical, function and transducer blocks: the block object and the parameters of each class
- ``datatypes``: The data types of block parameters: structures DS-32 to DS-68, their octets and their elements
- ``diagnosis``: Diagnosis of a PROFIBUS PA device in words: DIAGNOSIS, its extension, CHECKBACK of a valve
- ``directory``: The directory of a device (device management): header, composite list and the places of the blocks
- ``parameters``: Parameters of a device by name: ``ai1.pv_scale``, ``ai1.pv_scale.eu_0``, ``tb1.lower_range``, or
  ``1:110``
- ``units``: Unit codes of PROFIBUS PA, from the parameter's number to symbol and name, and back
- ``walk``: The blocks of a device, found by its directory: in slot 1 or 0, in each convention of the field, or without
  one
- ``words``: Codes of PROFIBUS PA parameters in words: modes, alarms, features, makers, and the enumerations of the
  blocks
"""
