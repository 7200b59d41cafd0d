"""What a whole file leaves to be said once it is read: defaults that contradict their constants, missing modules."""

from __future__ import annotations

from collections.abc import Iterator

from dpstack.errors import GsdError
from dpstack.gsd.model import Device, Diagnostic, GsdFile, ordered
from dpstack.gsd.prm import UserPrm
from dpstack.trace import Severity


def check(file: GsdFile) -> tuple[Diagnostic, ...]:
    """The diagnostics of ``file`` and those on its user parameters and modules, by place."""
    found = [*file.diagnostics, *_prm_findings(file.device)]
    if file.device.modular and not file.device.modules:
        text = "a modular station (Modular_Station = 1) without any Module: the file may be cut short; get a whole copy"
        found.append(Diagnostic(0, 0, Severity.WARNING, text))
    return ordered(found)


def _prm_findings(device: Device) -> Iterator[Diagnostic]:
    try:
        own = UserPrm(device)
    except GsdError as error:
        yield Diagnostic(device.prm.line, 1, Severity.WARNING, str(error))
        return
    yield from _contradictions(own, "the device", device.prm.line)
    for module in device.modules:
        if module.prm.consts and module.prm.refs:
            bare = Device(parameters=device.parameters)
            try:
                yield from _contradictions(UserPrm(bare, (module,)), f"module {module.title}", module.prm.line)
            except GsdError as error:
                yield Diagnostic(module.prm.line, 1, Severity.WARNING, f"module {module.title}: {error}")


def _contradictions(prm: UserPrm, title: str, line: int) -> Iterator[Diagnostic]:
    found = prm.contradictions()
    if found:
        more = f" and {len(found) - 1} more" if len(found) > 1 else ""
        text = found[0].text.partition("/")[2]
        yield Diagnostic(
            line,
            1,
            Severity.WARNING,
            f"{title}: defaults contradict the constant octets ({text}{more}); the defaults are used unless asked",
        )
