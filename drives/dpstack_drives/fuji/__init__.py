"""Fuji FRENIC-Multi with OPC-E1-PDP, ``fuji-frenic``: PROFIdrive V2 state machine."""

from dpstack_drives.fuji.profile import DRIVE

__all__ = ["DRIVE"]
