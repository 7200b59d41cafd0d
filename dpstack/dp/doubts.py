"""The parts of a slave's process data that its diagnosis throws doubt on: slot, channel, octets, the reason in words.

The rule of docs/reference/quality.md#the-rule, for every reader. A doubt is about bits of the image, or about all of
it. The report about a slot counts for its channels, unless blocks of the same slot name the channels.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from enum import Enum, IntEnum
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from dpstack.dp.pdu.alarm_blocks import VENDOR, Alarm, AlarmType, ModuleState, Specifier, Status, parse_block
from dpstack.dp.pdu.diag_bits import FLAG
from dpstack.dp.pdu.diag_blocks import ChannelBlock, DeviceBlock, IdentifierBlock
from dpstack.dp.slot_map import Direction, Slot, SlotMap
from dpstack.errors import PduError

if TYPE_CHECKING:
    from dpstack.dp.pdu.diagnosis import Diagnosis
    from dpstack.dp.process_data import Field
    from dpstack.gsd.diag_texts import DiagTexts
    from dpstack.gsd.model import DiagText

#: bits of each channel type of a channel related block; the others do not say them. A block that says fewer than a
#: channel of the module has counts the module's channels
_WIDTHS: Final = {1: 1, 2: 2, 3: 4, 4: 8, 5: 16, 6: 32}
#: errors of a channel whose value is still one: overtemperature, upper and lower limit exceeded
_OVERTEMPERATURE: Final = 5
_LIMITS: Final = (7, 8)
#: texts of makers' errors: a value beyond its range, or a warning ... (compiled with the first such error)
_LIMIT_TEXT: Final = (
    r"limit|range|over ?flow|under ?flow|exceed|warning|threshold|grenz|bereich|[üu]berlauf|unterlauf|warnung"
)
#: ... unless the text speaks of a broken wire or a short circuit, too
_FAULT_TEXT: Final = r"break|broken|wire|short|open|bruch|kurzschl"
#: a mask of all octets
ALL: Final = -1
#: what to do about the errors of channels by number; the help of a GSD file counts before
_CHANNEL_REMEDIES: Final = {
    1: "look for a short circuit at this channel: wires, terminal, connected device",
    2: "check the supply of this channel",
    3: "check the supply of this channel",
    4: "look for what draws too much current at this channel",
    5: "let the module cool down; check load and ventilation",
    6: "check wire, terminal and sensor of this channel",
    7: "compare the process with the measuring range; check range and sensor",
    8: "compare the process with the measuring range; check range and sensor",
    9: "check the module and what is connected to this channel",
}
_OWN_ERROR: Final = "the manual of the module says what this error means"
_LOOK_AT_DEVICE: Final = "look at the displays of the device; its manual says more"
_LOOK_THERE: Final = "look at the displays of the module, and at its supply; its manual says more"
#: texts of a GSD file in one doubt
_MOST_TEXTS: Final = 8
#: octets in a text
_SHOWN: Final = 8


class Trust(IntEnum):
    """How far a value can be trusted; the worst counts."""

    GOOD = 0
    UNCERTAIN = 1
    BAD = 2


class DoubtKind(Enum):
    """Kind of a doubt, and the trust that is left. Names as in :class:`dpstack.plant.quality.Reason`."""

    #: the slave has announced a diagnosis that is not read yet
    ANNOUNCED = Trust.UNCERTAIN, 0
    #: a fault of the channel: line break, short circuit ...
    CHANNEL_FAULT = Trust.BAD, 1
    #: a limit of the channel is exceeded
    CHANNEL_LIMIT = Trust.UNCERTAIN, 2
    #: a fault of the slot whose channel is not known
    SLOT_FAULT = Trust.UNCERTAIN, 3
    SLOT_INVALID = Trust.BAD, 4
    SLOT_WRONG = Trust.BAD, 5
    SLOT_MISSING = Trust.BAD, 6
    #: a fault of the slave whose slot is not known
    SLAVE_FAULT = Trust.UNCERTAIN, 7
    #: Ext_Diag_Overflow
    UNLISTED = Trust.UNCERTAIN, 8
    #: Stat_Diag
    NO_VALID_DATA = Trust.BAD, 9
    #: the configuration has no such slot: about no value by itself
    NO_PLACE = Trust.GOOD, 10
    #: an alarm of the device, which makes its values wrong
    DEVICE_FAULT = Trust.BAD, 11

    def __init__(self, trust: Trust, _number: int) -> None:
        self.trust = trust


class Doubt(Struct, frozen=True):
    """One doubt. ``text``: words of the fault, then the place. ``slot``, ``channel``: None if they are not known.
    ``inputs``, ``outputs``: the bits that it is about, as :attr:`dpstack.dp.process_data.Field.mask`; -1: all.
    """

    kind: DoubtKind
    text: str
    slot: int | None = None
    channel: int | None = None
    inputs: int = 0
    outputs: int = 0
    #: bits of the channel as the slave says them; 0: it does not
    width: int = 0
    #: what to do, for people
    remedy: str = ""
    #: the bits are those of the channel; False: it lies somewhere in them, and only names by this channel are meant
    exact: bool = True

    @property
    def trust(self) -> Trust:
        return self.kind.trust

    @property
    def is_of_all(self) -> bool:
        """Whether it is about the whole slave."""
        return self.inputs == ALL

    def is_about(self, field: Field, direction: Direction) -> bool:
        """Whether it throws doubt on a named value. A name by slot and channel has priority over the bits, unless the
        slave's channel is the wider one."""
        mask = self.inputs if direction is Direction.INPUT else self.outputs
        if not mask:
            return False
        is_named = self.channel is not None and field.channel is not None and field.slot == self.slot
        if is_named and self.width <= field.width:
            return field.channel == self.channel
        return self.exact and bool(mask & field.mask)


