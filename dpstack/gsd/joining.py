"""Builds the model (Device) from the parsed blocks: gives parameters their texts and checks the references."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Final

from dpstack.errors import ConfigError
from dpstack.gsd.blocks import DeviceBlock, ParameterBlock, PrmTextBlock
from dpstack.gsd.identifiers import io_lengths
from dpstack.gsd.model import Device, Findings, Module, Parameter, PrmBlock
from dpstack.gsd.settings import Settings

#: the most texts of all parameters together: users that show them see parameters times texts
MAX_TEXTS: Final = 1_000_000


def join(block: DeviceBlock, findings: Findings) -> Device:
    settings = Settings(block.settings, findings)
    fields = settings.device_fields()
    parameters = _parameters(block.parameters, block.prm_texts, findings)
    for number in sorted(block.used.keys() - parameters.keys()):
        message = f"ExtUserPrmData {number} is referred to but nowhere defined; the reference is skipped"
        findings.warning(block.used[number], message)
    for module in block.modules:
        problem = _identifier_problem(module.config)
        if problem and module.complete:
            findings.warning(module.line, f"module {module.name!r}: {problem}")
        if module.prm.present:
            _check_length(module, parameters, findings)
    device = Device(
        **fields,
        modules=tuple(block.modules),
        slots=tuple(sorted(block.slots, key=lambda slot: slot.number)),
        parameters=parameters,
        prm=PrmBlock(None, tuple(block.consts), tuple(block.refs), block.prm_line),
        diagnosis=block.diagnosis(),
        diag_types=tuple(block.diag_types),
        settings={keyword: statement.value for keyword, statement in block.settings.items()},
        raw=tuple(block.raws),
    )
    _check_device(device, settings, findings)
    return device


def _parameters(
    blocks: Mapping[int, ParameterBlock], texts: Mapping[int, PrmTextBlock], findings: Findings
) -> dict[int, Parameter]:
    found: dict[int, Parameter] = {}
    left = MAX_TEXTS
    for ref, block in blocks.items():
        text_ref = block.fields.get("text_ref")
        if "type" not in block.fields:
            findings.warning(block.line, f"ExtUserPrmData {ref} ({block.name!r}) has no readable type; left out")
            continue
        prm_text = None if text_ref is None else texts.get(text_ref)
        if prm_text is None and text_ref is not None:
            message = f"ExtUserPrmData {ref} refers to PrmText {text_ref}, which is nowhere defined"
            findings.warning(block.line, message)
        if prm_text is not None:
            if left >= 0 and (left := left - len(prm_text.texts)) < 0:
                findings.error(block.line, f"more than {MAX_TEXTS} texts of parameters: from here on they have none")
            prm_text = prm_text if left >= 0 else None
        known = {} if prm_text is None else prm_text.texts
        found[ref] = Parameter(ref, block.name, **block.fields, texts=known)
    return found


@functools.lru_cache(maxsize=1000)
def _identifier_problem(config: bytes) -> str:
    """The mistake in the identifier octets of a module, empty for none. Many modules have the same octets."""
    try:
        io_lengths(config)
    except ConfigError as error:
        return str(error)
    return "" if config else "no identifier octets; it changes nothing in a configuration"


def _check_length(module: Module, parameters: Mapping[int, Parameter], findings: Findings) -> None:
    """Report parameters of a module beyond its Ext_Module_Prm_Data_Len."""
    prm = module.prm
    if prm.length is None:
        message = f"module {module.name!r} has parameters but no Ext_Module_Prm_Data_Len; as long as they reach"
        findings.warning(prm.line, message)
        return
    reach = reach_of(prm, parameters)
    if reach > prm.length:
        message = (
            f"module {module.name!r}: parameters reach to octet {reach}, Ext_Module_Prm_Data_Len is {prm.length}; "
            f"the octets beyond it are left out"
        )
        findings.warning(prm.line, message)


def reach_of(prm: PrmBlock, parameters: Mapping[int, Parameter]) -> int:
    """Octets that the constants and references of ``prm`` take."""
    ends = [const.offset + len(const.octets) for const in prm.consts]
    for ref in prm.refs:
        parameter = parameters.get(ref.number)
        ends.append(ref.offset + (0 if parameter is None else parameter.type.size))
    return max(ends, default=0)


def _check_device(device: Device, settings: Settings, findings: Findings) -> None:
    """Report the faults of the file as a whole."""
    if device.ident is None:
        findings.error(1, "no Ident_Number: the file is damaged, or it is of no DP slave; get a whole copy of it")
    if not device.speeds:
        findings.warning(1, "no baud rate is declared (500_supp = 1 and so on)")
    if device.station_type not in (None, 0):
        findings.warning(settings.line("station_type"), "Station_Type is not 0: the file is of a master")
    data, length = device.user_prm_data, device.user_prm_data_len
    if data is not None and length is not None and len(data) != length and not device.user_prm_data_ignored:
        message = f"User_Prm_Data has {len(data)} octets, User_Prm_Data_Len is {length}; all {len(data)} are used"
        findings.warning(settings.line("user_prm_data"), message)
    known = {module.reference for module in device.modules}
    for slot in device.slots:
        if slot.default is not None and slot.default not in known:
            message = f"Slot({slot.number}): no module has the reference {slot.default}, its default"
            findings.warning(slot.line, message)
