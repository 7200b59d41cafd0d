"""The commands that only listen to a bus, or explain what was heard on it; none of them sends an octet.

- ``baud``: ``dpstack baud``: finds the baud rate by listening only
- ``decode``: ``dpstack decode``: explains every telegram of a capture, or of octets in hex, to the bit
"""
