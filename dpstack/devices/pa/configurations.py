"""Configurations of a PA device: modules in slots by name, by identifier octets, and their values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from dpstack.devices.pa.layout import Layout, layout_of
from dpstack.devices.pa.model import FREE, PaFile, PaModule
from dpstack.errors import ConfigError
from dpstack.gsd.identifiers import MAX_IO
from dpstack.profile.model.drive_type import TelegramSpec
from dpstack.text import brief, nearest

#: between the modules in the name of a configuration
_COMMA: Final = ", "


def telegram_of(modules: Sequence[PaModule]) -> TelegramSpec:
    """The configuration of ``modules`` in the slots. Raises ConfigError if it does not fit into a frame."""
    inputs, outputs = (sum(one.lengths[way] for one in modules) for way in (0, 1))
    if max(inputs, outputs) > MAX_IO:
        raise ConfigError(
            f"its modules have {inputs} octets of inputs and {outputs} of outputs; a frame has {MAX_IO}: take some out"
        )
    return TelegramSpec(
        name=_COMMA.join(one.name for one in modules),
        config=b"".join(one.config for one in modules),
        outputs=outputs,
        inputs=inputs,
    )


def plugged(file: PaFile, given: Sequence[int | str]) -> TelegramSpec:
    """The configuration of the modules ``given`` by name, one for each slot; "" is a free place. Raises ConfigError."""
    return telegram_of(_modules(file, [FREE if one == "" else one for one in given]))


def named(file: PaFile, name: str) -> TelegramSpec:
    """The configuration called ``name``, the names of its modules with commas between. Raises ConfigError."""
    return telegram_of(modules_named(file, name))


def modules_named(file: PaFile, name: str) -> list[PaModule]:
    """The modules of the configuration ``name``. Raises ConfigError."""
    return _modules(file, [one.strip() for one in name.split(_COMMA.strip())])


def _modules(file: PaFile, names: Sequence[int | str]) -> list[PaModule]:
    if not names or (file.slots and len(names) > len(file.slots)):
        there = f"it has {len(file.slots)} slots" if names else "name one"
        raise ConfigError(f"{file.name}: {len(names)} modules; {there}")
    return [_module(file, number, name) for number, name in enumerate(names, 1)]


def _module(file: PaFile, number: int, name: int | str) -> PaModule:
    """The module called ``name`` in any case, if the slot may have it. Raises ConfigError."""
    may = file.slots[number - 1].modules if file.slots else tuple(file.modules)
    wanted = str(name).strip().lower()
    found = next((one for one in may if one.lower() == wanted), None)
    if found is None:
        near = nearest(str(name), may)
        hint = f"did you mean {near!r}?" if near else f"it may have {', '.join(may)}"
        raise ConfigError(f"{file.name}: slot {number} has no module {brief(str(name))}; {hint}")
    return file.modules[found]


def of_config(file: PaFile, config: bytes) -> TelegramSpec | None:
    """The configuration with these identifier octets; None if the slots cannot have them."""
    found = _fitting(file, config, 0, 0, set())
    return telegram_of(found) if found else None


def _fitting(file: PaFile, config: bytes, at: int, slot: int, dead: set[tuple[int, int]]) -> list[PaModule] | None:
    """The modules from ``slot`` on whose identifiers are ``config`` from the octet ``at`` on; None if they fit nowhere.
    ``dead``: places that are known to lead nowhere, so that identifiers that begin others cost no time."""
    if at == len(config):
        return []
    if (at, slot) in dead or (file.slots and slot >= len(file.slots)):
        return None
    for name in file.slots[slot].modules if file.slots else file.modules:
        module = file.modules[name]
        if config.startswith(module.config, at):
            rest = _fitting(file, config, at + len(module.config), slot + 1, dead)
            if rest is not None:
                return [module, *rest]
    dead.add((at, slot))
    return None


def layout_of_telegram(file: PaFile, telegram: str) -> Layout:
    """The values of the configuration ``telegram``. Raises ConfigError."""
    return layout_of(file, modules_named(file, telegram))
