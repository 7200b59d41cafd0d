"""What a drive plugin declares: words, states, parameters, telegrams.

- ``drive_type``: What a drive is on the bus: its ident number and telegrams
- ``drivecom_states``: The DRIVECOM state machine as data: words, commands, states and transitions
- ``jobs``: Orders of the application that take several cycles, written as generators that are resumed once a cycle
- ``param_errors``: The error numbers of PROFIdrive's parameter access and their texts
- ``param_listing``: The parameters of a drive as a list to be read from end to end: what a dump asks for
- ``param_store``: The parameters of a simulated drive: RAM and EEPROM values, data sets, a count of EEPROM writes
- ``params``: Drive parameters declared as data: number, type, scale, unit, limits
- ``process_data_map``: What stands in a drive's process data beside control word and set point: fields in their order
- ``profidrive_states``: The PROFIdrive state machine S1 to S5 as data, and its slave side
- ``states``: States of a drive by common names, decoded by mask and value; the words that lead to a wanted state
- ``status``: What a drive tells, decoded
- ``words``: Words of process data declared as data: named bits, and scaled fields with unit and range
"""
