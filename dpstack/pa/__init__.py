"""PROFIBUS PA: process devices read as what they are.

Pure: octets in, meanings out. The services that carry the octets are MS1 and MS2 of DP-V1 (``dpstack.api.slave``).

- ``blocks``: Physical, function and transducer blocks: the block object and the parameters of each class
- ``datatypes``: The data types of block parameters: structures DS-32 to DS-68, their octets and their elements
- ``directory``: The directory of a device (device management): header, composite list and the places of the blocks
"""
