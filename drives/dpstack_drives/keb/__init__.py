"""KEB COMBIVERT F5 with its PROFIBUS operator, ``keb-f5``: a profile of its own."""

from dpstack_drives.keb.profile import DRIVE

__all__ = ["DRIVE"]
