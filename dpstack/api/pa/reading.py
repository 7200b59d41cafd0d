"""One reading of a device: each record is read once, with the unit and the coding that its words need."""

from __future__ import annotations

from collections.abc import Awaitable, Mapping
from typing import Final, Protocol

from dpstack.api.pa.values import Meaning, PaValue, value_of
from dpstack.errors import AcyclicError, PduError
from dpstack.pa.blocks import Parameter
from dpstack.pa.datatypes import ParameterValue, parse_value
from dpstack.pa.parameters import Target, fixed_unit, unit_target
from dpstack.pa.units import unit_name
from dpstack.pa.walk import Block, Layout
from dpstack.pa.words import is_condensed
from dpstack.plant.status_octet import CLASSIC, CONDENSED

#: data types with a status octet
_WITH_STATUS: Final = ("value", "value_d", "simulate", "simulate_d")


class RecordReader(Protocol):
    """Reads all octets of a record: slot, index, time-out in seconds."""

    def __call__(self, slot: int, index: int, timeout: float | None, /) -> Awaitable[bytes]: ...


class Reading:
    """The records of a device during one order. ``extension``: texts of DIAGNOSIS_EXTENSION; ``timeout``: of each
    read."""

    def __init__(self, layout: Layout, read: RecordReader, extension: Mapping[int, str], timeout: float | None) -> None:
        self.layout = layout
        self._read = read
        #: texts of the bits of DIAGNOSIS_EXTENSION, from 1
        self.extension = extension
        self._timeout = timeout
        self._known: dict[tuple[int, int], bytes | AcyclicError] = {}
        self._coding: str | None = None

    async def octets(self, slot: int, index: int) -> bytes:
        """The octets of a record. Raises as ``read``; a refusal too is remembered."""
        found = self._known.get((slot, index))
        if found is None:
            try:
                found = await self._read(slot, index, self._timeout)
            except AcyclicError as error:
                found = error
            self._known[slot, index] = found
        if isinstance(found, AcyclicError):
            raise found
        return found

    async def value(self, target: Target) -> PaValue:
        """The parameter with its unit. Raises AcyclicError."""
        octets = await self.octets(target.slot, target.index)
        return value_of(target, octets, await self.meaning(target), await self.unit(target))

    async def meaning(self, target: Target) -> Meaning:
        """The facts that the words of ``target`` need."""
        coding = await self._coding_now() if target.kind in _WITH_STATUS else CLASSIC
        return Meaning(self.layout, coding, self.extension)

    async def _coding_now(self) -> str:
        """The coding of the status octets by FEATURE, else by COND_STATUS_DIAG, else the classic one."""
        if self._coding is None:
            physical, condensed = self.layout.physical, None
            if physical is not None:
                condensed = is_condensed(await self.raw(physical, "feature") or b"")
                if condensed is None:
                    condensed = await self.number(physical, "cond_status_diag") == 1
            self._coding = CONDENSED if condensed else CLASSIC
        return self._coding

    async def unit(self, target: Target) -> str:
        """The unit of ``target``; empty without one."""
        if fixed := fixed_unit(target):
            return fixed
        channel = None
        if target.block is not None and target.parameter == "pv_scale" and target.block.short == "AI":
            channel = await self.number(target.block, "channel")
        place = unit_target(self.layout, target, None if channel is None else int(channel))
        if place is None or place.block is None or target.element in ("status", "decimals", "unit", "enabled"):
            return ""
        found = await self._parsed(place.block, place.parameter)
        if isinstance(found, Mapping):
            found = found.get(place.element or "")
        return unit_name(found) if isinstance(found, int) else ""

    async def raw(self, block: Block, name: str) -> bytes | None:
        """The octets of a parameter of the profile; None if the device refuses it."""
        one = block.kind.parameters.get(name)
        if one is None or not _fits(block, one):
            return None
        try:
            return await self.octets(block.slot, block.index + one.relative)
        except AcyclicError:
            return None

    async def _parsed(self, block: Block, name: str) -> ParameterValue | None:
        octets = await self.raw(block, name)
        if octets is None:
            return None
        try:
            return parse_value(block.kind.parameters[name].kind, octets)
        except PduError:
            return None

    async def number(self, block: Block, name: str) -> int | float | None:
        """A number of the profile; None if the device refuses it, or sends something else."""
        found = await self._parsed(block, name)
        return found if isinstance(found, int | float) else None

    async def whole(self, block: Block, name: str) -> int | None:
        """A whole number of the profile; None as :meth:`number`."""
        found = await self._parsed(block, name)
        return found if isinstance(found, int) else None

    async def element(self, block: Block, name: str, element: str) -> int | None:
        """An element of a structure of the profile; None as :meth:`number`."""
        found = await self._parsed(block, name)
        inside = found.get(element) if isinstance(found, Mapping) else None
        return inside if isinstance(inside, int) else None

    async def text(self, block: Block, name: str) -> str:
        """A text of the profile; empty if the device refuses it."""
        found = await self._parsed(block, name)
        return found if isinstance(found, str) else ""


def _fits(block: Block, one: Parameter) -> bool:
    return block.index + one.relative <= 0xFF
