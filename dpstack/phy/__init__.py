"""UART timing: silence on the line, the gates built on it, and patience with ports.

- ``line``: The line as one station knows it: when it fell silent, and what may start when
- ``neighbours``: What a late port asks of the other masters on its bus, which know no slack
- ``noise``: Noise on a wire: bits inverted by chance. Seeded, so that a run can be repeated
- ``patience``: Patience by consequence: how much later than the wire's deadline a port may deliver
- ``uart``: The UART of a station: octets as levels on the line, and what a receiver at any rate makes of them
"""
