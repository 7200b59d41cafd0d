"""A [[slave]] table from the modules and parameters chosen in a GSD file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from dpstack.api.config.toml import quoted
from dpstack.errors import GsdError
from dpstack.gsd.configuration import Configuration, find_module, plug
from dpstack.gsd.model import Device, Module


@dataclass(slots=True)
class Choice:
    """The choices. ``modules``: in slot order, None for an empty slot; ``parameters``: the changed ones."""

    name: str
    address: int
    gsd: str
    modules: list[Module | None]
    parameters: dict[str, int | str] = field(default_factory=dict)


def module_key(device: Device, module: Module | None) -> int | str:
    """The entry of ``modules`` for ``module``: its name where that is enough, else its reference number.

    Raises GsdError where the file leaves no way.
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
    """The table, with identifier octets and user parameters as comments. Raises GsdError where the choices do not fit
    together.
    """
    configuration = plug(device, choice.modules)
    prm = configuration.user_prm()
    for name, value in choice.parameters.items():
        prm.set(name, value)
    keys: list[tuple[str, str]] = [
        ("name", quoted(choice.name)),
        ("address", str(choice.address)),
        ("gsd", quoted(choice.gsd)),
        ("modules", _list([module_key(device, module) for module in configuration.modules])),
    ]
    if device.ident is None:
        keys.append(("ident", quoted("ask")))
    if choice.parameters:
        keys.append(("parameters", _inline(choice.parameters)))
    lines = ["[[slave]]", *(f"{key} = {value}" for key, value in keys), *_remarks(configuration, prm.octets())]
    return "\n".join(lines) + "\n"


def _remarks(configuration: Configuration, user_prm: bytes) -> list[str]:
    return [
        f"# identifier octets {configuration.config.hex(' ').upper()}: {configuration.inputs} octets of inputs, "
        f"{configuration.outputs} of outputs",
        f"# user parameters {user_prm.hex(' ').upper() or 'none'}",
    ]


def _value(value: int | str) -> str:
    return quoted(value) if isinstance(value, str) else str(value)


def _list(values: Sequence[int | str]) -> str:
    return "[" + ", ".join(_value(value) for value in values) + "]"


def _inline(values: Mapping[str, int | str]) -> str:
    return "{ " + ", ".join(f"{quoted(key)} = {_value(value)}" for key, value in values.items()) + " }"
