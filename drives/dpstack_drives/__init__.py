"""Drives that dpstack knows: each a plugin (the master's end) and a simulated drive over one table."""
