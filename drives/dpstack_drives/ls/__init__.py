"""LS ELECTRIC LSLV-S100 with CPDP-S100, ``ls-s100``: PROFIdrive, LS Drive profile or plain words."""

from dpstack_drives.ls.profile import DRIVE

__all__ = ["DRIVE"]
