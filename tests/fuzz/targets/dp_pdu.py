"""The PDUs of DP-V0: an error is a PduError or ConfigError; PDUs that were read can be built and read again."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dpstack.dp.pdu.diag_blocks import UserDiag, split_blocks
from dpstack.dp.pdu.diagnosis import FIXED_LEN, MAX_LEN, Diagnosis
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dp.pdu.prm_blocks import PrmBlock, parse_blocks
from dpstack.dp.pdu.requests import MAX_REM_SLAVE_DATA, GlobalControl, SetPrm, SetSlaveAdd
from dpstack.errors import ConfigError, PduError
from dpstack.gsd.identifiers import MAX_IO, agree, config_for, io_lengths, parse_identifiers
from dpstack.params import DPV1_STATUS_LEN, MAX_STATION
from tests.fuzz.frame import Target, assert_plain, parsed


def run(octets: bytes) -> None:
    """The first octet chooses the PDU, the others are its octets."""
    if octets:
        _PDUS[octets[0] % len(_PDUS)](octets[1:])


def _diagnosis(octets: bytes) -> None:
    found = Diagnosis.parse(octets)
    assert (found is None) == (not FIXED_LEN <= len(octets) <= MAX_LEN)
    if found is None:
        return
    assert found.build() == octets
    assert b"".join(block.octets for block in found.blocks) + found.ext_rest == found.ext
    assert len(found.flags) == len(found.texts)
    assert set(found.conspicuous(exchanging=True) + found.conspicuous(exchanging=False)) <= set(found.findings)


def _user_diag(octets: bytes) -> None:
    room, ext = (octets[0], octets[1:]) if octets else (0, b"")
    limited = UserDiag(ext).limited(room)
    assert len(limited.ext) <= room
    assert ext.startswith(limited.ext)
    assert limited.overflow == (limited.ext != ext)
    if split_blocks(ext)[1] is None:
        assert split_blocks(limited.ext)[1] is None


def _set_prm(octets: bytes) -> None:
    found = parsed(SetPrm.parse, octets, PduError)
    if found is None:
        return
    if found.watchdog is not None and 0 in found.watchdog:
        assert parsed(lambda _: found.build(), b"", PduError) is None
        return
    assert SetPrm.parse(found.build()) == found


def _global_control(octets: bytes) -> None:
    found = parsed(GlobalControl.parse, octets, PduError)
    assert (found is None) == (len(octets) != 2)
    assert found is None or found.build() == bytes((octets[0] & 0x3E, octets[1]))


def _set_slave_add(octets: bytes) -> None:
    found = parsed(SetSlaveAdd.parse, octets, PduError)
    if found is not None and found.address <= MAX_STATION and len(found.rem_slave_data) <= MAX_REM_SLAVE_DATA:
        assert SetSlaveAdd.parse(found.build()) == found


def _identifiers(octets: bytes) -> None:
    found = parsed(parse_identifiers, octets, ConfigError)
    half = len(octets) // 2
    agree(octets[:half], octets[half:])
    assert agree(octets, octets)
    if found is None:
        return
    assert b"".join(one.octets for one in found) == octets
    inputs, outputs = io_lengths(octets)
    assert (inputs, outputs) == (sum(one.inputs for one in found), sum(one.outputs for one in found))
    if max(inputs, outputs) <= MAX_IO:
        assert io_lengths(config_for(inputs, outputs)) == (inputs, outputs)


def _prm_blocks(octets: bytes) -> None:
    found = parsed(parse_blocks, octets, PduError)
    if found is None:
        return
    assert b"".join(block.octets for block in found) == octets
    for block in found:
        assert_plain(block.title)
        content = block.content
        if content is not None:
            assert PrmBlock.of(content, block.slot, kind=block.type, specifier=block.specifier) == block


def _dpv1_status(octets: bytes) -> None:
    if len(octets) <= DPV1_STATUS_LEN:
        return
    wanted = Dpv1(alarms=("process",), alarm_mode=octets[0] & 7, structured=bool(octets[0] & 8))
    user_prm = bytearray(octets[1:])

    def apply(_: bytes) -> bool:
        wanted.apply(user_prm)
        return True

    if parsed(apply, b"", ConfigError):
        assert user_prm[0] & 0x80
        assert user_prm[2] & 7 == octets[0] & 7
        if user_prm[2] & 8 and wanted.structured:
            parse_blocks(bytes(user_prm[DPV1_STATUS_LEN:]))


_PDUS: Final[tuple[Callable[[bytes], None], ...]] = (
    _diagnosis,
    _user_diag,
    _set_prm,
    _global_control,
    _set_slave_add,
    _identifiers,
    _prm_blocks,
    _dpv1_status,
)


def repair(octets: bytes) -> bytes:
    """Give each block of structured parameters a length that reaches the next one."""
    if not octets or _PDUS[octets[0] % len(_PDUS)] is not _prm_blocks:
        return octets
    out, at = bytearray(octets), 1
    while at + 4 <= len(out):
        out[at] = min(max(out[at] % 40, 4), len(out) - at)
        if len(out) - at - out[at] < 4:
            out[at] = len(out) - at if len(out) - at < 235 else 4
        at += out[at]
    return bytes(out)


TARGET = Target(run, covers=("dpstack.dp.pdu", "dpstack.gsd.identifiers"), max_len=260, repair=repair)
