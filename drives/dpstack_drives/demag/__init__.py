"""Demag Dedrive Compact with CM-PDP-24, ``demag-dedrive``: control by the DRIVECOM state machine (412 = 1)."""

from dpstack_drives.demag.profile import DRIVE

__all__ = ["DRIVE"]
