"""Units of named values, read from the function blocks of a PROFIBUS PA device.

They are read once the slave is in data exchange, when it returns, and when the counter of changes of a block (ST_REV)
has another value. A read that fails changes nothing on the bus, and is reported once.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from msgspec import structs

from dpstack.api.config.slave import SlaveConfig
from dpstack.api.slave.class2 import Class2
from dpstack.api.slave.records import RecordAccess
from dpstack.api.slave.slave import Slave
from dpstack.dp.field_map import FieldMap
from dpstack.errors import AcyclicError, DpError, SlaveError
from dpstack.text import octets_text, printable, shortened

if TYPE_CHECKING:
    from dpstack.profile.drive_profile import UnitPlace

#: seconds between two looks at ST_REV: a connection of class 2 is open for the look only, as devices have few of them
LOOK_S: Final = 60.0
#: octets of ST_REV and of the code of a unit
_WORD: Final = 2
#: code of a unit that stands as text in a parameter of its own
_TEXTUAL: Final = 1995
#: characters of a unit, as in a plant file
_LONGEST: Final = 20


class BlockUnits:
    """Reads the units of ``slave`` over MS1 if its master has it, else over class 2. ``tell``: takes a remark."""

    def __init__(self, slave: Slave, class2: Class2, tell: Callable[[str], None]) -> None:
        self._slave = slave
        self._class2 = class2
        self._tell = tell
        profile = slave.config.device_profile
        assert profile is not None
        assert profile.units is not None
        telegram = profile.telegram(slave.config.telegram).name
        self._places = profile.units(telegram, slave.config.options)
        self._names = _free_names(slave.config)
        #: ST_REV of the blocks when their units were read
        self._revisions: dict[UnitPlace, int] = {}
        self._reported = False
        self._returned = asyncio.Event()
        #: reads and looks from the first data exchange on; None before
        self.task: asyncio.Task[None] | None = None

    def on_data_exchange(self) -> None:
        """The slave has come into data exchange: read everything, as it may be another device."""
        self._revisions.clear()
        self._returned.set()
        if self.task is None and self._places:
            self.task = asyncio.get_running_loop().create_task(self._watch(), name=f"units of {self._slave.name}")

    def end(self) -> None:
        """The bus ends, or the slave is removed."""
        if self.task is not None:
            self.task.cancel()

    async def _watch(self) -> None:
        while True:
            self._returned.clear()
            try:
                await self._read()
            except DpError as error:
                self._report(str(error))
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(LOOK_S):
                    await self._returned.wait()

    async def _read(self) -> None:
        """Read the units of the blocks whose ST_REV is not the known one. Raises DpError."""
        if not self._slave.ready_now:  # the next data exchange begins it anew
            with contextlib.suppress(DpError):
                await self._slave.ready(LOOK_S)
            if not self._slave.ready_now:
                return
        async with self._records() as records:
            units: dict[str, str] = {}
            for place in self._places:
                try:
                    revision = await _word(records, place.slot, place.revision, 0, _WORD)
                    if self._revisions.get(place) == revision:
                        continue
                    unit = await self._unit_of(records, place)
                except (AcyclicError, _WrongLengthError) as error:  # this block refuses: the others may not
                    self._report(str(error))
                    continue
                self._revisions[place] = revision
                units |= {name: unit for name in place.names if name in self._names}
        known = self._slave.config.input_fields.units | self._slave.config.output_fields.units
        if any(known.get(name, "") != unit for name, unit in units.items()):
            self._slave.config = with_units(self._slave.config, units)

    @contextlib.asynccontextmanager
    async def _records(self) -> AsyncIterator[RecordAccess]:
        if self._slave.setup.dpv1 is not None:
            yield self._slave
            return
        async with self._class2.connect(self._slave) as connection:
            yield connection

    async def _unit_of(self, records: RecordAccess, place: UnitPlace) -> str:
        from dpstack.pa.units import unit_name  # here, as most buses have no PA devices

        code = await _word(records, place.slot, place.record, place.at, place.octets)
        if code != _TEXTUAL or place.text is None:
            return unit_name(code)
        octets = await records.read(place.slot, place.text)
        text = printable(octets.rstrip(b"\0 ").decode("latin-1")).translate({ord("["): "(", ord("]"): ")"})
        return shortened(text, _LONGEST)

    def _report(self, why: str) -> None:
        if not self._reported:
            self._reported = True
            self._tell(
                f"{self._slave.who}: units of its blocks could not be read: {why}; those of its device file count"
            )


class _WrongLengthError(SlaveError):
    """A record has another length than the profile gives it."""


async def _word(records: RecordAccess, slot: int, index: int, at: int, octets: int) -> int:
    """Unsigned16 from the octet ``at`` on in a record of ``octets``. Raises DpError."""
    found = await records.read(slot, index)
    if len(found) != octets:
        raise _WrongLengthError(
            records.address, f"slot {slot} index {index} has {octets_text(len(found))}, the profile gives it {octets}"
        )
    return int.from_bytes(found[at : at + _WORD], "big")


def _free_names(config: SlaveConfig) -> frozenset[str]:
    """The named values whose unit the plant file does not give: it is that of the device file."""
    profile = config.device_profile
    assert profile is not None
    assert profile.fields is not None
    found = set()
    ways = profile.fields(profile.telegram(config.telegram).name)
    for (_, fields), declared in zip(config.fields, ways, strict=True):
        for name, one in declared.items():
            unit = one.get("unit", "") if isinstance(one, Mapping) else ""
            if name in fields and fields.fields[name].unit == unit:
                found.add(name)
    return frozenset(found)


def with_units(config: SlaveConfig, units: Mapping[str, str]) -> SlaveConfig:
    """``config`` with the units of named values."""
    inputs, outputs = (
        FieldMap(
            {name: replace(field, unit=units.get(name, field.unit)) for name, field in fields.fields.items()},
            fields.length,
        )
        for _, fields in config.fields
    )
    return structs.replace(config, input_fields=inputs, output_fields=outputs)
