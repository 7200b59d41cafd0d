"""The master's end of a drive.

- ``core``: The master's end of one drive: runs once a rotation, walks the drive's state machine
- ``fault_lookup``: What a status word only announces (a fault, a warning) and the parameter channel names
- ``mapped_core``: A drive whose process data carry more than control word and set point, as its maps say
- ``motion``: The orders that move a drive, as jobs over a :class:`~dpstack.profile.master.core.DriveCore`
- ``param_orders``: The orders of the application that go over the parameter channel: one parameter
- ``settings``: Settings of a drive that its plugin relies on, compared with the drive's own when data exchange begins
"""
