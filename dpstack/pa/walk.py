"""The blocks of a device, found by its directory: in slot 1 or 0, in each convention of the field, or without one.

The directory is foreign: all that it claims is checked against the block objects that really stand there, and the
number of reads is bounded. Sources: docs/reference/decisions/pa.md.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Awaitable, Callable, Iterable, Sequence
from typing import Final

from msgspec import Struct

from dpstack.errors import AcyclicError, PduError
from dpstack.pa.blocks import FUNCTION, PHYSICAL, PREFIX, BlockClass, BlockObject, Parameter
from dpstack.pa.directory import Header, Place, next_record, readings

#: reads all octets of a record: slot, index. Raises AcyclicError if the device refuses it
Read = Callable[[int, int], Awaitable[bytes]]
#: called with the number of blocks found
OnBlock = Callable[[int], None]

#: slots in which a directory may stand, the usual one first
_SLOTS: Final = (1, 0)
#: places of the physical block of a device whose directory cannot be used: profile 3, profile 2
_PHYSICAL_PLACES: Final = ((0, 16), (1, 14), (1, 16), (0, 14))
#: the first function block of a slot stands here since profile 3
_FIRST_INDEX: Final = 16
#: slots that are looked at without a directory
_GUESSED_SLOTS: Final = range(1, 9)
#: indices behind a block at which the next one is looked for without a directory: views and reserved ones lie between
_WIDEST_GAP: Final = 32
#: a device has its blocks 100 higher than its directory says
_OFF: Final = 100
_HIGHEST_INDEX: Final = 255
#: entries without a block after which a convention is given up, unless more blocks were found
_MOST_MISSES: Final = 3


class Block(Struct, frozen=True):
    """A block of a device. ``name``: kind and number, for instance ``ai1``; ``octets``: of its block object."""

    name: str
    slot: int
    index: int
    octets: bytes
    object: BlockObject

    @property
    def kind(self) -> BlockClass:
        """The class with its parameters."""
        return self.object.block_class_of

    @property
    def short(self) -> str:
        """The kind as the name has it: ``AI``, ``TB`` ..."""
        return self.kind.short

    def parameters(self) -> list[Parameter]:
        """The parameters of its class that fit into the slot, in the order of their indices."""
        return [one for one in self.kind.parameters.values() if self.index + one.relative <= _HIGHEST_INDEX]

    @property
    def view_1(self) -> tuple[int, int] | None:
        """Slot and index of its first view; None without one."""
        return divmod(self.object.view_1, 0x100) if self.object.view_1 and self.object.views else None


class Layout(Struct, frozen=True):
    """The blocks of a device. ``directory``: the slot of its directory, None without one that can be used;
    ``remarks``: contradictions of the directory, one line each."""

    blocks: tuple[Block, ...]
    directory: int | None
    remarks: tuple[str, ...] = ()

    def block(self, name: str) -> Block | None:
        """The block ``name``, in small or capital letters."""
        return next((one for one in self.blocks if one.name == name.lower()), None)

    @property
    def physical(self) -> Block | None:
        """The physical block."""
        return next((one for one in self.blocks if one.object.object == PHYSICAL), None)

    @property
    def profile(self) -> str:
        """The revision of the profile by the physical block, for instance ``3.02``; empty without one."""
        return self.physical.object.revision if self.physical else ""


class _Found(Struct, frozen=True):
    """A block object at a place."""

    slot: int
    index: int
    octets: bytes
    object: BlockObject


async def walk(read: Read, on_block: OnBlock | None = None) -> Layout:
    """Find the blocks of a device.

    Raises :class:`~dpstack.errors.PduError` if it has neither a directory that can be used nor a physical block at one
    of the usual places, and what ``read`` raises apart from AcyclicError.
    """
    device = _Device(read, on_block)
    why: list[str] = []
    for slot in _SLOTS:
        try:
            return await device.by_directory(slot)
        except AcyclicError as error:
            why.append(f"slot {slot} index {error.index}: {_reason(error)}")
        except PduError as error:
            why.append(f"slot {slot}: {error}")
    found = await device.guessed()
    if not found:
        raise PduError(
            f"no PROFIBUS PA device by its records: no directory ({'; '.join(why)}), and no physical block at "
            f"{_places_text(_PHYSICAL_PLACES)}"
        )
    remark = f"no usable directory ({'; '.join(why)}): only blocks at the usual places were looked for"
    return Layout(_named(found), None, (remark, *device.remarks))


def _reason(error: AcyclicError) -> str:
    return f"the device refuses it ({' '.join(f'{code:02X}' for code in error.codes)})"


def _places_text(places: Iterable[tuple[int, int]]) -> str:
    return ", ".join(f"slot {slot} index {index}" for slot, index in places)


class _Device:
    """The records of one device; each block object is read once."""

    def __init__(self, read: Read, on_block: OnBlock | None) -> None:
        self._read = read
        self._on_block = on_block
        self._known: dict[tuple[int, int], _Found | None] = {}
        self.remarks: list[str] = []

    async def by_directory(self, slot: int) -> Layout:
        """The blocks of the directory in ``slot``. Raises PduError, AcyclicError."""
        self.remarks.clear()
        header = Header.parse(await self._read(slot, 0))
        records = await self._records(slot, header)
        best: tuple[list[_Found], list[str]] = [], []
        for places in readings(header, records):
            found, missing = await self._at(places)
            if not missing:
                return self._layout(slot, found)
            if len(found) > len(best[0]):
                best = found, missing
        if not best[0]:
            raise PduError("its directory names places without a block")
        self.remarks += best[1]
        return self._layout(slot, best[0])

    async def _records(self, slot: int, header: Header) -> dict[int, bytes]:
        records: dict[int, bytes] = {}
        while (index := next_record(header, records)) is not None:
            try:
                records[index] = await self._read(slot, index)
            except AcyclicError:
                if not records:
                    raise
                self.remarks.append(f"the directory has fewer entries than it claims: it ends before index {index}")
                break
        return records

    async def _at(self, places: Sequence[Place]) -> tuple[list[_Found], list[str]]:
        """The blocks at ``places``, and a line for each place without one."""
        found: list[_Found] = []
        missing: list[str] = []
        for place in places:
            one = await self._block_at(place)
            if one is None:
                missing.append(
                    f"the directory has a {PREFIX[place.kind]} at slot {place.slot} index {place.index}: none is there"
                )
                if len(missing) >= _MOST_MISSES and len(missing) > len(found):
                    break
            elif any((one.slot, one.index) == (other.slot, other.index) for other in found):
                missing.append(f"the directory has the block at slot {one.slot} index {one.index} twice")
            else:
                found.append(one)
                self._tell(len(found))
        return found, missing

    def _tell(self, count: int) -> None:
        if self._on_block is not None:
            self._on_block(count)

    async def _block_at(self, place: Place) -> _Found | None:
        """The block of the right kind there, or 100 higher."""
        for index in (place.index, place.index + _OFF):
            found = await self._object_at(place.slot, index)
            if found is not None and found.object.object == place.kind:
                return found
        return None

    async def _object_at(self, slot: int, index: int) -> _Found | None:
        """The block object at a place; None if something else, or nothing, is there."""
        if slot > _HIGHEST_INDEX - 1 or index > _HIGHEST_INDEX:
            return None
        if (slot, index) not in self._known:
            self._known[slot, index] = await self._look(slot, index)
        return self._known[slot, index]

    async def _look(self, slot: int, index: int) -> _Found | None:
        try:
            octets = await self._read(slot, index)
            found = _Found(slot, index, octets, BlockObject.parse(octets))
        except (AcyclicError, PduError):
            return None
        return found if found.object.is_block else None

    async def guessed(self) -> list[_Found]:
        """The blocks at the usual places, if a physical block is there: the first one of each slot, and those that
        follow each other closely."""
        self.remarks.clear()
        for slot, index in _PHYSICAL_PLACES:
            physical = await self._object_at(slot, index)
            if physical is not None and physical.object.object == PHYSICAL:
                break
        else:
            return []
        found = await self._row(physical)
        for slot in _GUESSED_SLOTS:
            first = await self._object_at(slot, _FIRST_INDEX)
            if first is not None and first not in found:
                found += [one for one in await self._row(first) if one not in found]
        return found

    async def _row(self, block: _Found) -> list[_Found]:
        """``block`` and those right behind each other's parameters and views."""
        row = [block]
        while (after := await self._behind(row[-1])) is not None:
            row.append(after)
            self._tell(len(row))
        return row

    async def _behind(self, block: _Found) -> _Found | None:
        count = block.object.parameters
        for index in range(block.index + max(count, 1), block.index + max(count, 1) + _WIDEST_GAP):
            found = await self._object_at(block.slot, index)
            if found is not None:
                return found
        return None

    def _layout(self, slot: int, found: Sequence[_Found]) -> Layout:
        return Layout(_named(found), slot, tuple(self.remarks))


_ORDER: Final = (PHYSICAL, FUNCTION)


def _named(found: Iterable[_Found]) -> tuple[Block, ...]:
    """Physical, function, then transducer blocks, numbered within each kind of name."""
    counts: Counter[str] = Counter()
    blocks = []
    for one in sorted(found, key=lambda one: _ORDER.index(one.object.object) if one.object.object in _ORDER else 2):
        short = one.object.block_class_of.short.lower()
        counts[short] += 1
        blocks.append(Block(f"{short}{counts[short]}", one.slot, one.index, one.octets, one.object))
    return tuple(blocks)
