"""What a GSD file requires of its master and a configuration turns off: legal on the wire, and no use to the device."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from dpstack.dpv1.pdu.dpv1_status import ALARM_KEYWORDS, Dpv1
from dpstack.gsd.model import Device

_ON: Final = "leave dpv1 out, or say dpv1 = true"


def remarks(device: Device | None, dpv1: Dpv1 | None) -> Iterator[str]:
    """Texts for people, without the name of the slave; ``dpv1``: what is used of DP-V1, None: nothing."""
    if device is None:
        return
    said = device.dpv1
    if said.slave and dpv1 is None:
        if said.c1_read_write_required:
            yield f"dpv1 is off, but its GSD file says C1_Read_Write_required = 1: it counts on Read and Write; {_ON}"
        required = [f"{keyword}_required" for keyword in ALARM_KEYWORDS.values() if keyword in said.required]
        if required:
            yield f"dpv1 is off, but its GSD file says {' = 1, '.join(required)} = 1: it raises no alarms now; {_ON}"
    if dpv1 is not None and dpv1.extra_alarm_sap and not said.extra_alarm_sap:
        yield (
            "extra_alarm_sap = true, but its GSD file does not say Extra_Alarm_SAP_supp = 1: alarms are acknowledged "
            "at SAP 50, which it may not have; leave extra_alarm_sap out"
        )
    if device.isochronous.required:
        yield "its GSD file says Isochron_Mode_required = 1, and dpstack has no isochronous mode: it may not do without"
