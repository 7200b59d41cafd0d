"""The records of the CPDP-S100: 47 at both ends (docs/drives/ls-s100.md#record-47), and I&M0.

PNUs are taken before addresses of the same number. Readings: a plain parameter with a subindex is error 4; a request
takes two scans.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dpstack.profile import NS_PER_MS, Clock, ParamKey, ParamSpec, record47
from dpstack_drives.ls import references
from dpstack_drives.ls import table as t
from dpstack_drives.ls.module import Module

SLOT: Final = 1
#: of class 2 (docs/drives/ls-s100.md#record-47); a reading: the manual gives no number
CONNECTIONS: Final = 2
#: at most 8 parameters of at most 8 elements a request, values only, one object
LIMITS: Final = record47.Limits(parameters=8, elements=8)
RULES: Final = record47.Rules(
    slots=frozenset({SLOT}),
    attributes=frozenset({record47.Attribute.VALUE}),
    limits=LIMITS,
    busy_ns=2 * t.SCAN_MS * NS_PER_MS,
)


class LsParameters(record47.ParameterModel):
    """What the module has, as record 47 asks for it.

    ``refusal``: the error that an access (``write`` or not) ends with by an order from outside.
    """

    def __init__(self, module: Module, refusal: Callable[..., int | None]) -> None:
        self._module = module
        self._refusal = refusal

    def read(self, address: record47.Address) -> record47.Result:
        if (number := self._refusal(write=False)) is not None:
            return record47.ErrorValue(number)
        spec = self._wanted(address)
        if isinstance(spec, record47.ErrorValue):
            return spec
        first, count = address.subindex, max(address.elements, 1)
        words = (self._module.value(spec, ind) & 0xFFFF for ind in range(first, first + count))
        return record47.Values(record47.UNSIGNED16, tuple(words))

    def change(self, address: record47.Address, values: record47.Values) -> record47.ErrorValue | None:
        """One word: no array can be written."""
        if (number := self._refusal(write=True)) is not None:
            return record47.ErrorValue(number)
        spec = self._wanted(address)
        if isinstance(spec, record47.ErrorValue):
            return spec
        raw = values.raws[0]
        if values.format not in (record47.UNSIGNED16, record47.WORD) or not isinstance(raw, int):
            return record47.ErrorValue(0x05)
        error = self._module.write(spec, raw)
        return None if error is None else record47.ErrorValue(error)

    def _wanted(self, address: record47.Address) -> ParamSpec | record47.ErrorValue:
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


def server(module: Module, refusal: Callable[..., int | None]) -> record47.ParameterServer:
    """The drive's end."""
    return record47.ParameterServer(LsParameters(module, refusal), RULES)


def identification() -> record47.Im0:
    """I&M0 (docs/drives/ls-s100.md#im). Order id, serial number and versions are made up."""
    return record47.Im0(
        manufacturer_id=t.DEVICE_ID[0],
        order_id="CPDP-S100",
        serial_number="00000001",
        hardware_revision=1,
        software_revision="V3.0.0",
        profile_id=0x3A00,
        supported=1,
    )


def served(parameters: record47.ParameterServer, clock: Callable[[int], int]) -> record47.ImRecords:
    """All records of the drive: record 47 in slot 1, I&M0 in every slot."""
    return record47.ImRecords((identification(),), record47.TimedRecords(parameters, clock))


def access(
    drive: str, queue: record47.RecordQueue, clock: Clock, advise: Callable[[int], None]
) -> record47.AcyclicAccess:
    """The master's end. ``advise`` is called with the address of a drive parameter."""

    def placed(key: ParamKey) -> record47.Place:
        ref, where = references.resolve(key, drive)
        if where is not None:
            advise(where)
            return record47.Place(record47.Address(where), ref.spec, ref.label, ref.pnu, format=record47.UNSIGNED16)
        address = record47.Address(ref.pnu, ref.ind, 1 if ref.array else 0)
        return record47.Place(address, ref.spec, ref.label, ref.pnu, format=record47.UNSIGNED16)

    client = record47.ParameterClient(SLOT, limits=LIMITS, references=record47.PLUGIN)
    return record47.AcyclicAccess(client, queue, placed, clock)
