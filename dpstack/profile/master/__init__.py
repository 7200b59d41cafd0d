"""Master side of a drive: state machine, orders, process data maps, comparison of settings.

- ``core``: Master side of one drive, called once a rotation: state machine, set point, orders, status events
- ``device_core``: Master side of a device that is no drive, called once a rotation: its orders, and the outputs that
  they make
- ``guarded_writes``: Writes to parameters that the plugin relies on: refused while the motor may turn, read again
- ``lookup``: Requests to a drive that depend on its inputs, sent in the background
- ``mapped_core``: Master side of a drive with process data maps: orders to read and write maps and values
- ``messages``: Numbers of the present faults and warnings by parameter: PROFIdrive's fault buffer, PNU 944, 945 and 947
- ``new_address``: A new station address that the drive got over its plugin
- ``settings``: Comparison of the settings that a plugin relies on with those in the drive
- ``several_drives``: Master side of a slave with several drives: one plugin that holds a core for each of them
"""
