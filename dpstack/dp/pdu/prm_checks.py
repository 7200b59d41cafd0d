"""Checks of Set_Prm for DP-V2: blocks of isochronous mode (type 4), redundancy (type 2) and clock (type 8), in words.

Sources: VPC3+S user manual (profichip 2012), p 76 and 81; Felser, "isochronous cycle"; AUMA AC 01.2 manual, p 46.
docs/reference/decisions/clock.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from dpstack.dp.pdu.dpv1_status import DPV1_ENABLE, ISOM_REQ, PRM_CMD, PRM_STRUCTURE
from dpstack.dp.pdu.prm_blocks import PrmBlock, parse_blocks
from dpstack.dp.pdu.prm_contents import BlockType, Isochronous, PrmCmd, TimeAr
from dpstack.dp.pdu.redundancy import PrmFunction
from dpstack.errors import PduError
from dpstack.params import DPV1_STATUS_LEN
from dpstack.units import NS_PER_MS, NS_PER_S

#: times of isochronous mode count in 1/12 us, a bit at 12 Mbit/s
_TWELFTHS: Final = 12
#: T_BASE_DP and T_BASE_IO
_BASES: Final = (375, 750, 1500, 3000, 6000, 12_000)
#: T_DP in us
_SHORTEST_DP, _LONGEST_DP = 500, 32_000
#: T_MAPC in DP cycles
_LONGEST_MAPC: Final = 14
#: T_PLL_W in 1/12 us if no block says it
DEFAULT_WINDOW: Final = 12
#: bits of Properties in a PrmCmd that mean something
_PROPERTIES: Final = 0x0F
#: unit of Clock_Sync_Interval and of the Output Hold Time
_TEN_MS: Final = 10 * NS_PER_MS
_FRACTION: Final = 1 << 32


def blocks_of(user: bytes) -> tuple[PrmBlock, ...]:
    """The structured parameters in the user parameters of Set_Prm; none without DPV1_Enable or Prm_Structure, and if
    they cannot be read: then a message of the reader names octet and block."""
    if len(user) < DPV1_STATUS_LEN or not user[0] & DPV1_ENABLE or not user[2] & PRM_STRUCTURE:
        return ()
    try:
        return parse_blocks(user[DPV1_STATUS_LEN:], DPV1_STATUS_LEN + 1)
    except PduError:
        return ()


def isochronous_demand(user: bytes) -> tuple[str, float] | None:
    """Why Set_Prm with these user parameters demands isochronous mode, and its PLL window in us; None if it does
    not."""
    if len(user) < DPV1_STATUS_LEN or not user[0] & DPV1_ENABLE:
        return None
    contents = [block.content for block in blocks_of(user) if block.type == BlockType.ISOCHRONOUS]
    windows = [one.t_pll_w for one in contents if isinstance(one, Isochronous)]
    window_us = (windows[0] if windows else DEFAULT_WINDOW) / _TWELFTHS
    if windows:
        return "its Set_Prm has a block of type 4 (isochronous)", window_us
    return ("IsoM_Req is set in its DPV1_Status_3", window_us) if user[2] & ISOM_REQ else None


def clock_interval_s(user: bytes) -> float | None:
    """Clock_Sync_Interval of a block of type 8, in s; None without such a block."""
    for block in blocks_of(user):
        if block.type == BlockType.TIME_AR and isinstance(content := block.content, TimeAr):
            return content.clock_sync_interval * _TEN_MS / NS_PER_S
    return None


def block_text(block: PrmBlock) -> str:
    """The contents of a block of type 2, 4 or 8 in one line; empty for other types."""
    match block.content:
        case Isochronous() as one:
            times = [("T_DP", one.t_dp * one.t_base_dp), ("T_I", one.t_i * one.t_base_io)]
            times += [("T_O", one.t_o * one.t_base_io), ("T_DX", one.t_dx)]
            times += [("T_PLL_W", one.t_pll_w), ("T_PLL_D", one.t_pll_d)]
            named = [f"{name} {_us_text(twelfths)}" for name, twelfths in times]
            return f"isochronous mode: {', '.join((named[0], f'T_MAPC {one.t_mapc}', *named[1:]))}"
        case PrmCmd() as one:
            names = [flag.name.lower().replace("_", " ") for flag in PrmFunction(one.function & _KNOWN) if flag.name]
            hold = f"output hold time {one.output_hold_time * 10} ms"
            return f"PrmCmd, sequence number {block.specifier >> 3}: {', '.join(names) or 'no function'}; {hold}"
        case TimeAr() as one:
            delay = one.cs_delay_seconds + one.cs_delay_fraction / _FRACTION
            return f"clock: monitored for {one.clock_sync_interval / 100:g} s, delay {delay:g} s"
    return ""


_KNOWN: Final = int(sum(PrmFunction))


def _us_text(twelfths: int) -> str:
    us = twelfths / _TWELFTHS
    return f"{us / 1000:g} ms" if us >= 1000 else f"{us:g} us"


def findings(user: bytes) -> tuple[str, ...]:
    """The faults of the blocks of type 2 and 4 of these user parameters, and of the bits that go with them, a line
    each."""
    blocks = blocks_of(user)
    return tuple(line for block in blocks for line in block_findings(block)) + tuple(_joint(user, blocks))


def block_findings(block: PrmBlock) -> Iterator[str]:
    """The faults of a block of type 2 or 4; none for other types."""
    content = block.content
    if isinstance(content, Isochronous):
        for line in _of_isochronous(content):
            yield f"block of {block.title}: {line}"
    elif isinstance(content, PrmCmd):
        for line in _of_command(content, block.specifier):
            yield f"block of {block.title}: {line}"


def _of_isochronous(one: Isochronous) -> Iterator[str]:
    if one.version != 1:
        yield f"version {one.version}: 1 is the only one"
    for name, base in (("T_BASE_DP", one.t_base_dp), ("T_BASE_IO", one.t_base_io)):
        if base not in _BASES:
            yield f"{name} {base}: {', '.join(map(str, _BASES))} are possible"
    cycle_us = one.t_dp * one.t_base_dp / _TWELFTHS
    if not _SHORTEST_DP <= cycle_us <= _LONGEST_DP:
        yield f"a DP cycle (T_DP) of {cycle_us:g} us: {_SHORTEST_DP} us to {_LONGEST_DP // 1000} ms are possible"
    if not 1 <= one.t_mapc <= _LONGEST_MAPC:
        yield f"T_MAPC {one.t_mapc}: 1 to {_LONGEST_MAPC} DP cycles are possible"
    if one.t_dx / _TWELFTHS > cycle_us:
        yield f"T_DX {_us_text(one.t_dx)} is longer than the DP cycle of {cycle_us:g} us"
    if not one.t_pll_w:
        yield "T_PLL_W 0: the window of the PLL has 1/12 us at least"


def _of_command(one: PrmCmd, specifier: int) -> Iterator[str]:
    if one.function & ~_KNOWN:
        yield f"reserved bits 0x{one.function & ~_KNOWN:02X} in its function"
    if one.function & PrmFunction.START_MS1 and one.function & PrmFunction.STOP_MS1:
        yield "it starts and stops MS1 at once"
    if one.properties & ~_PROPERTIES:
        yield f"reserved bits 0x{one.properties & ~_PROPERTIES:02X} in its properties"
    if specifier & 0x07:
        yield f"reserved bits 0x{specifier & 0x07:02X} beside its sequence number"


def _joint(user: bytes, blocks: Sequence[PrmBlock]) -> Iterator[str]:
    """Blocks that miss their bit in DPV1_Status_3, or the other way round."""
    if len(user) < DPV1_STATUS_LEN or not user[0] & DPV1_ENABLE:
        return
    types = [block.type for block in blocks]
    for kind in (BlockType.PRM_CMD, BlockType.ISOCHRONOUS, BlockType.TIME_AR):
        if types.count(kind) > 1:
            yield f"{types.count(kind)} blocks of type {kind:d}: one is possible"
    if BlockType.ISOCHRONOUS in types and not user[2] & ISOM_REQ:
        yield "a block of type 4 (isochronous), but IsoM_Req (DPV1_Status_3, bit 4) is not set"
    if user[2] & ISOM_REQ and BlockType.ISOCHRONOUS not in types:
        yield "IsoM_Req (DPV1_Status_3, bit 4) is set, but no block of type 4 (isochronous) follows"
    if BlockType.PRM_CMD in types and not user[2] & PRM_CMD:
        yield "a block of type 2 (prm_cmd), but PrmCmd (DPV1_Status_3, bit 7) is not set"
