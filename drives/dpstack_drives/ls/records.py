"""The records of the CPDP-S100: 47 as the simulated drive has it (docs/reference/drives/ls-s100.md#record-47), and
I&M0.

PNUs are taken before addresses of the same number. Readings: a plain parameter with a subindex is error 4; a request
takes two scans.
"""

from __future__ import annotations

from typing import Final

from dpstack.profile import NS_PER_MS, ParamSpec, record47
from dpstack_drives.ls import table as t
from dpstack_drives.ls.module import Module

SLOT: Final = 1
#: of class 2 (docs/reference/drives/ls-s100.md#record-47); a reading: the manual gives no number
CONNECTIONS: Final = 2
#: at most 8 parameters of at most 8 elements a request, values only, one object
LIMITS: Final = record47.Limits(parameters=8, elements=8)
RULES: Final = record47.Rules(
    slots=frozenset({SLOT}),
    attributes=frozenset({record47.Attribute.VALUE}),
    limits=LIMITS,
    busy_ns=round(2 * t.FILE.scan_ms * NS_PER_MS),
)


class LsParameters(record47.ParameterModel):
    """The parameters of the module over record 47."""

    def __init__(self, module: Module) -> None:
        self._module = module

    def read(self, address: record47.Address) -> record47.Result:
        spec = self._wanted(address, write=False)
        if isinstance(spec, record47.ErrorValue):
            return spec
        first, count = address.subindex, max(address.elements, 1)
        words = (self._module.value(spec, ind) & 0xFFFF for ind in range(first, first + count))
        return record47.Values(record47.UNSIGNED16, tuple(words))

    def change(self, address: record47.Address, values: record47.Values) -> record47.ErrorValue | None:
        """Write a plain parameter of one word; arrays cannot be written."""
        spec = self._wanted(address, write=True)
        if isinstance(spec, record47.ErrorValue):
            return spec
        raw = values.raws[0]
        if values.format not in (record47.UNSIGNED16, record47.WORD) or not isinstance(raw, int):
            return record47.ErrorValue(0x05)
        error = self._module.write(spec, raw)
        return None if error is None else record47.ErrorValue(error)

    def _wanted(self, address: record47.Address, *, write: bool) -> ParamSpec | record47.ErrorValue:
        if (number := self._module.device.refusal(write=write)) is not None:
            return record47.ErrorValue(number)
        spec = t.PARAMETERS.get(address.pnu) if address.pnu > 0xFF else None
        spec = t.spec_at(address.pnu) if spec is None else spec
        if spec is None:
            return record47.ErrorValue(0x00)
        size = t.ARRAYS.get(address.pnu)
        if size is None:
            if address.elements > 1:
                return record47.ErrorValue(0x16)
            return record47.ErrorValue(0x04) if address.subindex else spec
        end = address.subindex + max(address.elements, 1)
        return spec if end <= size else record47.ErrorValue(0x03, max(address.subindex, size))


#: docs/reference/drives/ls-s100.md#im; order id, serial number and versions are made up
IDENTIFICATION: Final = record47.Im0(
    manufacturer_id=t.DEVICE_ID[0],
    order_id="CPDP-S100",
    serial_number="00000001",
    hardware_revision=1,
    software_revision="V3.0.0",
    profile_id=0x3A00,
    supported=1,
)
