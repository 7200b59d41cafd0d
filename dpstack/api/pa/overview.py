"""A device at a glance: identity, diagnosis, blocks with their values."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from msgspec import Struct

from dpstack.api.pa.reading import Reading
from dpstack.api.pa.values import PaValue, missing
from dpstack.dp.pdu.pa_diagnosis import EXTENSION_AVAILABLE
from dpstack.errors import AcyclicError
from dpstack.pa.diagnosis import category_of, diagnosis_words, extension_words
from dpstack.pa.parameters import MakersParameter, shown_targets
from dpstack.pa.walk import Block, Layout
from dpstack.pa.words import maker_name

#: blocks of which an overview reads values
MOST_BLOCKS: Final = 32
#: parameters that an overview has in fields of their own
_OWN: Final = frozenset({"tag_desc", "target_mode", "mode_blk", "alarm_sum"})
_LOCKED: Final = 0


class Identity(Struct, frozen=True):
    """The device by its physical block. ``maker_id``: DEVICE_MAN_ID; None: it does not say; ``profile``: revision of
    the profile."""

    maker: str
    maker_id: int | None
    device: str
    serial: str
    software: str
    hardware: str
    tag: str
    descriptor: str
    message: str
    installed: str
    profile: str
    ident_selector: str


class Diagnosis(Struct, frozen=True):
    """DIAGNOSIS and DIAGNOSIS_EXTENSION: octets in hex, texts. ``category``: of NAMUR NE 107, the most serious one;
    empty if nothing is wrong."""

    octets: str
    category: str
    texts: tuple[str, ...]
    extension: str
    extension_texts: tuple[str, ...]


class BlockState(Struct, frozen=True):
    """A block. ``kind``: in words; ``mode``: actual, normal and permitted; ``alarms``: those that are active."""

    name: str
    kind: str
    slot: int
    index: int
    tag: str
    target_mode: str
    mode: str
    alarms: str
    values: tuple[PaValue, ...]

    def as_dict(self) -> dict[str, object]:
        """Plain data for JSON."""
        plain: dict[str, object] = {name: getattr(self, name) for name in self.__struct_fields__ if name != "values"}
        return plain | {"values": [one.as_dict() for one in self.values]}


class Overview(Struct, frozen=True):
    """A device. ``write_protection``: in words; ``directory``: slot of its directory, None without a usable one."""

    identity: Identity
    diagnosis: Diagnosis
    write_protection: str
    directory: int | None
    blocks: tuple[BlockState, ...]
    remarks: tuple[str, ...]


async def overview_of(
    reading: Reading, makers: Sequence[MakersParameter], progress: Callable[[str, int, int], None] | None
) -> Overview:
    """Read the overview of a device. Raises as the reader of its records."""
    layout = reading.layout
    remarks = list(layout.remarks)
    shown = layout.blocks[:MOST_BLOCKS]
    if len(shown) < len(layout.blocks):
        remarks.append(f"{len(layout.blocks)} blocks: only the first {MOST_BLOCKS} were read, read the others by name")
    blocks = []
    for number, block in enumerate(shown):
        if progress is not None:
            progress("blocks", number, len(shown))
        blocks.append(await _state_of(reading, block, makers))
    return Overview(
        identity=await _identity(reading, layout),
        diagnosis=await _diagnosis(reading, layout),
        write_protection=await _protection(reading, layout),
        directory=layout.directory,
        blocks=tuple(blocks),
        remarks=tuple(remarks),
    )


async def _state_of(reading: Reading, block: Block, makers: Sequence[MakersParameter]) -> BlockState:
    found: dict[str, PaValue] = {}
    for target in shown_targets(block, makers):
        try:
            found[target.parameter] = await reading.value(target)
        except AcyclicError as error:
            found[target.parameter] = missing(target, str(error))

    def own(name: str) -> str:
        one = found.get(name)
        return "" if one is None else one.text

    return BlockState(
        name=block.name,
        kind=block.kind.words,
        slot=block.slot,
        index=block.index,
        tag=own("tag_desc"),
        target_mode=own("target_mode"),
        mode=own("mode_blk"),
        alarms=own("alarm_sum"),
        values=tuple(one for name, one in found.items() if name not in _OWN and one.unreadable is None),
    )


async def _identity(reading: Reading, layout: Layout) -> Identity:
    block = layout.physical
    if block is None:
        return Identity("", None, *[""] * 10)

    async def text(name: str) -> str:
        return (await reading.text(block, name)).strip()

    maker = await reading.number(block, "device_man_id")
    selector = [one for one in shown_targets(block) if one.parameter == "ident_number_selector"]
    try:
        ident = (await reading.value(selector[0])).text if selector else ""
    except AcyclicError:
        ident = ""
    return Identity(
        maker="" if maker is None else maker_name(int(maker)),
        maker_id=None if maker is None else int(maker),
        device=await text("device_id"),
        serial=await text("device_ser_num"),
        software=await text("software_revision"),
        hardware=await text("hardware_revision"),
        tag=await text("tag_desc"),
        descriptor=await text("descriptor"),
        message=await text("device_message"),
        installed=await text("device_instal_date"),
        profile=layout.profile,
        ident_selector=ident,
    )


async def _diagnosis(reading: Reading, layout: Layout) -> Diagnosis:
    block = layout.physical
    octets = extension = None
    if block is not None:
        octets = await reading.raw(block, "diagnosis")
        extension = await reading.raw(block, "diagnosis_extension")
    category = category_of(octets or b"")
    more = tuple(extension_words(extension or b"", reading.extension))
    texts = (one for one in diagnosis_words(octets or b"") if not (more and one == EXTENSION_AVAILABLE.words))
    return Diagnosis(
        octets=(octets or b"").hex(),
        category="" if category is None else category.text,
        texts=tuple(texts),
        extension=(extension or b"").hex(),
        extension_texts=more,
    )


async def _protection(reading: Reading, layout: Layout) -> str:
    block = layout.physical
    if block is None:
        return ""
    protected = await reading.number(block, "hw_write_protection")
    if protected in (1, 2):
        return "write-protected at the device (HW_WRITE_PROTECTION)"
    if await reading.number(block, "write_locking") == _LOCKED:
        return "locked (WRITE_LOCKING)"
    return "none"
