"""Declarations of a drive plugin: words, states, parameters, telegrams; orders and status of a drive.

- ``description``: Description of a device for people: what to set at it, its telegrams, words, messages and LEDs
- ``drive_type``: Type of a drive on the bus: ident number, telegrams, user parameters; its options
- ``drivecom_states``: The DRIVECOM state machine as data: words, commands, states and transitions
- ``jobs``: Jobs of the application that take several cycles, written as generators that are resumed once a cycle
- ``param_errors``: The error numbers of PROFIdrive's parameter access and their texts
- ``param_store``: The parameters of a simulated drive: RAM and EEPROM values, data sets, a count of EEPROM writes
- ``param_types``: Data types of parameters: width, sign, floats, fixed-point types of PROFIdrive; numbers in record 47
- ``params``: Drive parameters declared as data: number, type, scale, unit, limits; the list of them that a dump reads
- ``process_data_map``: Process data maps: the fields in a drive's inputs and outputs beside control word and set point
- ``profidrive_states``: The PROFIdrive state machine S1 to S5 as data, and its slave side
- ``states``: States of a drive by common names, decoded from the status word; control words that lead to a wanted state
- ``status``: Status of a drive, decoded from its inputs; plain JSON data of it
- ``words``: Words of process data declared as data: named bits, and scaled fields with unit and range
"""
