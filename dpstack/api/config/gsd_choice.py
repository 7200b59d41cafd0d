"""A [[slave]] table from the modules and parameters chosen in a GSD file."""

from __future__ import annotations

import re
from collections.abc import Sequence

from msgspec import Struct, field

from dpstack.api.config.channel_names import name_lines, slot_remarks
from dpstack.dp.channels import channels
from dpstack.dp.slot_map import SlotMap, slot_map
from dpstack.errors import GsdError
from dpstack.gsd.configuration import find_module, plug
from dpstack.gsd.diag_texts import DiagTexts
from dpstack.gsd.identifiers import io_lengths
from dpstack.gsd.model import Device, Module
from dpstack.toml.reading import comment, table_lines


class Choice(Struct):
    """The choices. ``modules``: in slot order, None for an empty slot; ``parameters``: the changed ones."""

    name: str
    address: int
    gsd: str
    modules: list[Module | None]
    parameters: dict[str, int | str] = field(default_factory=dict)
    #: whether the proposed names for its channels are taken
    names: bool = False


def module_key(device: Device, module: Module | None) -> int | str:
    """The entry of ``modules`` for ``module``: its name if that is enough, else its reference number.

    Raises GsdError if the file leaves no way.
    """
    if module is None:
        return ""
    for key in (module.name, module.reference):
        if key is None or key == "":
            continue
        try:
            found = find_module(device, key)
        except GsdError:
            continue
        if (found.config, found.prm) == (module.config, module.prm):
            return key
    raise GsdError(f"module {module.title} has the name of another and no number of its own; use ident and config")


def as_toml(device: Device, choice: Choice) -> str:
    """The table, with identifier octets, user parameters and slots as comments, then names for the channels. Raises
    GsdError if the choices do not fit together.
    """
    configuration = plug(device, choice.modules)
    prm = configuration.user_prm()
    for name, value in choice.parameters.items():
        prm.set(name, value)
    keys: dict[str, object] = {
        "name": choice.name,
        "address": choice.address,
        "gsd": choice.gsd,
        "modules": [module_key(device, module) for module in configuration.modules],
        "ident": "ask" if device.ident is None else None,
        "parameters": choice.parameters or None,
    }
    slots = slots_of(device, configuration.modules)
    lines = [
        *table_lines("[[slave]]", keys),
        *octet_remarks(configuration.config, prm.octets()),
        *slot_remarks(slots),
        *name_lines(slots, taken=choice.names),
    ]
    return "\n".join(lines) + "\n"


def slots_of(device: Device, modules: Sequence[Module | None]) -> SlotMap:
    """The slots of ``device`` with these modules. Raises GsdError if they do not fit together."""
    configuration = plug(device, modules)
    return slot_map(configuration.config, DiagTexts(device, configuration.modules))


def channel_names(slots: SlotMap) -> list[str]:
    """The proposed names of all channels."""
    return [channel.field.name for channel in channels(slots)]


def octet_remarks(config: bytes, user_prm: bytes) -> list[str]:
    """Comments with the octets of Chk_Cfg and Set_Prm. Raises ConfigError if ``config`` contradicts itself."""
    inputs, outputs = io_lengths(config)
    return [
        comment(f"identifier octets {config.hex(' ').upper()}: {inputs} octets of inputs, {outputs} of outputs"),
        comment(f"user parameters {user_prm.hex(' ').upper() or 'none'}"),
    ]


def base_name(model: str) -> str:
    """A name for a slave of that model, in front of its address: the words of the model in lower case."""
    return "-".join(re.findall(r"\w+", model.lower())) or "slave"
