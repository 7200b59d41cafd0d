"""A segment made of ptys: stations of other programs on one simulated line.

- ``hub``: A virtual RS-485 segment: ptys joined as one bus, which any program may open as serial ports
- ``station``: One station of a segment: its pty, its receiver, and the truth about what it sent
"""
