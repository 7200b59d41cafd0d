"""The records of the CPDP-S100: 47 at both ends (row L8; manual 6.2.2), a subset, and I&M0 (L10; 8).

PNUs are taken before addresses of the same number. Readings: a plain parameter with a subindex is error 4; a request
takes two scans.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dpstack.profile import NS_PER_MS, ParamKey, ParamSpec, acyclic
from dpstack_drives.ls import references
from dpstack_drives.ls import table as t
from dpstack_drives.ls.module import Module

SLOT: Final = 1
#: of class 2 (row L8); a reading: the manual gives no number
CONNECTIONS: Final = 2
#: at most 8 parameters of at most 8 elements a request, values only, one object
LIMITS: Final = acyclic.Limits(parameters=8, elements=8)
RULES: Final = acyclic.Rules(
    slots=frozenset({SLOT}),
    attributes=frozenset({acyclic.Attribute.VALUE}),
    limits=LIMITS,
    busy_ns=2 * t.SCAN_MS * NS_PER_MS,
)


class LsParameters:
    """What the module has, as record 47 asks for it.

    ``refusal``: the error that an access (``write`` or not) ends with by an order from outside.
    """

    def __init__(self, module: Module, refusal: Callable[..., int | None]) -> None:
        self._module = module
        self._refusal = refusal

    def read(self, address: acyclic.Address) -> acyclic.Result:
        """Words."""
        if (number := self._refusal(write=False)) is not None:
            return acyclic.ErrorValue(number)
        spec = self._wanted(address)
        if isinstance(spec, acyclic.ErrorValue):
            return spec
        first, count = address.subindex, max(address.elements, 1)
        words = (self._module.value(spec, ind) & 0xFFFF for ind in range(first, first + count))
        return acyclic.Values(acyclic.UNSIGNED16, tuple(words))

    def change(self, address: acyclic.Address, values: acyclic.Values) -> acyclic.ErrorValue | None:
        """One word: no array can be written."""
        if (number := self._refusal(write=True)) is not None:
            return acyclic.ErrorValue(number)
        spec = self._wanted(address)
        if isinstance(spec, acyclic.ErrorValue):
            return spec
        raw = values.raws[0]
        if values.format not in (acyclic.UNSIGNED16, acyclic.WORD) or not isinstance(raw, int):
            return acyclic.ErrorValue(0x05)
        error = self._module.write(spec, raw)
        return None if error is None else acyclic.ErrorValue(error)

    def describe(self, address: acyclic.Address) -> acyclic.Result:
        """None has one."""
        return acyclic.ErrorValue(0x09)

    def text(self, address: acyclic.Address) -> acyclic.Result:
        """None has one."""
        return acyclic.ErrorValue(0x0F)

    def _wanted(self, address: acyclic.Address) -> ParamSpec | acyclic.ErrorValue:
        spec = t.PARAMETERS.get(address.pnu) if address.pnu > 0xFF else None
        spec = t.spec_at(address.pnu) if spec is None else spec
        if spec is None:
            return acyclic.ErrorValue(0x00)
        size = t.ARRAYS.get(address.pnu)
        if size is None:
            if address.elements > 1:
                return acyclic.ErrorValue(0x16)
            return acyclic.ErrorValue(0x04) if address.subindex else spec
        end = address.subindex + max(address.elements, 1)
        return spec if end <= size else acyclic.ErrorValue(0x03, max(address.subindex, size))


def server(module: Module, refusal: Callable[..., int | None]) -> acyclic.ParameterServer:
    """The drive's end."""
    return acyclic.ParameterServer(LsParameters(module, refusal), RULES)


def identification() -> acyclic.Im0:
    """I&M0 (row L10; manual 8). Order id, serial number and versions are made up."""
    return acyclic.Im0(
        manufacturer_id=t.DEVICE_ID[0],
        order_id="CPDP-S100",
        serial_number="00000001",
        hardware_revision=1,
        software_revision="V3.0.0",
        profile_id=0x3A00,
        supported=1,
    )


def served(parameters: acyclic.ParameterServer, clock: Callable[[int], int]) -> acyclic.ImRecords:
    """All records of the drive: record 47 in slot 1, I&M0 in every slot."""
    return acyclic.ImRecords((identification(),), acyclic.TimedRecords(parameters, clock))


def access(
    drive: str, queue: acyclic.RecordQueue, clock: Callable[[], int], advise: Callable[[int], None]
) -> acyclic.AcyclicAccess:
    """The master's end. ``advise`` is told the address of a drive parameter."""

    def placed(key: ParamKey) -> acyclic.Place:
        ref, where = references.resolve(key, drive)
        if where is not None:
            advise(where)
            return acyclic.Place(acyclic.Address(where), ref.spec, ref.label, ref.pnu, format=acyclic.UNSIGNED16)
        address = acyclic.Address(ref.pnu, ref.ind, 1 if ref.array else 0)
        return acyclic.Place(address, ref.spec, ref.label, ref.pnu, format=acyclic.UNSIGNED16)

    client = acyclic.ParameterClient(SLOT, limits=LIMITS, references=acyclic.PLUGIN)
    return acyclic.AcyclicAccess(client, queue, placed, clock)
