"""Diagnoses that a simulated slave reports in addition to those of its device: any number at a time, as one diagnosis.

A fault of a slot or of a channel is reported as a modular station reports it: one identifier related block of all
slots with a fault, with DP-V1 a module status of all slots, then a channel related block for each faulty channel. Texts
of the GSD file stand in a device related block, in DP-V1 in a status, as a device related block is an alarm or a status
there (docs/reference/protocol.md#alarms).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

from msgspec import Struct

from dpstack.dp.pdu.alarm_blocks import (
    HEAD,
    MAX_DATA,
    VENDOR,
    Alarm,
    AlarmType,
    ModuleState,
    Specifier,
    StatusType,
    module_status,
)
from dpstack.dp.pdu.diag_blocks import (
    Block,
    ChannelBlock,
    IdentifierBlock,
    UserDiag,
    device_block,
    identifier_block,
    split_blocks,
)
from dpstack.dp.pdu.layouts import MAX_SLOT
from dpstack.gsd.diag_texts import DiagTexts
from dpstack.gsd.model import DiagText

#: bit 7 of the type of a block: a status, not an alarm
_STATUS: Final = 0x80
_STATUS_TYPES: Final = (StatusType.MESSAGE, *VENDOR)
#: modules for which a module status has room
_MOST_MODULES: Final = 4 * MAX_DATA


class ReportedOctets(Struct, frozen=True):
    """The blocks of ``diag`` as they are."""

    diag: UserDiag

    @property
    def fault(self) -> bool:
        return self.diag.fault

    @property
    def content(self) -> object:
        """Equal for two reports of the same."""
        return self.diag.ext

    @property
    def text(self) -> str:
        return f"diagnosis {self.diag.ext.hex(' ').upper() or 'no octets'}"


class SlotDiagnosis(Struct, frozen=True):
    """A fault of the module in ``slot``, which is number ``module`` of ``modules`` on the wire (from 0).

    ``channel``: its faulty channel, None if the fault is the module's. ``state``: that of the module in a module
    status. ``alarm``: its begin and its end raise an alarm of DP-V1. ``words``: for people.
    """

    words: str
    slot: int
    module: int
    modules: int
    state: ModuleState = ModuleState.INVALID
    channel: ChannelBlock | None = None
    fault: bool = True
    alarm: bool = False

    @property
    def text(self) -> str:
        return f"diagnosis, {self.words}" + (", with an alarm" if self.alarm else "")

    @property
    def content(self) -> object:
        """Equal for two reports of the same."""
        return self.module, self.state, self.channel

    def appears(self) -> Alarm:
        """The alarm of its begin; a wrong module is plugged."""
        if self.state is ModuleState.WRONG:
            return Alarm(AlarmType.PLUG, self.slot, Specifier.DISAPPEARS_OTHERS)
        kind = AlarmType.PULL if self.state is ModuleState.MISSING else AlarmType.DIAGNOSIS
        return Alarm(kind, self.slot, Specifier.APPEARS, data=self._data)

    def disappears(self, others: bool) -> Alarm:
        """The alarm of its end; ``others``: the slot has another fault."""
        kind = AlarmType.PLUG if self.state in (ModuleState.MISSING, ModuleState.WRONG) else AlarmType.DIAGNOSIS
        how = Specifier.DISAPPEARS_OTHERS if others else Specifier.DISAPPEARS
        return Alarm(kind, self.slot, how, data=self._data)

    @property
    def _data(self) -> bytes:
        """Channel and error, as the I/O station sends them."""
        return b"" if self.channel is None else bytes((self.channel.channel, self.channel.error))


class TextDiagnosis(Struct, frozen=True):
    """A text of the GSD file for bits of a device related block. ``type``: of its UnitDiagType, None without one.

    ``texts``: all texts of the file.
    """

    words: str
    wanted: DiagText
    texts: DiagTexts
    type: int | None = None
    fault: bool = True

    @property
    def text(self) -> str:
        return f"diagnosis, {self.words}"

    @property
    def content(self) -> object:
        """Equal for two reports of the same."""
        return self.wanted, self.type

    @property
    def fits_dpv1(self) -> bool:
        """Whether a status of DP-V1 can carry it."""
        return bool(_status_blocks((self,)))


Reported = ReportedOctets | SlotDiagnosis | TextDiagnosis


def combined(own: UserDiag, reports: Sequence[Reported], states: Sequence[ModuleState], *, dpv1: bool) -> UserDiag:
    """``own``, the diagnosis of the device, with ``reports``. ``states``: of the modules that the device itself knows
    to be faulty; ``dpv1``: the master has set DPV1_Enable.
    """
    slots = [report for report in reports if isinstance(report, SlotDiagnosis)]
    blocks, finding = split_blocks(own.ext)
    if slots and finding is None:
        own_ext = _octets(_rack_blocks(slots, blocks, states, dpv1))
    else:
        own_ext = own.ext + _octets(_rack_blocks(slots, (), states, dpv1))
    texts = _octets(_text_blocks([report for report in reports if isinstance(report, TextDiagnosis)], dpv1))
    given = [report.diag for report in reports if isinstance(report, ReportedOctets)]
    return UserDiag(
        own_ext + texts + b"".join(diag.ext for diag in given),
        own.fault or any(report.fault for report in reports),
        own.stat or any(diag.stat for diag in given),
        own.overflow or any(diag.overflow for diag in given),
    )


def _octets(blocks: Iterable[Block]) -> bytes:
    return b"".join(block.octets for block in blocks)


def _rack_blocks(
    slots: Sequence[SlotDiagnosis], own: Sequence[Block], states: Sequence[ModuleState], dpv1: bool
) -> list[Block]:
    """One identifier related block, one module status, then the other blocks of the device and the channels."""
    if not slots:
        return list(own)
    found = dict(enumerate(states))
    for block in own:
        if isinstance(block, IdentifierBlock):
            found |= {module: found.get(module) or ModuleState.INVALID for module in block.modules}
    faulty = {module for module, state in found.items() if state} | {slot.module for slot in slots}
    for slot in slots:
        found[slot.module] = max(found.get(slot.module, ModuleState.OK), slot.state)
    count = max(slots[0].modules, *(module + 1 for module in found))
    blocks: list[Block] = [identifier_block(faulty, count)]
    if dpv1:
        all_states = tuple(found.get(module, ModuleState.OK) for module in range(min(count, _MOST_MODULES)))
        blocks.append(Block(module_status(all_states).build()))
    blocks += [block for block in own if not isinstance(block, IdentifierBlock)]
    channels = [slot.channel for slot in slots if slot.channel is not None]
    return blocks + [channel for channel in dict.fromkeys(channels) if channel not in own]


def _text_blocks(reports: Sequence[TextDiagnosis], dpv1: bool) -> list[Block]:
    """All texts in one block, as the bits of one device; in DP-V1 one for each type."""
    if not reports:
        return []
    if not dpv1:
        return [device_block(_bits(reports, 0, 1))]
    return _status_blocks(reports) or [device_block(_bits(reports, 0, 1))]


def _status_blocks(reports: Sequence[TextDiagnosis]) -> list[Block]:
    """The texts as statuses of DP-V1; empty if no status can carry one of them."""
    types = dict.fromkeys(report.type for report in reports)
    blocks: list[Block] = []
    for number in types:
        alike = [report for report in reports if report.type == number]
        octets = _status(alike) if number is None else _bits(alike, number, HEAD - 1)
        if octets is None and len(alike) > 1:  # not together in one block
            return [block for report in reports for block in _status_blocks((report,))]
        if octets is None:
            return []
        blocks.append(device_block(octets))
    return blocks


def _status(reports: Sequence[TextDiagnosis]) -> bytes | None:
    """A status without a type of its own in which all texts hold, and as few others as possible.

    The bits of a text count from the octet of the type on: those of a file for DP-V0 may lie in type, slot and
    specifier. Then the type, of the maker's own ones, that has these bits is taken.
    """
    wanted = {report.wanted for report in reports}
    best: tuple[tuple[int, int], bytes] | None = None
    for number in _STATUS_TYPES:
        octets = _bits(reports, _STATUS | number, HEAD - 1)
        if not octets[0] & _STATUS or octets[0] & ~_STATUS not in _STATUS_TYPES or octets[1] > MAX_SLOT:
            continue
        found = set(reports[0].texts.unit_diag_texts(octets))
        worth = len(wanted - found), len(found)
        if best is None or worth < best[0]:
            best = worth, octets
    return None if best is None else best[1]


def _bits(reports: Iterable[TextDiagnosis], first_octet: int, least: int) -> bytes:
    """At least ``least`` octets that begin with ``first_octet``, with the bits of the texts in their places."""
    value, length = first_octet, least
    for report in reports:
        text = report.wanted
        first, last = text.first or 0, text.last or 0
        mask = (1 << last - first + 1) - 1
        value = value & ~(mask << first) | text.value << first
        length = max(length, last // 8 + 1)
    return value.to_bytes(length, "little")
