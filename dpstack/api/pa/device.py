"""``PaDevice``: the blocks of a process device, their parameters read, written, dumped and compared."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from typing import Final, NamedTuple, Protocol

from msgspec import Struct, structs

from dpstack.api.lists.list_file import ListComparison, time_now
from dpstack.api.pa.overview import Overview, overview_of
from dpstack.api.pa.pa_list import PaDifference, PaEntry, PaList, compared
from dpstack.api.pa.reading import Reading, RecordReader
from dpstack.api.pa.values import PaValue, missing, octets_to_write, value_of, with_unit
from dpstack.argcheck import Sealed
from dpstack.errors import AcyclicError, PduError, SlaveFault, UsageError
from dpstack.pa.parameters import MakersParameter, Target, block_named, find, limits_of, targets_of
from dpstack.pa.walk import Block, Layout, walk
from dpstack.pa.words import mode_words
from dpstack.text import brief

#: called with the name of the step, the number done, the total number (0: not known)
OnProgress = Callable[[str, int, int], None]

#: parameters of a dump at most; a device that claims more is taken for damaged
MOST_PARAMETERS: Final = 5_000
#: Error_Code_1 of a record that the device does not have: feature not supported, invalid index, invalid slot
_NOT_THERE: Final = (0xA9, 0xB0, 0xB2)
_UNLOCKED: Final = 2457
#: parameters without write protection
_NEVER_LOCKED: Final = frozenset({"write_locking", "tab_entry"})
_MAN, _OUT_OF_SERVICE = 0x10, 0x80
#: parameters that a device changes by itself after the write
_NOT_READ_BACK: Final = frozenset({"factory_reset", "set_tot", "zero_point_adjust", "self_calib_cmd", "tab_op_code"})


def _changes_itself(name: str) -> bool:
    return name.partition(".")[2] in _NOT_READ_BACK


class RecordWriter(Protocol):
    """Writes all octets of a record: slot, index, octets, time-out in seconds."""

    def __call__(self, slot: int, index: int, data: bytes, timeout: float | None, /) -> Awaitable[None]: ...


class PaAccess(NamedTuple):
    """The way to the records of one device.

    ``who``: address and name for texts; ``makers``: parameters of the maker by the device file; ``extension``: its
    texts of the bits of DIAGNOSIS_EXTENSION, from 1.
    """

    name: str
    address: int
    who: str
    read: RecordReader
    write: RecordWriter
    makers: Sequence[MakersParameter] = ()
    extension: Mapping[int, str] = {}


class PaWritten(Struct, frozen=True):
    """A parameter that was written. ``st_rev``: the static revision of its block before and after; None: unknown.
    ``value``: read back, or as it was written if the device changes the parameter by itself."""

    name: str
    before: PaValue
    value: PaValue
    st_rev: tuple[int | None, int | None]

    @property
    def text(self) -> str:
        """A line for people."""
        old, new = self.st_rev
        revision = ""
        if old is not None and new is not None:
            revision = f"; ST_REV {old} -> {new}" if old != new else f"; ST_REV is {new} as before"
        done = "written" if _changes_itself(self.name) else "written and read back"
        before = "" if self.before.unreadable is not None else f" (before: {self.before.text})"
        return f"{self.name} = {self.value.text}{before}, {done}{revision}"


class PaDump(Struct, frozen=True):
    """All parameters of a device. ``remarks``: what does not fit together, one line each."""

    list: PaList
    remarks: tuple[str, ...] = ()


class PaDevice(Sealed):
    """A process device of PROFIBUS PA: ``bus.slave("tank").pa``, or ``connection.pa`` over a class 2 connection.

    Parameters have names: ``ai1.out``, ``ai1.pv_scale.eu_0`` (an element), ``tb1.my_parameter`` (of the device file),
    ``1:110`` (slot and index, for any record). The blocks are looked for at the first call. ``timeout`` in seconds for
    each Read and Write (None: 10, longer if the slave may take longer).

    All methods raise the errors of ``read`` of the slave: AcyclicError (the device refuses), SlaveTimeout,
    ConnectionEnded, SlaveFault (also: no PA device), UsageError (an unknown name), BusError.
    """

    def __init__(self, access: PaAccess) -> None:
        self._access = access
        self._layout: Layout | None = None
        self._one_by_one = asyncio.Lock()
        self._seal(PaDevice)

    def _sealed_name(self) -> str:
        return f"PA device {self._access.who}"

    @property
    def name(self) -> str:
        """the slave's name, for texts"""
        return self._access.name

    @property
    def address(self) -> int:
        """station address of the slave, 0..126"""
        return self._access.address

    async def walk(self, *, timeout: float | None = None, progress: OnProgress | None = None) -> Layout:
        """Look for the blocks, also if they are known already."""
        access = self._access

        def on_block(count: int) -> None:
            if progress is not None:
                progress("blocks", count, 0)

        try:
            self._layout = await walk(lambda slot, index: access.read(slot, index, timeout), on_block)
        except PduError as error:
            raise SlaveFault(access.address, f"{access.who}: {error}") from None
        return self._layout

    async def blocks(self, *, timeout: float | None = None) -> tuple[Block, ...]:
        """Its blocks: the physical one, function blocks, transducer blocks."""
        return (self._layout or await self.walk(timeout=timeout)).blocks

    async def overview(self, *, timeout: float | None = None, progress: OnProgress | None = None) -> Overview:
        """Identity, diagnosis in words, write protection, and each block with tag, mode, alarms and values."""
        layout = await self.walk(timeout=timeout, progress=progress)
        return await overview_of(self._reading(layout, timeout), self._access.makers, progress)

    async def read(self, name: str, *, timeout: float | None = None) -> PaValue:
        """Read a parameter, or an element of it. Raises AcyclicError naming it if the device refuses."""
        reading, target = await self._find(name, timeout)
        try:
            return await reading.value(target)
        except AcyclicError as error:
            raise error.about(target.name) from None

    async def read_block(
        self, name: str, *, timeout: float | None = None, progress: OnProgress | None = None
    ) -> tuple[PaValue, ...]:
        """Read all parameters of a block, for instance ``ai1``. One that the device does not have is left out; one
        that it refuses has the reason in ``unreadable``."""
        layout = await self._fresh_layout(_text(name), timeout)
        block = block_named(layout, name)
        reading = self._reading(layout, timeout)
        return tuple(await self._values(reading, targets_of(block, self._access.makers), progress))

    async def read_any(
        self, name: str, *, timeout: float | None = None, progress: OnProgress | None = None
    ) -> tuple[PaValue, ...]:
        """Read whatever ``name`` means: all parameters of a block, or the one that it names."""
        if _text(name).strip().isalnum():
            return await self.read_block(name.strip(), timeout=timeout, progress=progress)
        return (await self.read(name, timeout=timeout),)

    async def write(self, name: str, value: object, *, timeout: float | None = None) -> PaWritten:
        """Write a parameter, or an element of a structure (its other elements are kept), and read it back.

        ``value``: of its type, or words: ``"AUTO"``, ``"mbar"``, ``"unlocked"``. Checks before it writes: access, type,
        range, write locking and write protection of the device, and for OUT the mode (MAN or O/S). Raises UsageError if
        one of them fails, SlaveFault if the device has another value afterwards.
        """
        async with self._one_by_one:
            reading, target = await self._find(name, timeout)
            return await self._write(reading, target, value, timeout)

    async def dump(self, *, timeout: float | None = None, progress: OnProgress | None = None) -> PaDump:
        """Read all parameters of all blocks. If a block's ST_REV changes meanwhile, everything is read once more."""
        layout = await self.walk(timeout=timeout, progress=progress)
        remarks = list(layout.remarks)
        for again in (True, False):
            reading = self._reading(layout, timeout)
            revisions = await self._revisions(reading, layout)
            values = await self._values(reading, list(self._all_targets(layout)), progress, known_only=True)
            after = await self._revisions(self._reading(layout, timeout), layout)
            if revisions == after:
                break
            changed = ", ".join(
                f"{name} ST_REV {revisions[name]} -> {now}" for name, now in after.items() if revisions[name] != now
            )
            done = "it was read once more" if again else "it changed during the second reading, too: the list is mixed"
            remarks.append(f"the device was changed while it was read ({changed}): {done}")
        return PaDump(await self._list(reading, layout, values), tuple(remarks))

    async def compare(self, saved: PaList, *, everything: bool = False) -> ListComparison[PaDifference, PaEntry]:
        """Read all parameters, and compare them with ``saved``: configuration and identity; with ``everything``
        measured values too."""
        return compared((await self.dump()).list, saved, everything=everything)

    # --- reading ------------------------------------------------------------------------------------------------

    def _reading(self, layout: Layout, timeout: float | None) -> Reading:
        return Reading(layout, self._access.read, self._access.extension, timeout)

    async def _find(self, name: str, timeout: float | None) -> tuple[Reading, Target]:
        layout = await self._fresh_layout(_text(name), timeout)
        return self._reading(layout, timeout), find(layout, name, self._access.makers)

    async def _fresh_layout(self, name: str, timeout: float | None) -> Layout:
        """The blocks; looked for again if another block stands now where the one of ``name`` was."""
        layout = self._layout
        if layout is None:
            return await self.walk(timeout=timeout)
        block = layout.block(name.strip().partition(".")[0])
        if block is None:
            return layout
        try:
            same = await self._access.read(block.slot, block.index, timeout) == block.octets
        except AcyclicError:
            same = False
        return layout if same else await self.walk(timeout=timeout)

    async def _values(
        self,
        reading: Reading,
        targets: Sequence[Target],
        progress: OnProgress | None,
        *,
        known_only: bool = False,
    ) -> list[PaValue]:
        """The values of ``targets`` that the device has; ``known_only``: without unknown ones that it refuses."""
        values = []
        for number, target in enumerate(targets, 1):
            try:
                values.append(await reading.value(target))
            except AcyclicError as error:
                there = error.code_1 not in _NOT_THERE
                if there and (target.kind or not known_only):
                    values.append(missing(target, str(error)))
            if progress is not None:
                progress("parameters", number, len(targets))
        return values

    def _all_targets(self, layout: Layout) -> Iterator[Target]:
        """The parameters of all blocks, and the records among them without a known meaning. Raises SlaveFault for too
        many."""
        found: dict[tuple[int, int], Target] = {}
        for block in layout.blocks:
            for one in targets_of(block, self._access.makers):
                found.setdefault((one.slot, one.index), one)
            for index in range(block.index, min(block.index + block.object.parameters, 0x100)):
                found.setdefault(
                    (block.slot, index), Target(f"{block.slot}:{index}", block.slot, index, access="r", block=block)
                )
        if len(found) > MOST_PARAMETERS:
            raise SlaveFault(
                self._access.address,
                f"{self._access.who} claims {len(found)} parameters in {len(layout.blocks)} blocks, more than "
                f"{MOST_PARAMETERS}: read its blocks one by one",
            )
        yield from found.values()

    async def _revisions(self, reading: Reading, layout: Layout) -> dict[str, int | None]:
        return {block.name: await reading.whole(block, "st_rev") for block in layout.blocks}

    async def _list(self, reading: Reading, layout: Layout, values: Sequence[PaValue]) -> PaList:
        physical = layout.physical
        maker, texts = 0, ["", ""]
        if physical is not None:
            maker = await reading.whole(physical, "device_man_id") or 0
            texts = [await reading.text(physical, one) for one in ("device_id", "device_ser_num")]
        access = self._access
        return PaList(
            name=access.name,
            address=access.address,
            maker=maker,
            device=texts[0],
            serial=texts[1],
            profile=layout.profile,
            time=time_now(),
            parameters=tuple(map(PaEntry.of, values)),
        )

    # --- writing ------------------------------------------------------------------------------------------------

    async def _write(self, reading: Reading, target: Target, value: object, timeout: float | None) -> PaWritten:
        if not target.is_writable:
            raise UsageError(f"{target.name} can only be read")
        unit = await reading.unit(target)
        before, old = b"", missing(target, "it can only be written")
        if "r" in target.access:
            before = await self._octets(reading, target)
            old = value_of(target, before, await reading.meaning(target), unit)
        data = octets_to_write(target, value, before)
        await self._check_limits(reading, target, data, unit)
        await self._check_lock(reading, target)
        await self._check_mode(reading, target, data)
        block = target.block
        revision = None if block is None else await reading.whole(block, "st_rev")
        try:
            await self._access.write(target.slot, target.index, data, timeout)
        except AcyclicError as error:
            raise await self._refused(reading, target, error) from None
        return await self._read_back(reading.layout, target, data, old, revision, timeout)

    async def _refused(self, reading: Reading, target: Target, error: AcyclicError) -> AcyclicError:
        """The refusal of a write, with a hint if another mode may help."""
        block = target.block
        actual = None if block is None else await reading.element(block, "mode_blk", "actual")
        permitted = None if block is None else await reading.element(block, "mode_blk", "permitted")
        what = target.name
        if (
            block is not None
            and actual is not None
            and not actual & _OUT_OF_SERVICE
            and (permitted or 0) & _OUT_OF_SERVICE
        ):
            what = f"{what} (some devices take it in O/S only, {block.name} is in {mode_words(actual)})"
        return error.about(what)

    async def _octets(self, reading: Reading, target: Target) -> bytes:
        try:
            return await reading.octets(target.slot, target.index)
        except AcyclicError as error:
            raise error.about(target.name) from None

    async def _check_limits(self, reading: Reading, target: Target, data: bytes, unit: str) -> None:
        """Raises UsageError if a calibration point is outside the sensor, or a range has no span."""
        meaning = await reading.meaning(target)
        wanted = value_of(structs.replace(target, element=None), data, meaning, unit).value
        low_end = wanted.get("eu_0") if isinstance(wanted, Mapping) else None
        if isinstance(wanted, Mapping) and isinstance(low_end, float) and low_end == wanted["eu_100"]:
            raise UsageError(f"{target.name}: lower and upper end of the range are both {low_end:g}: no range")
        names = limits_of(target)
        if names is None or target.block is None or not isinstance(wanted, float):
            return
        low, high = [await reading.number(target.block, name) for name in names]
        if low is not None and high is not None and low < high and not low <= wanted <= high:
            raise UsageError(
                f"{target.name} = {with_unit(wanted, unit)} is outside the sensor: {with_unit(low, '')} to "
                f"{with_unit(high, unit)}"
            )

    async def _check_lock(self, reading: Reading, target: Target) -> None:
        """Raises UsageError for a device that is write-protected."""
        physical = reading.layout.physical
        if physical is None or target.parameter in _NEVER_LOCKED:
            return
        protected = await reading.number(physical, "hw_write_protection")
        if protected in (1, 2):
            raise UsageError(
                f"{target.name} was not written: {self._access.who} is write-protected at the device "
                f"(HW_WRITE_PROTECTION is {protected:g}): release its switch, jumper or keypad"
            )
        if await reading.number(physical, "write_locking") == 0:
            raise UsageError(
                f"{target.name} was not written: {self._access.who} is locked (WRITE_LOCKING is 0): write "
                f"{physical.name}.write_locking {_UNLOCKED} unlocks it"
            )

    async def _check_mode(self, reading: Reading, target: Target, data: bytes) -> None:
        """Raises UsageError if the mode of the block does not allow the write, or a mode is not permitted."""
        block = target.block
        if block is None:
            return
        if target.access == "rm":
            actual = await reading.element(block, "mode_blk", "actual")
            if actual is not None and not actual & (_MAN | _OUT_OF_SERVICE):
                raise UsageError(
                    f"{target.name} can be written in the modes MAN and O/S only, {block.name} is in "
                    f"{mode_words(actual)}: write {block.name}.target_mode MAN first, and AUTO afterwards"
                )
        if target.parameter == "target_mode" and len(data) == 1:
            permitted = await reading.element(block, "mode_blk", "permitted")
            if permitted and not data[0] & permitted:
                raise UsageError(
                    f"{target.name}: {mode_words(data[0])} is not permitted; the block has {mode_words(permitted)}"
                )

    async def _read_back(
        self, layout: Layout, target: Target, data: bytes, old: PaValue, revision: int | None, timeout: float | None
    ) -> PaWritten:
        reading = self._reading(layout, timeout)
        wanted = value_of(target, data, await reading.meaning(target), await reading.unit(target))
        found = wanted
        if "r" in target.access and target.parameter not in _NOT_READ_BACK:
            found = value_of(target, await self._octets(reading, target), await reading.meaning(target), wanted.unit)
            if not _is_same(target, wanted, found):
                raise SlaveFault(
                    self._access.address,
                    f"{self._access.who}: {target.name} was written as {wanted.text}, and the device has "
                    f"{found.text or found.unreadable}: it changes or limits the value, see its manual",
                )
        after = None if target.block is None else await reading.whole(target.block, "st_rev")
        return PaWritten(target.name, old, found, (revision, after))


def _is_same(target: Target, wanted: PaValue, found: PaValue) -> bool:
    """Whether the device has what was written. A simulation that is off follows the measured value; the status beside a
    value belongs to the device."""
    one, other = wanted.value, found.value
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        names = ["enabled"] if "enabled" in one and not one["enabled"] else [name for name in one if name != "status"]
        if "supported" in one:
            names = ["enabled"]
        return all(one[name] == other[name] for name in names)
    return one == other


def _text(name: object) -> str:
    if not isinstance(name, str):
        raise UsageError(f'{brief(name)} is no name of a parameter: write for instance "ai1.pv_scale"')
    return name
