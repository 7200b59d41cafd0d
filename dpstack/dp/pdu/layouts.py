"""The octets of the DP services, declared once with construct behind a typed wrapper.

construct knows no types and takes some 10 us and more a PDU: it is imported here only, and never runs on the cyclic
path. A :class:`Layout` turns octets into a NamedTuple and back; what the values mean is the business of the callers
(:mod:`dpstack.dp.pdu.requests`, :mod:`dpstack.dp.pdu.diagnosis`). Layouts: docs/protocol.md#slave_diag,
docs/protocol.md#set_prm, docs/protocol.md#global_control, docs/protocol.md#set_slave_add,
docs/protocol.md#alarms; those of MS1 and MS2 are in :mod:`dpstack.dpv1.pdu.layouts`.
"""

from __future__ import annotations

from typing import Any, Final, Generic, NamedTuple, Protocol, TypeVar, cast

import construct as cs

from dpstack.errors import PduError

#: of DP-V1: octets of data in one record; slots count from 0
MAX_RECORD: Final = 240
MAX_SLOT: Final = 254


class _Record(Protocol):
    """A NamedTuple: its fields are those of the declaration."""

    def _asdict(self) -> dict[str, Any]: ...


R = TypeVar("R", bound=_Record)


class Layout(Generic[R]):
    """A PDU, declared bit by bit, and the NamedTuple of the same field names that it is read into."""

    def __init__(self, name: str, record: type[R], *fields: Any) -> None:
        self.name = name
        self._record: Any = record
        self.record = record
        self.fields: tuple[str, ...] = cast(Any, record)._fields
        self._struct: Any = cs.Bitwise(cs.Struct(*fields))

    def parse(self, octets: bytes, before: int = 0) -> R:
        """Read ``octets``, which stand behind so many others ``before`` them. Raises PduError naming the field that is
        missing; octets too many are the caller's case."""
        try:
            container = self._struct.parse(octets)
        except cs.ConstructError as error:
            raise PduError(
                f"{self.name} ends after {before + len(octets)} octets: octet {before + len(octets) + 1} "
                f"({_field(error)}) is missing"
            ) from None
        record: R = self._record(*(container[key] for key in self._record._fields))
        return record

    def build(self, record: R) -> bytes:
        """The octets of ``record``. Raises PduError naming the field that does not fit."""
        try:
            return bytes(self._struct.build(record._asdict()))
        except cs.ConstructError as error:
            field = _field(error)
            raise PduError(f"{self.name}: {field} = {getattr(record, field, '?')} does not fit its octets") from None


def _field(error: Any) -> str:
    """The field that a construct error is about, from its path ("(parsing) -> ident")."""
    return str(error.path).rpartition(" -> ")[2]


def flags(names: str) -> tuple[Any, ...]:
    """One bit each, most significant first."""
    return tuple(name / cs.Flag for name in names.split())


#: what declarations are made of: ``"name" / OCTET``
OCTET: Final[Any] = cs.BitsInteger(8)
WORD: Final[Any] = cs.BitsInteger(16)
DOUBLE_WORD: Final[Any] = cs.BitsInteger(32)
REST: Final[Any] = cs.Bytewise(cs.GreedyBytes)


def bits(count: int) -> Any:
    """A number of so many bits."""
    return cs.BitsInteger(count)


def octets(count: int) -> Any:
    """So many octets as they are."""
    return cs.Bytewise(cs.Bytes(count))


class SetPrmOctets(NamedTuple):
    """Set_Prm as it is on the wire."""

    lock: bool
    unlock: bool
    sync: bool
    freeze: bool
    wd_on: bool
    reserved: int
    wd_fact_1: int
    wd_fact_2: int
    min_tsdr: int
    ident: int
    group_ident: int
    user_prm: bytes


SET_PRM: Final = Layout(
    "Set_Prm",
    SetPrmOctets,
    *flags("lock unlock sync freeze wd_on"),
    "reserved" / bits(3),
    "wd_fact_1" / OCTET,
    "wd_fact_2" / OCTET,
    "min_tsdr" / OCTET,
    "ident" / WORD,
    "group_ident" / OCTET,
    "user_prm" / REST,
)


class GlobalControlOctets(NamedTuple):
    """Global_Control as it is on the wire. ``reserved_high`` are bits 7..6, ``reserved_low`` is bit 0."""

    reserved_high: int
    sync: bool
    unsync: bool
    freeze: bool
    unfreeze: bool
    clear_data: bool
    reserved_low: int
    group_select: int


GLOBAL_CONTROL: Final = Layout(
    "Global_Control",
    GlobalControlOctets,
    "reserved_high" / bits(2),
    *flags("sync unsync freeze unfreeze clear_data"),
    "reserved_low" / bits(1),
    "group_select" / OCTET,
)


class SetSlaveAddOctets(NamedTuple):
    """Set_Slave_Add as it is on the wire; the meaning of ``no_add_chg`` is the caller's."""

    new_address: int
    ident: int
    no_add_chg: int
    rem_slave_data: bytes


SET_SLAVE_ADD: Final = Layout(
    "Set_Slave_Add",
    SetSlaveAddOctets,
    "new_address" / OCTET,
    "ident" / WORD,
    "no_add_chg" / OCTET,
    "rem_slave_data" / REST,
)


class DiagnosisOctets(NamedTuple):
    """The answer to Slave_Diag as it is on the wire; the bits of the status octets stay in their octets."""

    status_1: int
    status_2: int
    status_3: int
    master_add: int
    ident: int
    ext_diag: bytes


DIAGNOSIS: Final = Layout(
    "Slave_Diag",
    DiagnosisOctets,
    "status_1" / OCTET,
    "status_2" / OCTET,
    "status_3" / OCTET,
    "master_add" / OCTET,
    "ident" / WORD,
    "ext_diag" / REST,
)


class BlockHeader(NamedTuple):
    """The first octet of a block of the extended diagnosis: kind (bits 7..6) and what the kind makes of the rest."""

    kind: int
    value: int


BLOCK_HEADER: Final = Layout("diagnosis block", BlockHeader, "kind" / bits(2), "value" / bits(6))


class ChannelOctets(NamedTuple):
    """A block of the channel related diagnosis, three octets."""

    kind: int
    identifier: int
    output: bool
    input: bool
    channel: int
    size: int
    error: int


CHANNEL: Final = Layout(
    "channel related diagnosis",
    ChannelOctets,
    "kind" / bits(2),
    "identifier" / bits(6),
    *flags("output input"),
    "channel" / bits(6),
    "size" / bits(3),
    "error" / bits(5),
)


class MessageOctets(NamedTuple):
    """An alarm or a status in a device related block of the diagnosis; ``header`` is the block's."""

    header: int
    is_status: bool
    kind: int
    slot: int
    sequence: int
    add_ack: bool
    specifier: int
    data: bytes


MESSAGE: Final = Layout(
    "alarm or status",
    MessageOctets,
    "header" / OCTET,
    *flags("is_status"),
    "kind" / bits(7),
    "slot" / OCTET,
    "sequence" / bits(5),
    *flags("add_ack"),
    "specifier" / bits(2),
    "data" / REST,
)