#: a slave whose diagnosis is not read yet
ANNOUNCED: Final = Doubt(
    DoubtKind.ANNOUNCED, "diagnosis announced", inputs=ALL, outputs=ALL, remedy="wait: the master is about to read it"
)


def worst(doubts: Iterable[Doubt]) -> Doubt | None:
    """The doubt that leaves least trust; of equal ones the first, because the closest come first."""
    return max(doubts, key=lambda doubt: doubt.trust, default=None)


def doubts_of(
    slots: SlotMap,
    diagnosis: Diagnosis | None,
    standing: Sequence[Alarm] = (),
    *,
    texts: DiagTexts | None = None,
    dpv1: bool = False,
) -> tuple[Doubt, ...]:
    """The doubts by the last ``diagnosis`` and the ``standing`` alarms: those of channels first, then of slots, then
    of the slave. ``dpv1``: device related blocks are alarms and status messages."""
    return () if diagnosis is None and not standing else _Reader(slots, diagnosis, standing, texts, dpv1).all()


def standing_after(standing: tuple[Alarm, ...], alarm: Alarm) -> tuple[Alarm, ...]:
    """The alarms that stand after ``alarm``: those whose slot is not good again."""
    others = tuple(one for one in standing if one.slot != alarm.slot)
    same = tuple(one for one in standing if one.slot == alarm.slot)
    disturbed = alarm.specifier in (Specifier.APPEARS, Specifier.DISAPPEARS_OTHERS)
    if alarm.type == AlarmType.PULL:
        return (*others, alarm)
    if alarm.type == AlarmType.PLUG:  # a new module: faults of the old one are over
        return (*others, alarm) if disturbed else others
    if not _is_fault(alarm) or alarm.specifier == Specifier.NONE:
        return standing
    pulled = tuple(one for one in same if one.type == AlarmType.PULL)
    return (*others, *pulled, alarm) if disturbed else (*others, *pulled)


def _is_fault(alarm: Alarm) -> bool:
    return alarm.type == AlarmType.DIAGNOSIS or alarm.type in VENDOR


