"""Comparison of the configuration that Chk_Cfg asks for with the slave's own one, module by module.

Modules are distinguished by the GSD file if there is one, otherwise by identifiers.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from enum import Enum

from msgspec import Struct

from dpstack.errors import ConfigError
from dpstack.gsd.configuration import modules_of_config
from dpstack.gsd.identifiers import Identifier, agree, parse_identifiers
from dpstack.gsd.model import Device, Module, folded


class Difference(Enum):
    """How two configurations differ."""

    SAME = "same"
    ORDER = "order"
    MISSING = "missing"  # the slave lacks modules of the configuration
    EXTRA = "extra"  # the slave has more modules
    TYPE = "type"  # another module in one slot or more
    UNREADABLE = "unreadable"  # octets that are no identifiers


class Part(Struct, frozen=True):
    """One module: its identifier octets, and its name if that is known. ``at``: its first octet, from 1."""

    octets: bytes
    name: str
    at: int

    @property
    def is_empty(self) -> bool:
        """Whether it is the identifier octet of an empty slot."""
        return not any(self.octets)

    @property
    def title(self) -> str:
        """Its name, or that it is an empty slot; empty if the name is not known."""
        return "no module" if self.is_empty and not self.name else self.name

    @property
    def text(self) -> str:
        octets = self.octets.hex(" ").upper()
        return f"{self.name} ({octets})" if self.name else octets


class Comparison(Struct, frozen=True):
    """``slots``: the first slot that differs, and those that follow, with wanted and real module (None: none there).

    ``octet``: the first octet that differs, from 1; 0 if none does. ``key``: the key ``modules`` of a configuration
    that fits the slave; empty without a GSD file, and if the file does not name all of its modules one by one.
    """

    kind: Difference
    slots: tuple[tuple[int, Part | None, Part | None], ...] = ()
    octet: int = 0
    wanted: tuple[Part, ...] = ()
    real: tuple[Part, ...] = ()
    key: str = ""

    @property
    def sentences(self) -> list[str]:
        """The differences in words, four at most."""
        lines = []
        for slot, wanted, real in self.slots[:4]:
            has = "no module" if real is None else real.text
            wants = "no module" if wanted is None else wanted.text
            lines.append(f"Slot {slot}: the configuration has {wants}, the slave has {has}.")
        if len(self.slots) > 4:
            lines.append(f"{len(self.slots) - 4} more slots differ.")
        return lines

    @property
    def remedy(self) -> str:
        """Both ways out: other modules in the station, or other ones in the configuration. Empty without ``key``."""
        if not self.key:
            return ""
        plug = [f"{wanted.title} into slot {slot}" for slot, wanted, _ in self.slots if wanted is not None]
        is_short = self.kind is Difference.TYPE and len(plug) == len(self.slots) <= 3
        change = f"plug {', '.join(plug)}" if is_short else "plug the modules as they are configured"
        return f"{change}; or, if the station is right, write {self.key}"

    @property
    def short(self) -> str:
        """The first slot that differs in a few words, and how many more do; empty if none has a slot."""
        if not self.slots:
            return ""
        slot, wanted, real = self.slots[0]
        has, wants = ("no module" if one is None else one.title or one.text for one in (real, wanted))
        rest = len(self.slots) - 1
        more = f" ({rest} more {'slot differs' if rest == 1 else 'slots differ'})" if rest else ""
        return f"slot {slot} has {has}, the configuration {wants}{more}"


def compare_modules(
    wanted: bytes, real: bytes, device: Device | None = None, modules: Sequence[Module | None] = (), first_slot: int = 1
) -> Comparison:
    """Compare ``wanted`` (Chk_Cfg) with ``real`` (Get_Cfg). ``modules``: those that ``wanted`` was made of."""
    if agree(real, wanted):
        return Comparison(Difference.SAME)
    octet = next((at for at, (a, b) in enumerate(zip(wanted, real, strict=False), 1) if a != b), 0)
    octet = octet or min(len(wanted), len(real)) + 1
    ours = _of_modules(wanted, modules) or _parts(wanted, device)
    theirs = _like(real, ours) or _parts(real, device)
    if ours is None or theirs is None:
        return Comparison(Difference.UNREADABLE, octet=octet)
    count = max(len(ours), len(theirs))
    pairs = [(ours[at] if at < len(ours) else None, theirs[at] if at < len(theirs) else None) for at in range(count)]
    slots = tuple(
        (first_slot + at, one, other)
        for at, (one, other) in enumerate(pairs)
        if one is None or other is None or one.octets != other.octets
    )
    return Comparison(_kind(ours, theirs), slots, octet, tuple(ours), tuple(theirs), _modules_key(theirs, device))


def _modules_key(parts: Sequence[Part], device: Device | None) -> str:
    """``modules = ["8 DO", ""]`` for ``parts``; empty if a name is missing, or is that of several modules."""
    if device is None:
        return ""
    count = Counter(folded(module.name) for module in device.modules)
    names = ["" if part.is_empty and not part.name else part.name for part in parts]
    if any(count[folded(name)] != 1 for name, part in zip(names, parts, strict=True) if not part.is_empty or name):
        return ""
    return f"modules = {json.dumps(names, ensure_ascii=False)}"


def _kind(ours: Sequence[Part], theirs: Sequence[Part]) -> Difference:
    wanted, real = [part.octets for part in ours], [part.octets for part in theirs]
    if Counter(wanted) == Counter(real):
        return Difference.ORDER
    if len(real) < len(wanted) and _is_within(real, wanted):
        return Difference.MISSING
    if len(real) > len(wanted) and _is_within(wanted, real):
        return Difference.EXTRA
    plugged, asked = [one for one in real if any(one)], [one for one in wanted if any(one)]
    if len(wanted) == len(real):  # an empty slot has an identifier of its own
        if len(plugged) < len(asked) and all(a == b or not any(b) for a, b in zip(wanted, real, strict=True)):
            return Difference.MISSING
        if len(plugged) > len(asked) and all(a == b or not any(a) for a, b in zip(wanted, real, strict=True)):
            return Difference.EXTRA
    return Difference.TYPE


def _is_within(few: Sequence[bytes], many: Sequence[bytes]) -> bool:
    """Whether ``few`` is ``many`` with some left out."""
    rest = iter(many)
    return all(one in rest for one in few)


def _of_modules(config: bytes, modules: Sequence[Module | None]) -> list[Part] | None:
    """``config`` cut where ``modules`` end; None if it was not made of them."""
    octets = [b"\0" if module is None else module.config for module in modules]
    if not octets or b"".join(octets) != config:
        return None
    return _placed(octets, ["" if module is None else module.name for module in modules])


def _like(config: bytes, ours: Sequence[Part] | None) -> list[Part] | None:
    """``config`` cut into modules of our own configuration, in any order; None if other octets remain."""
    if not ours:
        return None
    names = {part.octets: part.name for part in reversed(ours)}
    known = sorted(names, key=len, reverse=True)
    octets: list[bytes] = []
    at = 0
    while at < len(config):
        found = next((one for one in known if config.startswith(one, at)), b"")
        if not found:
            return None
        octets.append(found)
        at += len(found)
    return _placed(octets, [names[one] for one in octets])


def _parts(config: bytes, device: Device | None) -> list[Part] | None:
    if device is not None:
        modules = modules_of_config(device, config)
        if modules is not None:
            return _of_modules(config, modules)
    try:
        identifiers: list[Identifier] = parse_identifiers(config)
    except ConfigError:
        return None
    names = [_name(identifier, device) for identifier in identifiers]
    return _placed([identifier.octets for identifier in identifiers], names)


def _name(identifier: Identifier, device: Device | None) -> str:
    if device is None:
        return ""
    fitting = (module.name for module in device.modules if module.complete and module.config == identifier.octets)
    return next(fitting, "")


def _placed(octets: Sequence[bytes], names: Sequence[str]) -> list[Part]:
    parts, at = [], 1
    for one, name in zip(octets, names, strict=True):
        parts.append(Part(one, name, at))
        at += len(one)
    return parts
