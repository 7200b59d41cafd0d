"""Telegrams of the F5 operator: made of modules, named ``[PCH+]OUTPUTS/INPUTS`` in octets
(docs/reference/drives/keb-f5.md#gsd-facts).

Parameter channel B7, 1..8 octets of outputs A0..A7, 1..8 of inputs 90..97, at most 3 modules, 16 octets each way.
"""

from __future__ import annotations

import re
from typing import Final, NamedTuple

from dpstack.profile import ConfigError, TelegramFamily, TelegramSpec

PCH: Final = 0xB7
_OUT, _IN = 0xA0, 0x90
_MOST: Final = 8
#: of the printed GSD
MAX_MODULES: Final = 3
MAX_OCTETS: Final = 16
#: process data of two blocks
_MAX_PROCESS: Final = 16

_FIRST: Final = "inputs-first"
_OWN: Final = "own-gsd"
HOW: Final = (
    "[PCH+]OUTPUTS/INPUTS, modules of 1..8 octets, e.g. PCH+4/4, 4/8, 8+2/4 or PCH+0/4; behind it inputs-first "
    "(the input modules lead), own-gsd (more than the printed GSD has)"
)
_NAME: Final = re.compile(r"(PCH(?:\+|$))?(?:(\d(?:\+\d)*)/(\d(?:\+\d)*))?")


class Modules(NamedTuple):
    """The modules of a configuration: octets of each."""

    channel: bool
    outputs: tuple[int, ...]
    inputs: tuple[int, ...]
    inputs_first: bool = False

    @property
    def config(self) -> bytes:
        outputs, inputs = [_OUT + n - 1 for n in self.outputs], [_IN + n - 1 for n in self.inputs]
        process = inputs + outputs if self.inputs_first else outputs + inputs
        return bytes(([PCH] if self.channel else []) + process)

    def excess(self) -> str | None:
        """The rule of the printed GSD that the modules break; None if they break none."""
        modules = self.channel + len(self.outputs) + len(self.inputs)
        channel = 8 if self.channel else 0
        if modules > MAX_MODULES:
            return f"{modules} modules, the printed GSD (V2.2) allows {MAX_MODULES}"
        if max(sum(self.outputs), sum(self.inputs)) + channel > MAX_OCTETS:
            return f"more than {MAX_OCTETS} octets one way, which the printed GSD (V2.2) does not allow"
        return None

    def impossible(self) -> str | None:
        """The limit of every operator that the modules exceed; None if they exceed none."""
        if not self.channel and not self.outputs and not self.inputs:
            return "it has no modules"
        if any(not 1 <= n <= _MOST for n in (*self.outputs, *self.inputs)):
            return f"modules have 1..{_MOST} octets"
        if max(sum(self.outputs), sum(self.inputs)) > _MAX_PROCESS:
            return f"the operator has at most {_MAX_PROCESS} octets of process data each way"
        return None

    def spec(self) -> TelegramSpec:
        """The telegram; ``made_up`` if it goes beyond the printed GSD."""
        more = self.excess() is not None
        sizes = "/".join("+".join(map(str, modules)) or "0" for modules in (self.outputs, self.inputs))
        name = "PCH" if sizes == "0/0" else ("PCH+" if self.channel else "") + sizes
        name += f" {_FIRST}" if self.inputs_first else ""
        return TelegramSpec(
            name=name + (f" {_OWN}" if more else ""),
            config=self.config,
            outputs=sum(self.outputs),
            inputs=sum(self.inputs),
            channel=self.channel,
            made_up=more,
        )


def named(name: str) -> TelegramSpec:
    """The telegram called ``name`` (any case). Raises ConfigError that says how names are written."""
    first, *words = name.split() or [""]
    match = _NAME.fullmatch(first.upper())
    extras = {word.lower() for word in words}
    if match is None or extras - {_FIRST, _OWN} or not first or (match[1] == "PCH+" and match[2] is None):
        raise ConfigError(f"{name!r} is no telegram of keb-f5; write {HOW}")
    modules = Modules(match[1] is not None, _sizes(match[2]), _sizes(match[3]))
    if _FIRST in extras and modules.inputs and modules.outputs:
        modules = modules._replace(inputs_first=True)
    wrong, more = modules.impossible(), modules.excess()
    if wrong is not None:
        raise ConfigError(f"telegram {name!r}: {wrong}; write {HOW}")
    if more is not None and _OWN not in extras:
        raise ConfigError(f"telegram {name!r}: {more}; if a newer GSD of yours does, name it '{name} {_OWN}'")
    return modules.spec()


def _sizes(text: str | None) -> tuple[int, ...]:
    return () if text in (None, "0") else tuple(int(n) for n in (text or "").split("+"))


def of_config(config: bytes) -> TelegramSpec | None:
    """The telegram with these identifier octets; None for other octets. Outputs and inputs in either order."""
    channel = config[:1] == bytes([PCH])
    rest = config[1:] if channel else config
    outputs = tuple(octet - _OUT + 1 for octet in rest if _OUT <= octet < _OUT + _MOST)
    inputs = tuple(octet - _IN + 1 for octet in rest if _IN <= octet < _IN + _MOST)
    for first in (False, True):
        modules = Modules(channel, outputs, inputs, first)
        if modules.config == config:
            return None if modules.impossible() else modules.spec()
    return None


FAMILY: Final = TelegramFamily(named, of_config)
