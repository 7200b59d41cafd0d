"""The master's end of a drive.

- ``core``: The master's end of one drive: runs once a rotation, walks the drive's state machine
- ``mapped_core``: A drive whose process data carry more than control word and set point, as its maps say
- ``settings``: Settings of a drive that its plugin relies on, compared with the drive's own when data exchange begins
"""
