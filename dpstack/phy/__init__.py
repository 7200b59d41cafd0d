"""UART timing: silence on the line, the gates built on it, and patience with ports."""