class _Reader:
    def __init__(
        self,
        slots: SlotMap,
        diagnosis: Diagnosis | None,
        standing: Sequence[Alarm],
        texts: DiagTexts | None,
        dpv1: bool,
    ) -> None:
        self._slots = slots
        self._diagnosis = diagnosis
        self._texts = texts
        #: slots with a channel related block
        self._explained: set[int] = set()
        #: the diagnosis says where its fault is
        self._listed = False
        self._channels: list[Doubt] = []
        self._of_slots: list[Doubt] = []
        self._identifiers: list[int] = []
        self._messages: list[Alarm | Status] = []
        self._device: list[DeviceBlock] = []
        for block in () if diagnosis is None else diagnosis.blocks:
            match block:
                case ChannelBlock():
                    self._channel(block)
                case IdentifierBlock(modules=modules):
                    self._identifiers += modules
                case DeviceBlock():
                    self._take_device(block, dpv1)
        told = [one for one in self._messages if isinstance(one, Alarm)]
        self._listed = self._listed or bool(told)
        self._alarms = _latest((*standing, *told))

    def all(self) -> tuple[Doubt, ...]:
        for message in self._messages:
            if isinstance(message, Status):
                self._modules(message)
        for number in self._identifiers:
            self._identifier(number)
        for alarm in self._alarms:
            self._alarm(alarm)
        # the worst of each slot first
        self._of_slots.sort(key=lambda doubt: -doubt.trust)
        return (*self._channels, *self._of_slots, *self._of_slave())

    # --- channels -----------------------------------------------------------------------------------------------

    def _channel(self, block: ChannelBlock) -> None:
        slot = self._slot_at(block.identifier)
        words, kind, remedy = self._cause(block)
        if slot is None:
            self._no_place(f"{words}: {block.place(first_slot=self._first)}")
            return
        self._listed = True
        self._explained.add(slot.number)
        both = block.input == block.output  # of neither: the slave does not say it
        directions = [
            one
            for one, said in ((Direction.INPUT, block.input), (Direction.OUTPUT, block.output))
            if (said or both) and slot.area(one).octets
        ]
        way = "" if both or len(directions) != 1 else f"{directions[0]} "
        place = f"{slot.title}, {way}channel {block.channel}"
        width = _WIDTHS.get(block.size, 0)
        masks = {
            one: slot.area(one).channel_mask(block.channel, max(width, slot.area(one).width)) for one in directions
        }
        is_known = any(masks.values())
        # the reserved type 0 with channel 0 is the whole module to those who use it: SIMOCODE, ET 200SP
        may_be_all = block.size == 0 and block.channel == 0
        if is_known:
            ins, outs = masks.get(Direction.INPUT, 0), masks.get(Direction.OUTPUT, 0)
            text = f"{words}: {place}"
            self._channels.append(Doubt(kind, text, slot.number, block.channel, ins, outs, width, remedy))
            if not may_be_all:
                return
        why = "by which the whole module may be meant" if may_be_all else "whose octets are not known"
        text = f"{words}: {place}, {why}"
        ins = slot.inputs.mask if not directions or Direction.INPUT in directions else 0
        outs = slot.outputs.mask if not directions or Direction.OUTPUT in directions else 0
        # a name by this channel is bad, the other values of the slot are uncertain
        if not is_known:
            self._channels.append(Doubt(kind, text, slot.number, block.channel, ins, outs, width, remedy, exact=False))
        self._of_slots.append(Doubt(DoubtKind.SLOT_FAULT, text, slot.number, None, ins, outs, remedy=remedy))

    def _cause(self, block: ChannelBlock) -> tuple[str, DoubtKind, str]:
        """Words, kind, what to do."""
        own = None if self._texts is None else self._texts.channel_text(block.error, block.identifier)
        words = block.cause if own is None or not own.text else own.text
        remedy = (own.help if own is not None else "") or _CHANNEL_REMEDIES.get(block.error, _OWN_ERROR)
        if block.error in (_OVERTEMPERATURE, *_LIMITS):
            return words, DoubtKind.CHANNEL_LIMIT, remedy
        is_limit = own is not None and re.search(_LIMIT_TEXT, words, re.I) and not re.search(_FAULT_TEXT, words, re.I)
        return words, DoubtKind.CHANNEL_LIMIT if is_limit else DoubtKind.CHANNEL_FAULT, remedy

    # --- slots --------------------------------------------------------------------------------------------------

    @property
    def _first(self) -> int:
        return self._slots.slots[0].number if self._slots.slots else 0

    def _slot_at(self, identifier: int) -> Slot | None:
        return self._slots.slots[identifier] if identifier < len(self._slots.slots) else None

    def _identifier(self, number: int) -> None:
        slot = self._slot_at(number)
        if slot is None:
            self._no_place(f"has a diagnosis: slot {self._first + number}")
            return
        self._listed = True
        if any(doubt.slot == slot.number for doubt in self._of_slots):
            return  # its module status says more
        if slot.number not in self._explained:
            self._slot(DoubtKind.SLOT_FAULT, "has a diagnosis", slot)

    def _modules(self, status: Status) -> None:
        for identifier, state in enumerate(status.modules):
            if not state:
                continue
            slot = self._slot_at(identifier)
            if slot is None:
                self._no_place(f"{state.text}: slot {self._first + identifier}")
                continue
            self._listed = True
            if state == ModuleState.INVALID and slot.number in self._explained:
                self._slot(DoubtKind.SLOT_FAULT, state.text, slot)
            else:
                self._slot(_STATES[state], state.text, slot)

    def _alarm(self, alarm: Alarm) -> None:
        if alarm.slot == 0 and self._slots.slot(0) is None:  # the station itself
            self._of_slots.append(Doubt(DoubtKind.SLAVE_FAULT, f"{alarm.title} of the station", 0, None, ALL, ALL))
            return
        slot = self._slots.slot(alarm.slot)
        if slot is None:
            self._no_place(alarm.text)
        elif alarm.type == AlarmType.PULL:
            self._slot(DoubtKind.SLOT_MISSING, "module pulled", slot)
        elif slot.number not in self._explained or alarm.specifier == Specifier.DISAPPEARS_OTHERS:
            others = ", other faults are left" if alarm.specifier == Specifier.DISAPPEARS_OTHERS else ""
            self._slot(DoubtKind.SLOT_FAULT, f"{alarm.title}{others}", slot)

    def _slot(self, kind: DoubtKind, words: str, slot: Slot) -> None:
        text = f"{words}: {slot.title}"
        self._of_slots.append(
            Doubt(kind, text, slot.number, None, slot.inputs.mask, slot.outputs.mask, remedy=_SLOT_REMEDIES[kind])
        )

    def _no_place(self, text: str) -> None:
        self._of_slots.append(Doubt(DoubtKind.NO_PLACE, f"{text}; the configuration has {self._slots.range_text}"))

    # --- the slave ----------------------------------------------------------------------------------------------

    def _take_device(self, block: DeviceBlock, dpv1: bool) -> None:
        try:
            message = parse_block(block.octets) if dpv1 else None
        except PduError:
            message = None
        if message is not None:
            self._messages.append(message)
        # a status that the standard does not define is the maker's own, with texts in its GSD file
        if message is None or (isinstance(message, Status) and not message.modules):
            self._device.append(block)

    def _of_slave(self) -> Iterator[Doubt]:
        diagnosis = self._diagnosis
        if diagnosis is None:
            return
        if diagnosis.stat_diag:
            yield _of_all(DoubtKind.NO_VALID_DATA, FLAG["stat_diag"].text)
        raised = [one for block in self._device for one in self._known(block) if one.text and _is_raised(one)]
        alarms = frozenset() if self._texts is None else self._texts.alarms
        beside = alarms if self._texts is None else alarms | self._texts.warnings
        known = raised if diagnosis.ext_diag else [one for one in raised if one in beside]
        if known:
            texts = list(dict.fromkeys(one.text for one in known))[:_MOST_TEXTS]
            helps = list(dict.fromkeys(one.help for one in known if one.help))[:_MOST_TEXTS]
            kind = DoubtKind.SLAVE_FAULT if alarms.isdisjoint(known) else DoubtKind.DEVICE_FAULT
            yield _of_all(kind, ", ".join(texts), "; ".join(helps) or _LOOK_AT_DEVICE)
        elif diagnosis.ext_diag and not self._listed:
            yield _of_all(DoubtKind.SLAVE_FAULT, self._unplaced())
        if diagnosis.overflow:
            yield _of_all(DoubtKind.UNLISTED, FLAG["ext_diag_overflow"].text)

    def _unplaced(self) -> str:
        """The words for a fault that Ext_Diag reports and that no block places: real devices report so what is wrong
        with all of their modules (tests/dp/diagnoses: ET 200SP, Balluff, Weidmueller)."""
        strange = [doubt.text for doubt in self._of_slots if doubt.kind is DoubtKind.NO_PLACE]
        if strange:
            return strange[0]
        octets = b"".join(block.data for block in self._device)
        said = f" ({octets[:_SHOWN].hex(' ')}{' ...' if len(octets) > _SHOWN else ''})" if any(octets) else ""
        return f"Ext_Diag, and the slave does not say where the fault is{said}"

    def _known(self, block: DeviceBlock) -> Sequence[DiagText]:
        return () if self._texts is None else self._texts.unit_diag_texts(block.data)


_STATES: Final = {
    ModuleState.INVALID: DoubtKind.SLOT_INVALID,
    ModuleState.WRONG: DoubtKind.SLOT_WRONG,
    ModuleState.MISSING: DoubtKind.SLOT_MISSING,
}


_SLOT_REMEDIES: Final = {
    DoubtKind.SLOT_FAULT: _LOOK_THERE,
    DoubtKind.SLOT_INVALID: _LOOK_THERE,
    DoubtKind.SLOT_WRONG: "plug in the module that the configuration names, or change the configuration",
    DoubtKind.SLOT_MISSING: "plug the module in; check its seat and its supply",
}


def _of_all(kind: DoubtKind, text: str, remedy: str = _LOOK_AT_DEVICE) -> Doubt:
    return Doubt(kind, text, None, None, ALL, ALL, remedy=remedy)


def _is_raised(text: DiagText) -> bool:
    """Whether it is the text of something, not of its absence: files have "no error" for an area of zeros."""
    return text.kind == "bit" or (text.kind == "area" and text.value != 0)


def _latest(alarms: Iterable[Alarm]) -> tuple[Alarm, ...]:
    standing: tuple[Alarm, ...] = ()
    for alarm in alarms:
        standing = standing_after(standing, alarm)
    return standing
