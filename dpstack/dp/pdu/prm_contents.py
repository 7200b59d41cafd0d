"""What blocks of structured parameters hold, by their type (docs/reference/protocol.md#structured-parameters).

Few slaves have such blocks: :mod:`dpstack.dp.pdu.prm_blocks` loads this module at its first use.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import Any, Final, NamedTuple

from dpstack.dp.pdu.layouts import DOUBLE_WORD, OCTET, WORD, Layout
from dpstack.errors import PduError


class BlockType(IntEnum):
    """Types with a meaning of their own; 32 to 128 are the maker's."""

    PRM_CMD = 2
    DXB_LINKS = 3
    ISOCHRONOUS = 4
    F_PARAMETERS = 5
    DXB_SUBSCRIBERS = 7
    TIME_AR = 8
    USER_PRM = 0x81


#: as configurations have them
NAMES: Final = {int(one): one.name.lower() for one in BlockType}


class PrmCmd(NamedTuple):
    """A command to a redundant slave; its sequence number is in the specifier of the block's head, bits 7..3.

    ``function``: :class:`~dpstack.dp.pdu.redundancy.PrmFunction`. ``properties``: bit 0 Primary Request for MS0 and
    MS1 is used, 1 start and stop of MS1 are used, 2 the address changes, 3 by 64. ``output_hold_time`` in 10 ms.
    """

    function: int = 0
    properties: int = 0
    output_hold_time: int = 0


class Isochronous(NamedTuple):
    """Isochronous mode. Bases of time in 1/12 us (375 to 12000), ``t_dp`` in the first, ``t_i``, ``t_o`` in the second.

    ``t_mapc`` in DP cycles 1..14; ``t_dx``, ``t_pll_w``, ``t_pll_d`` in 1/12 us.
    """

    version: int = 1
    t_base_dp: int = 1500
    t_dp: int = 1
    t_mapc: int = 1
    t_base_io: int = 1500
    t_i: int = 0
    t_o: int = 0
    t_dx: int = 0
    t_pll_w: int = 12
    t_pll_d: int = 0


class TimeAr(NamedTuple):
    """Clock synchronisation: how often, and the delay in s and 2^-32 s."""

    clock_sync_interval: int = 0
    cs_delay_seconds: int = 0
    cs_delay_fraction: int = 0


class DxbLink(NamedTuple):
    """The data of a subscriber: ``sample_length`` octets from ``sample_offset`` on of ``publisher``'s inputs."""

    publisher: int
    publisher_length: int
    sample_offset: int
    sample_length: int


class DxbSubscription(NamedTuple):
    """A link, and the slot and data area that its data go to."""

    publisher: int
    publisher_length: int
    sample_offset: int
    dest_slot: int
    offset_data_area: int
    sample_length: int


class DxbTable(NamedTuple):
    """A table of links or of subscriptions."""

    version: int
    entries: tuple[DxbLink, ...] | tuple[DxbSubscription, ...]


Content = PrmCmd | Isochronous | TimeAr | DxbTable

#: types that are one record
RECORDS: Final[Mapping[int, Layout[Any]]] = {
    BlockType.PRM_CMD: Layout("PrmCmd", PrmCmd, "function" / OCTET, "properties" / OCTET, "output_hold_time" / WORD),
    BlockType.ISOCHRONOUS: Layout(
        "IsoM parameters",
        Isochronous,
        "version" / OCTET,
        "t_base_dp" / DOUBLE_WORD,
        "t_dp" / WORD,
        "t_mapc" / OCTET,
        "t_base_io" / DOUBLE_WORD,
        "t_i" / WORD,
        "t_o" / WORD,
        "t_dx" / DOUBLE_WORD,
        "t_pll_w" / WORD,
        "t_pll_d" / WORD,
    ),
    BlockType.TIME_AR: Layout(
        "Time AR",
        TimeAr,
        "clock_sync_interval" / WORD,
        "cs_delay_seconds" / DOUBLE_WORD,
        "cs_delay_fraction" / DOUBLE_WORD,
    ),
}
#: octets of a shorter record, the rest of which is 0: without CS Delay Time (VPC3+S, p 81: "can be omitted")
SHORTER: Final = {int(BlockType.TIME_AR): 2}
#: types that are an octet of version and entries
TABLES: Final[Mapping[int, Layout[Any]]] = {
    BlockType.DXB_LINKS: Layout("DXB link", DxbLink, *(name / OCTET for name in DxbLink._fields)),
    BlockType.DXB_SUBSCRIBERS: Layout(
        "DXB subscription", DxbSubscription, *(name / OCTET for name in DxbSubscription._fields)
    ),
}


def type_of(content: Content) -> int:
    """The number of its type. Raises PduError for a table without entries: it may be either."""
    kinds: Mapping[int, Layout[Any]] = RECORDS
    record: object = content
    if isinstance(content, DxbTable):
        if not content.entries:
            raise PduError("a table without entries: say kind=BlockType.DXB_LINKS or BlockType.DXB_SUBSCRIBERS")
        kinds, record = TABLES, content.entries[0]
    return next(kind for kind, layout in kinds.items() if layout.make is type(record))
