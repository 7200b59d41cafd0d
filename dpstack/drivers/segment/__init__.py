"""Simulated RS-485 segment of ptys, for programs that open serial ports.

- ``hub``: A virtual RS-485 segment: ptys joined as one bus, which any program may open as serial ports
"""
