"""Simulated process devices: their blocks, their directory, their faults, and the DP slave around them.

- ``block``: A block of a simulated device: its parameters as octets, and the rules of reading and writing
- ``conversion``: Factors between the units of one quantity, for parameters that follow a change of unit
- ``device``: The model of a simulated process device: its blocks by slot and index, its process, its clock
- ``directory_records``: The records of a directory, in every convention of the field and with every lie of the tests
- ``faults``: Faults of a simulated process device, with their status octets, DIAGNOSIS and DIAGNOSIS_EXTENSION
- ``inputs``: Function blocks of transmitters: analogue input, discrete input, totaliser
- ``kinds``: The kinds of simulated process devices: the blocks that each has, and the process around it
- ``outputs``: Function blocks of actuators: analogue output and discrete output
- ``physical``: The physical block: identity, write protection, reset, DIAGNOSIS, classic or condensed
- ``slave``: The simulated process device as a DP slave: MS1, MS2, cyclic data, DIAGNOSIS in its Slave_Diag
- ``tables``: Linearisation: characteristic curves and the table that a master loads point by point
- ``transducers``: Transducer blocks: pressure, temperature, level, flow, actuator, plain ones
"""

from typing import Final

#: the option of a simulated device that says what it is
KIND: Final = "kind"
#: the kind with as many blocks as a directory may have
MANY: Final = "255 blocks"
#: the kinds of devices by name, see ``kinds``
KINDS: Final = ("pressure", "temperature", "level", "flow", "positioner", "valve", "values", MANY)
