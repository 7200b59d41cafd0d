"""Slaves served: user slaves, simulated ones, a whole virtual bench."""
