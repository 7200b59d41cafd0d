"""The diagnosis that an application sets: what it says beyond the slave's own fault bits, and the blocks to say it in.

The blocks are those that :mod:`dpstack.dp.pdu.diag_blocks` splits (protocol facts B1).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from dpstack.dp.pdu.diag_blocks import Block, ChannelBlock, DeviceBlock, IdentifierBlock, RevisionBlock, split_blocks
from dpstack.dp.pdu.layouts import BLOCK_HEADER, CHANNEL, BlockHeader, ChannelOctets
from dpstack.errors import PduError

_DEVICE, _IDENTIFIER, _CHANNEL, _REVISION = range(4)
#: a header's six bits count the octets of its block, itself included
_MAX_BLOCK: Final = 63


@dataclass(frozen=True, slots=True)
class UserDiag:
    """What an application says in its slave's diagnosis, all of it at once.

    ``ext``: the octets after the six fixed ones. ``fault``: Ext_Diag, there is something wrong (False: ``ext`` is a
    mere message). ``stat``: Stat_Diag, no valid data at present. ``overflow``: more than what is said here.
    """

    ext: bytes = b""
    fault: bool = False
    stat: bool = False
    overflow: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.ext, bytes):
            raise TypeError(f"the octets of a diagnosis are bytes, not {type(self.ext).__name__}")

    @classmethod
    def of(cls, *blocks: Block, fault: bool | None = None, stat: bool = False, overflow: bool = False) -> UserDiag:
        """From ``blocks``, in their order; ``fault`` None: where there are blocks."""
        ext = b"".join(block.octets for block in blocks)
        return cls(ext, bool(blocks) if fault is None else fault, stat, overflow)

    def limited(self, room: int) -> UserDiag:
        """The same in at most ``room`` octets of ``ext``: blocks that do not fit are left out, with ``overflow``.

        Octets that are no blocks are cut where the room ends.
        """
        if len(self.ext) <= room:
            return self
        blocks, finding = split_blocks(self.ext)
        kept = room if finding else 0
        for block in blocks if finding is None else ():
            if kept + len(block.octets) > room:
                break
            kept += len(block.octets)
        return UserDiag(self.ext[:kept], self.fault, self.stat, True)


#: Nothing to say.
NO_DIAG: Final = UserDiag()


def device_block(data: bytes) -> DeviceBlock:
    """A device related block of 1..62 octets that mean what the maker says (GSD: Unit_Diag_Bit). Raises PduError."""
    return DeviceBlock(_header(_DEVICE, len(data), "device related diagnosis") + data)


def identifier_block(faulty: Iterable[int], modules: int) -> IdentifierBlock:
    """An identifier related block: the numbers of the ``faulty`` ones of ``modules``, as on the wire: slot 1 is 0.

    Raises PduError.
    """
    bits = 0
    for number in faulty:
        if not 0 <= number < modules:
            raise PduError(
                f"identifier related diagnosis: module {number} of {modules}; the wire counts them from 0: the one in "
                f"slot 1 is 0"
            )
        bits |= 1 << number
    size = (modules + 7) // 8
    return IdentifierBlock(_header(_IDENTIFIER, size, "identifier related diagnosis") + bits.to_bytes(size, "little"))


def channel_block(
    identifier: int, channel: int, error: int, *, size: int = 0, input: bool = False, output: bool = False
) -> ChannelBlock:
    """A channel related block. ``identifier`` (the module as on the wire: slot 1 is 0) and ``channel`` 0..63; ``error``
    1..31 and ``size`` 0..7 as in the table of protocol facts B1 (1 short circuit, 6 line break ..., from 16 on the
    maker's). Raises PduError.
    """
    octets = CHANNEL.build(ChannelOctets(_CHANNEL, identifier, output, input, channel, size, error))
    return ChannelBlock(octets, identifier, channel, input, output, size, error)


def revision_block(revision: int) -> RevisionBlock:
    """The revision of the diagnosis, 0..63. Raises PduError."""
    return RevisionBlock(BLOCK_HEADER.build(BlockHeader(_REVISION, revision)), revision)


def _header(kind: int, octets: int, what: str) -> bytes:
    if not 1 <= octets < _MAX_BLOCK:
        raise PduError(f"{what}: {octets} octets; 1..{_MAX_BLOCK - 1} are possible in a block")
    return BLOCK_HEADER.build(BlockHeader(kind, octets + 1))
