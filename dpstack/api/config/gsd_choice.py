"""A [[slave]] table from the modules and parameters chosen in a GSD file."""

from __future__ import annotations

import re

from msgspec import Struct, field

from dpstack.api.config.toml import comment, table_lines
from dpstack.errors import GsdError
from dpstack.gsd.configuration import find_module, plug
from dpstack.gsd.identifiers import io_lengths
from dpstack.gsd.model import Device, Module


class Choice(Struct):
    """The choices. ``modules``: in slot order, None for an empty slot; ``parameters``: the changed ones."""

    name: str
    address: int
    gsd: str
    modules: list[Module | None]
    parameters: dict[str, int | str] = field(default_factory=dict)


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
    """The table, with identifier octets and user parameters as comments. Raises GsdError if the choices do not fit
    together.
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
    return "\n".join([*table_lines("[[slave]]", keys), *octet_remarks(configuration.config, prm.octets())]) + "\n"


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
