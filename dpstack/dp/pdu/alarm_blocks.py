"""The blocks of alarms and status messages in the diagnosis of a DP-V1 slave (docs/reference/protocol.md#alarms).

A block is device related (its octets with the header, 4 to 63). Octets are counted within the block, from 1.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from dpstack.dp.pdu.layouts import MAX_SLOT, OCTET, REST, Layout, bits, flags
from dpstack.errors import PduError
from dpstack.text import NamedInt, octets_in_words

if TYPE_CHECKING:
    from dpstack.dp.pdu.clock import TimeStampedAlarm
    from dpstack.dp.pdu.dxb import LinkState
    from dpstack.dp.pdu.redundancy import Redundancy

#: octets of a block before its data
HEAD: Final = 4
#: octets of data in a block
MAX_DATA: Final = 59
#: sequence numbers
SEQUENCES: Final = 32
#: the manufacturer's types of alarm and status
VENDOR: Final = range(32, 127)
#: Status_Type of a status with DIAGNOSIS of PROFIBUS PA (the octet FE without bit 7)
PHYSICAL_BLOCK: Final = 126


class AlarmType(NamedInt):
    """Alarm_Type; 32..126 are the maker's own."""

    DIAGNOSIS = 1
    PROCESS = 2
    PULL = 3
    PLUG = 4
    STATUS = 5
    UPDATE = 6


#: the key of :data:`~dpstack.dp.pdu.dpv1_status.ALARMS` that enables a type; all vendor types share one
_ENABLED_BY: Final[Mapping[int, str]] = {
    AlarmType.DIAGNOSIS: "diagnostic",
    AlarmType.PROCESS: "process",
    AlarmType.PULL: "pull_plug",
    AlarmType.PLUG: "pull_plug",
    AlarmType.STATUS: "status",
    AlarmType.UPDATE: "update",
}


class StatusType(NamedInt):
    """Status_Type, without bit 7; 32..126 are the maker's own."""

    MESSAGE = 1
    MODULES = 2
    DXB_LINK = 3
    PRM_CMD_ACK = 30
    RED_STATE = 31


class Specifier(NamedInt):
    """Alarm_Specifier, bits 1..0."""

    NONE = 0
    APPEARS = 1
    DISAPPEARS = 2
    DISAPPEARS_OTHERS = 3

    @property
    def text(self) -> str:
        return ("", "appears, slot disturbed", "disappears, slot is good", "disappears, slot still disturbed")[self]


_STATUSES: Final[Mapping[int, str]] = {
    StatusType.MESSAGE: "status message",
    StatusType.MODULES: "module status",
    StatusType.DXB_LINK: "DXB link status",
    StatusType.PRM_CMD_ACK: "PrmCmdAck",
    StatusType.RED_STATE: "Red_State",
}


class ModuleState(NamedInt):
    """One module in a module status, two bits."""

    OK = 0
    INVALID = 1
    WRONG = 2
    MISSING = 3

    @property
    def text(self) -> str:
        return ("ok", "data invalid", "wrong module", "no module")[self]


class Alarm(Struct, frozen=True):
    """An alarm of a slave."""

    #: type 1..6 or 32..126
    type: int
    #: slot 0..254
    slot: int
    #: specifier 0..3: whether a fault appears or disappears
    specifier: int = Specifier.NONE
    #: sequence number 0..31
    sequence: int = 0
    #: data, 0..59 octets
    data: bytes = b""
    #: the user has to acknowledge it in addition
    add_ack: bool = False

    @property
    def title(self) -> str:
        """Its type in words."""
        return alarm_name(self.type)

    @property
    def text(self) -> str:
        """One line without its data."""
        how = Specifier(self.specifier).text
        return f"{self.title}, slot {self.slot}" + (f", {how}" if how else "")

    @property
    def time_stamps(self) -> TimeStampedAlarm | None:
        """The record of time-stamped events that a process alarm announces (DP-V2); None for all other alarms."""
        if self.type != AlarmType.PROCESS:
            return None
        from dpstack.dp.pdu.clock import TimeStampedAlarm  # here, as few devices stamp

        return TimeStampedAlarm.of(self.data)

    @property
    def full_text(self) -> str:
        """:attr:`text` with its data, and whether the user has to acknowledge it too."""
        stamps = self.time_stamps
        text = self.text + (_data_text(self.data) if stamps is None else f", {stamps.text}")
        return f"{text}, wants to be acknowledged by the user too" if self.add_ack else text

    def build(self) -> bytes:
        """The block with its header. Raises PduError if a value does not fit."""
        if not 0 <= self.type < 127:
            raise PduError(f"{self.type:d} is no type of an alarm: 1..6, 32..126")
        return _build(self, self.sequence, self.add_ack)


