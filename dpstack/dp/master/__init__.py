"""The DP master: its mode, its cycle, and one slave handler a slave."""
