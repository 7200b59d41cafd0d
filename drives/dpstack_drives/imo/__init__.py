"""IMO HD2 with its HD2-E-PDP card, ``imo-hd2``: codes instead of command bits, process data chosen by P15."""

from dpstack_drives.imo.profile import DRIVE

__all__ = ["DRIVE"]