class Status(Struct, frozen=True):
    """A status, which has no acknowledgement."""

    #: type (bit 7 taken off) 1..3, 30, 31 or 32..126
    type: int
    #: slot 0..254
    slot: int
    #: specifier 0..3: whether a fault appears or disappears
    specifier: int = Specifier.NONE
    #: data, 0..59 octets
    data: bytes = b""
    #: bits 7..2 of the specifier; PrmCmdAck and Red_State have a sequence number there
    reserved: int = 0

    @property
    def title(self) -> str:
        """Its type in words."""
        return status_name(self.type) if self.pa_words is None else "PROFIBUS PA diagnosis"

    @property
    def text(self) -> str:
        """One line; for a module status every module that is not ok, for DXB link status, PrmCmdAck and Red_State their
        contents.

        The first module of a module status is slot 1 here; :func:`full_text` counts from another one.
        """
        if self.type == StatusType.MODULES:
            return self.modules_text(1)
        if self.links:
            return f"{self.title}: {', '.join(link.text for link in self.links)}"
        redundancy = self.redundancy
        if redundancy is not None:
            how = redundancy.text
        else:
            how = Specifier(self.specifier).text
            if self.pa_words is not None:
                from dpstack.dp.pdu.pa_diagnosis import CHANGES

                how = CHANGES[self.specifier]
        return f"{self.title}, slot {self.slot}" + (f", {how}" if how else "")

    def modules_text(self, first_slot: int) -> str:
        """A module status in one line: every module that is not ok, its slots counted from ``first_slot``."""
        bad = [f"slot {n} {state.text}" for n, state in enumerate(self.modules, first_slot) if state]
        return f"{self.title}: {', '.join(bad) or 'all modules ok'}"

    @property
    def full_text(self) -> str:
        """:attr:`text` with its data, if they are not in it."""
        if self.type == StatusType.MODULES or self.links or self.redundancy is not None:
            return self.text
        words = self.pa_words
        return self.text + (_data_text(self.data) if words is None else f", {words}")

    @property
    def pa_words(self) -> str | None:
        """The DIAGNOSIS of a PROFIBUS PA device in words; None if the status is another one."""
        if self.type != PHYSICAL_BLOCK:
            return None
        from dpstack.dp.pdu.pa_diagnosis import status_words  # here, as most slaves are no PA devices

        return status_words(self.data)

    @property
    def links(self) -> tuple[LinkState, ...]:
        """The links of a DXB link status; empty for all others, and if the data are no pairs of octets."""
        if self.type != StatusType.DXB_LINK:
            return ()
        from dpstack.dp.pdu.dxb import link_states  # here, as few slaves subscribe

        return link_states(self.data)

    @property
    def redundancy(self) -> Redundancy | None:
        """The contents of a PrmCmdAck or Red_State; None for all others, and if the data are too short."""
        if self.type not in (StatusType.PRM_CMD_ACK, StatusType.RED_STATE):
            return None
        from dpstack.dp.pdu.redundancy import Redundancy  # here, as few slaves are redundant

        return Redundancy.of(self.reserved << 2 | self.specifier, self.data)

    @property
    def modules(self) -> tuple[ModuleState, ...]:
        """The modules of a module status, slot 1 first; the last octet may have more of them than there are."""
        if self.type != StatusType.MODULES:
            return ()
        return tuple(ModuleState(octet >> shift & 3) for octet in self.data for shift in (0, 2, 4, 6))

    def build(self) -> bytes:
        """The block with its header. Raises PduError if a value does not fit."""
        return _build(self, self.reserved >> 1, bool(self.reserved & 1))


