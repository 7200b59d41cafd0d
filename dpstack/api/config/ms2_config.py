"""What a GSD file says about class 2 connections."""

from __future__ import annotations

from dataclasses import dataclass

from dpstack.dpv1.pdu.ms2 import LEAST_INITIATE
from dpstack.dpv1.pdu.read_write import MAX_RECORD
from dpstack.gsd.model import Device


@dataclass(frozen=True, slots=True)
class Ms2Limits:
    """``supported``: C2_Read_Write_supp. ``response_ns`` (C2_Response_Timeout), ``channels`` (C2_Max_Count_Channels)
    and ``max_initiate_len`` (Max_Initiate_PDU_Length, octets) are 0 where they are not known; ``max_data_len``:
    C2_Max_Data_Len, 1..240."""

    supported: bool = True
    response_ns: int = 0
    max_data_len: int = MAX_RECORD
    channels: int = 0
    max_initiate_len: int = 0

    @classmethod
    def of(cls, device: Device | None) -> Ms2Limits:
        """Of the device's GSD file; without one nothing is known, and it may have them."""
        if device is None:
            return cls()
        dpv1, longest = device.dpv1, device.dpv1.max_initiate_pdu_length
        return cls(
            supported=dpv1.c2_read_write,
            response_ns=dpv1.c2_response_ns,
            max_data_len=min(dpv1.c2_max_data_len or MAX_RECORD, MAX_RECORD),
            channels=dpv1.c2_max_count_channels,
            max_initiate_len=max(LEAST_INITIATE, longest) if longest else 0,
        )
