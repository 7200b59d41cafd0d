"""Checks of a whole GSD file: defaults against constants, slots without modules, PROFIsafe, missing modules."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from dpstack.errors import GsdError
from dpstack.gsd.model import Device, Diagnostic, GsdFile, Module
from dpstack.gsd.prm import Reading, UserPrm, dpv1_note
from dpstack.trace import Severity


def check(file: GsdFile) -> tuple[Diagnostic, ...]:
    """The diagnostics of ``file`` and those of its user parameters, slots and modules, by place."""
    device = file.device
    warnings = [*_prm_warnings(device), *_slot_warnings(device)]
    for text in f_notes(device, device.modules, in_slots=False):
        line = next((module.line for module in device.modules if module.f_parameters), 0)
        warnings.append((0 if device.f_parameters else line, text))
    found = [Diagnostic(line, 1, Severity.WARNING, text) for line, text in warnings]
    if device.modular and not device.modules:
        text = "a modular station (Modular_Station = 1) without any Module: the file may be cut short; get a whole copy"
        found.append(Diagnostic(0, 0, Severity.WARNING, text))
    return tuple(sorted((*file.diagnostics, *found)))


def _prm_warnings(device: Device) -> Iterator[tuple[int, str]]:
    """(line, text) for user parameters that fit nowhere, and once for all defaults that contradict constant octets."""
    try:
        own = UserPrm(device)
    except GsdError as error:
        yield device.prm.line, str(error)
        return
    # the parser has reported the length of a User_Prm_Data that counts
    if (device.user_prm_data is None or device.user_prm_data_ignored) and (note := own.length_note):
        yield device.prm.line, note
    if not any(module.prm.present for module in device.modules) and (note := dpv1_note(device, len(own.octets()))):
        yield 0, note
    found = [(device.prm.line, "the device", contradiction) for contradiction in own.contradictions()]
    bare = Device(parameters=device.parameters)
    for module in device.modules:
        if module.prm.consts and module.prm.refs:
            try:
                prm = UserPrm(bare, (module,), in_slots=False)
            except GsdError as error:
                yield module.prm.line, f"module {module.title}: {error}"
                continue
            found += [(module.prm.line, f"module {module.title}", c) for c in prm.contradictions()]
    found = [item for item in found if item[2].matters]
    if found:
        line, title, first = min(found, key=lambda item: item[0])
        more = f"; {len(found) - 1} more in this file" if len(found) > 1 else ""
        yield (
            line,
            f"{title}: defaults contradict the constant octets ({first.field.local_key}: {first.readings}{more}); the "
            f'defaults are used, defaults = "{Reading.CONST.value}" takes the constants',
        )


def _slot_warnings(device: Device) -> Iterator[tuple[int, str]]:
    """(line, text) for each slot of SlotDefinition that no module can ever be plugged into."""
    first = device.first_slot
    last = first + device.max_module - 1 if device.max_module else None
    for slot in device.slots:
        if slot.number < first or (last is not None and slot.number > last):
            slots = f"slots begin with {first}" if last is None else f"slots are {first}..{last}"
            yield slot.line, f"Slot({slot.number}) is never used: the {slots} (Modul_Offset, else 1; Max_Module)"


def f_notes(device: Device, modules: Sequence[Module | None], *, in_slots: bool = True) -> tuple[str, ...]:
    """A note if ``device`` or ``modules`` have F_ parameters (PROFIsafe), else nothing.

    Without ``in_slots`` the note does not name the slots.
    """
    places = ["the device itself"] if device.f_parameters else []
    for slot, module in enumerate(modules, device.first_slot):
        if module is not None and module.f_parameters:
            places.append(f"module {module.title}" + (f" in slot {slot}" if in_slots else ""))
    if not places:
        return ()
    more = f" and {len(places) - 3} more" if len(places) > 3 else ""
    verb = "have" if len(places) > 1 else "has"
    return (
        f"{', '.join(places[:3])}{more} {verb} F_ parameters (PROFIsafe), but dpstack is no F-host: their F octets are "
        f"missing in Set_Prm, which the device may refuse, and nothing safety-related works; use an F-host for them",
    )