def module_status(states: tuple[ModuleState, ...]) -> Status:
    """A module status of ``states``, slot 1 first; modules that fill up the last octet are ok."""
    octets = bytearray(-(-len(states) // 4))
    for place, state in enumerate(states):
        octets[place // 4] |= state << place % 4 * 2
    return Status(StatusType.MODULES, 0, data=bytes(octets))


def parse_block(octets: bytes) -> Alarm | Status:
    """An alarm or status from a device related block, header included. Raises PduError naming the octet."""
    if octets and octets[0] != len(octets):
        raise PduError(f"alarm or status: octet 1 says {octets[0]} octets, there are {len(octets)}")
    if len(octets) > HEAD + MAX_DATA:
        raise PduError(f"alarm or status: {len(octets)} octets, a device related block has {HEAD + MAX_DATA} at most")
    return _LAYOUT.parse(octets)


def _message(
    header: int, is_status: bool, type: int, slot: int, sequence: int, add_ack: bool, specifier: int, data: bytes
) -> Alarm | Status:
    if slot > MAX_SLOT:
        raise PduError(f"alarm or status: octet 3: there is no slot {slot}")
    if type not in (_STATUSES if is_status else _ENABLED_BY) and type not in VENDOR:
        what = "status" if is_status else "alarm"
        raise PduError(f"alarm or status: octet 2: {type} is no type of {what}")
    if is_status:
        return Status(type, slot, specifier, data, sequence << 1 | add_ack)
    return Alarm(type, slot, specifier, sequence, data, add_ack)


_LAYOUT: Final = Layout(
    "alarm or status",
    _message,
    "header" / OCTET,
    *flags("is_status"),
    "type" / bits(7) * "kind",
    "slot" / OCTET,
    "sequence" / bits(5),
    *flags("add_ack"),
    "specifier" / bits(2),
    "data" / REST,
)


def _build(block: Alarm | Status, sequence: int, add_ack: bool) -> bytes:
    if not 0 <= block.slot <= MAX_SLOT:
        raise PduError(f"slot {block.slot} does not exist: 0..{MAX_SLOT}")
    length = len(block.data)
    if length > MAX_DATA:
        raise PduError(f"{length} octets of data, {MAX_DATA} are possible in one block")
    is_status = isinstance(block, Status)
    return _LAYOUT.build(block, header=HEAD + length, is_status=is_status, sequence=sequence, add_ack=add_ack)


def full_text(message: Alarm | Status, first_slot: int) -> str:
    """The ``full_text`` of ``message`` of a device whose first module is in ``first_slot`` (Modul_Offset)."""
    if isinstance(message, Status) and message.modules:
        return message.modules_text(first_slot)
    return message.full_text


def message_dict(message: Alarm | Status) -> dict[str, object]:
    """The alarm or status as JSON lines have it."""
    return {
        "type": message.type,
        "title": message.title,
        "slot": message.slot,
        "specifier": Specifier(message.specifier).name.lower(),
        "data": message.data.hex(),
    }


def kind_of(alarm_type: int) -> str:
    """The key of :data:`~dpstack.dp.pdu.dpv1_status.ALARMS` that enables it: pull and plug share one, so do vendor
    types.

    Raises PduError for types that do not exist.
    """
    if alarm_type in VENDOR:
        return "manufacturer"
    if alarm_type not in _ENABLED_BY:
        raise PduError(f"there is no alarm of type {alarm_type:d}: 1..6, {VENDOR.start}..{VENDOR.stop - 1}")
    return _ENABLED_BY[alarm_type]


def alarm_name(number: int) -> str:
    """The type of an alarm in words."""
    if number in _ENABLED_BY:
        return f"{AlarmType(number).name.lower()} alarm"
    return f"vendor alarm {number}" if number in VENDOR else f"alarm of reserved type {number}"


def status_name(number: int) -> str:
    """The type of a status in words."""
    reserved = f"vendor status {number}" if number in VENDOR else f"status of reserved type {number}"
    return _STATUSES.get(number, reserved)


def _data_text(data: bytes) -> str:
    return f", data {octets_in_words(data)}" if data else ""
