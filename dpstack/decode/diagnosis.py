"""A diagnosis without its telegram, as a PLC gives it (SFC 13 of STEP 7): its octets from pasted text, and in words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

from dpstack.decode.log_text import LogReader, Unread, from_hex, padded, step7_octets
from dpstack.decode.names import SlaveNames
from dpstack.dp.pdu.alarm_blocks import full_text, parse_block
from dpstack.dp.pdu.diag_bits import FLAG
from dpstack.dp.pdu.diag_blocks import FIRST_SLOT, Block, DeviceBlock, IdentifierBlock
from dpstack.dp.pdu.diag_texts import texts_of
from dpstack.dp.pdu.diagnosis import FIXED_LEN, MAX_LEN, Diagnosis, view_of
from dpstack.errors import PduError, UsageError
from dpstack.fdl.codec import decode
from dpstack.text import octets_text, readable

_HEAD: Final = "station status 1, 2 and 3, the master's address, the ident number in two octets"


def diagnosis_octets(text: str) -> bytes:
    """The octets of a diagnosis in pasted ``text``: hex digits, a hex dump, or values of STEP 7 such as ``B#16#08`` and
    ``W#16#0C00`` among anything else. Raises UsageError.
    """
    octets = step7_octets(text)
    if not octets:
        try:
            octets = from_hex(padded(text))
        except UsageError as error:
            octets = _octets_in_lines(text)
            if not octets:
                raise error from None
    if decode(octets) is not None and len(octets) > 1:
        raise UsageError("this is a whole telegram: decode it without --diagnosis")
    if len(octets) < FIXED_LEN:
        raise UsageError(f"a diagnosis has {FIXED_LEN} octets or more, here are {len(octets)}: {_HEAD}")
    return octets


def may_be_diagnosis(text: str) -> bool:
    """Whether hex digits that make no telegram look like a diagnosis: status 2 with the bit that every slave sets,
    status 3 without its reserved ones."""
    try:
        diagnosis = Diagnosis.parse(from_hex(text))
    except UsageError:
        return False
    return diagnosis is not None and diagnosis.always_one and not diagnosis.status3 & ~FLAG["ext_diag_overflow"].mask


def _octets_in_lines(text: str) -> bytes:
    unread: list[Unread] = []
    reader = LogReader(unread.append)
    found = [one.octets for line in text.splitlines() for one in reader.add(line)]
    found += [one.octets for one in reader.end()]
    wrong = next((line for line in unread if line.reason), None)
    if wrong is not None:
        raise UsageError(f"line {wrong.number}: {wrong.reason}: {wrong.text}")
    return b"".join(found)


def diagnosis_report(octets: bytes, slave: SlaveNames, address: int | None = None) -> dict[str, Any]:
    """The diagnosis in ``octets`` as plain data: the object of ``dpstack decode --diagnosis --json``.

    ``slave``: names and texts of the station. Raises UsageError for octets that are no diagnosis.
    """
    used, padding = _without_padding(octets)
    diagnosis = Diagnosis.parse(used)
    if diagnosis is None:
        raise UsageError(f"a diagnosis has {MAX_LEN} octets at most, here are {len(used)}: {_HEAD}")
    texts = slave.texts
    device = None if texts is None else texts.device
    return {
        "octets": used.hex(),
        "address": address,
        "slave": slave.name or None,
        "ident": f"0x{diagnosis.ident:04X}",
        "vendor": None if device is None else device.vendor,
        "model": None if device is None else device.model,
        "names_from": slave.source or None,
        "state": view_of(diagnosis).value,
        "master": diagnosis.master,
        "flags": list(diagnosis.flags),
        "texts": list(diagnosis.texts),
        "blocks": list(_blocks(diagnosis, slave)),
        "padding": padding,
        "finding": diagnosis.ext_finding,
        "rest": diagnosis.ext_rest.hex(),
    }


def _without_padding(octets: bytes) -> tuple[bytes, int]:
    """The octets without the zeros behind the last block, and their number: the area of a PLC is often longer."""
    diagnosis = Diagnosis.parse(octets[:MAX_LEN])
    rest = b"" if diagnosis is None else diagnosis.ext_rest + octets[MAX_LEN:]
    if not rest or any(rest):
        return octets, 0
    return octets[: len(octets) - len(rest)], len(rest)


def _blocks(diagnosis: Diagnosis, slave: SlaveNames) -> Iterator[dict[str, object]]:
    """Each block with its first octet (from 1) and its lines."""
    at = FIXED_LEN + 1
    for block in diagnosis.blocks:
        dpv1 = slave.texts is not None and slave.texts.device.dpv1.slave
        lines = list(texts_of((block,), slave.texts, dpv1=dpv1))
        if isinstance(block, IdentifierBlock) and not lines:
            lines.append("no slot has a diagnosis")
        if slave.texts is None:
            lines += _if_dpv1(block)
        yield {"octet": at, "octets": block.octets.hex(), "texts": lines}
        at += len(block.octets)


def _if_dpv1(block: Block) -> Iterator[str]:
    """The meaning of a device related block if the slave is parameterised for DP-V1, which its octets do not say;
    nothing if its text begins in the octets of an alarm's type and slot."""
    if isinstance(block, DeviceBlock) and readable(block.data) == readable(block.data[3:]):
        try:
            message = parse_block(block.octets)
        except PduError:
            return
        yield f"in DP-V1: {full_text(message, FIRST_SLOT)}"


def diagnosis_lines(report: Mapping[str, Any]) -> Iterator[str]:
    """The report of :func:`diagnosis_report` for people."""
    device = " ".join(f"{report['vendor'] or ''} {report['model'] or ''}".split())
    who = "" if report["address"] is None else f"station {report['address']}"
    if report["slave"] is not None:
        who = f"slave {report['address']} ({report['slave']})"
    source = "" if report["names_from"] is None else f" (texts from {report['names_from']})"
    yield ", ".join(filter(None, (who, f"ident {report['ident']}", device))) + source
    master = "no master" if report["master"] is None else f"master {report['master']}"
    yield f"  {report['state']}, {master}"
    octets = bytes.fromhex(report["octets"])
    yield f"octets 1 to {FIXED_LEN}: {octets[:FIXED_LEN].hex(' ')}: {', '.join(report['flags']) or 'no flag is set'}"
    for text in report["texts"]:
        yield f"  {text}"
    for block in report["blocks"]:
        held = bytes.fromhex(block["octets"])
        first, last = block["octet"], block["octet"] + len(held) - 1
        yield f"{f'octet {first}' if first == last else f'octets {first} to {last}'}: {held.hex(' ')}"
        for text in block["texts"]:
            yield f"  {text}"
    if report["finding"] is not None:
        rest = bytes.fromhex(report["rest"]).hex(" ")
        yield f"wrong length: {report['finding']}{rest and ': '}{rest}"
    if report["padding"]:
        yield f"{octets_text(report['padding'])} of zeros behind it: the area of the PLC is longer than the diagnosis"
    if report["blocks"] and report["vendor"] is None:
        yield f"no GSD file with its ident number: dpstack gsd find {report['ident']}, then --gsd FILE, has more texts"
