"""``dpstack gsd configure``: a dialogue that makes a [[slave]] table from a GSD file.

Questions go to stderr and the table to stdout, so that its output can be appended to a configuration; answers may come
from a pipe. An impossible answer is refused with the reason, and the question comes again. After the end of input
every question gets its default; a question without one ends the command, and nothing is written.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Final

from dpstack.api.config.config import Config, load_config
from dpstack.api.config.gsd_choice import Choice, as_toml, base_name, channel_names, module_key, slots_of
from dpstack.cli import options
from dpstack.cli.terminal import output
from dpstack.cli.terminal.questions import Questions, say
from dpstack.errors import GsdError
from dpstack.gsd.configuration import default_modules, find_module, fixed_modules, is_fixed, plug
from dpstack.gsd.model import Device, GsdFile, Module, folded, ranges_text
from dpstack.gsd.prm import PrmField, containing, is_slot_number, value_of
from dpstack.text import some_of

#: longest list of modules that is printed without a request
_LISTED = 40
#: answer that ends the modules or the parameters
_DONE: Final = "done"
#: answer that takes the module of the last slot away
_BACK: Final = "back"
#: modules or channels named in a message, of several
_NAMED: Final = 6


class Dialogue(Questions):
    """``beside``: path of the configuration that the table is for, which need not exist; None: without one."""

    def __init__(self, file: GsdFile, path: str, beside: str | None) -> None:
        super().__init__("gsd configure", "table")
        self._file = file
        self._device = file.device
        self._config = _existing(beside)
        self._path = path if beside is None else _seen_from(path, beside)

    def run(self) -> int:
        """Ask, then print the table."""
        device = self._device
        say(f"{device.vendor} {device.model}".strip() or self._path)
        base = base_name(device.model)
        name = self.ask(f"name [{base}-ADDRESS]: ", self._name, "")
        address = self.ask("address, 0..125: ", self._address)
        if not name:
            name = self._name(f"{base}-{address}")
        choice = Choice(name, address, self._path, self._modules())
        self._parameters(choice)
        self._names(choice)
        output.toml(as_toml(device, choice))
        return 0

    # --- name and address -------------------------------------------------------------------------------------------

    def _name(self, answer: str) -> str:
        if not answer.isprintable():
            raise GsdError("a name of printable characters is wanted; type one")
        if answer and self._config is not None and any(slave.name == answer for slave in self._config.slaves):
            raise GsdError(f"the configuration has a slave {answer!r} already; type another name")
        return answer

    def _address(self, answer: str) -> int:
        try:
            address = options.address(answer)
        except argparse.ArgumentTypeError as error:
            raise GsdError(str(error)) from None
        if self._config is not None:
            owners = {slave.address: slave.name for slave in self._config.slaves}
            owners[self._config.bus.address] = "the master"
            if address in owners:
                raise GsdError(f"address {address} is taken in the configuration ({owners[address]}); type another one")
        return address

    # --- modules ----------------------------------------------------------------------------------------------------

    def _modules(self) -> list[Module | None]:
        """The modules: fixed presets, the file's default modules if accepted, then one answer for each further slot."""
        device = self._device
        chosen: list[Module | None] = list(fixed_modules(device))
        if chosen:
            say("fixed presets, always plugged: " + _places(device, chosen))
        else:
            preset = default_modules(device)
            if preset is not None:
                say("preset: " + _places(device, preset))
                if self.ask("take these modules, y or n [y]: ", _yes, "y"):
                    chosen = list(preset)
        if self._room(chosen):
            if len(device.modules) <= _LISTED:
                self._list_modules("")
            say(
                "a module is its name, the beginning of one name only, or its number; /text lists those whose name "
                "contains text, ? lists all, - is an empty slot, back returns to the slot before, an empty line or "
                "done ends"
            )
        while self._room(chosen):
            answer = self.ask(
                self._slot_prompt(chosen), lambda text: self._slot(chosen, text), _DONE, self._list_modules
            )
            if answer == _DONE:
                break
            if answer == _BACK:
                chosen.pop()
            else:
                chosen.append(answer if isinstance(answer, Module) else None)
        return chosen

    def _room(self, chosen: list[Module | None]) -> bool:
        """True while a further module can be plugged behind ``chosen``."""
        device = self._device
        if all(is_fixed(device, module) for module in device.modules):
            return False
        limit = device.max_module if device.modular else 1
        return not limit or len(chosen) < limit

    def _slot_prompt(self, chosen: list[Module | None]) -> str:
        number = self._device.first_slot + len(chosen)
        slot = next((slot for slot in self._device.slots if slot.number == number), None)
        hint = f" {slot.name} ({ranges_text(slot.allowed) or 'any'})" if slot else ""
        return f"slot {number}{hint}: "

    def _slot(self, chosen: list[Module | None], answer: str) -> Module | str | None:
        """A module, None for an empty slot, ``done`` or ``back``."""
        if answer == _BACK and not self._device.modules_named(answer):
            if len(chosen) == len(fixed_modules(self._device)):
                raise GsdError("this is the first slot that can be chosen")
            return _BACK
        if answer == _DONE and not self._device.modules_named(answer):
            if not any(chosen):
                raise GsdError("no module is chosen yet; type a name or a number, ? lists them")
            return _DONE
        module = None if answer == "-" else self._module(answer)
        module_key(self._device, module)
        if module is not None:
            plug(self._device, [*chosen, module])
        return module

    def _module(self, answer: str) -> Module:
        """The module with this name or number, else the only one whose name begins with it, whatever case and blanks.

        Raises GsdError.
        """
        device = self._device
        beginning = _squeezed(answer)
        named = [module for module in device.modules if _squeezed(module.name).startswith(beginning)]
        if not named or device.modules_named(answer) or _is_number(device, answer):
            return find_module(device, answer)
        names = list(dict.fromkeys(module.name for module in named))
        if len(names) > 1:
            some = some_of(names, _NAMED)
            raise GsdError(f"{len(names)} modules begin with {answer!r}: {some}; type more of the name")
        say(f"  {names[0]}")
        return find_module(device, names[0])

    def _list_modules(self, part: str) -> None:
        """Print the modules whose name, info text or number contains ``part``; all if it is empty."""
        modules = [module for module in self._device.modules if not is_fixed(self._device, module)]
        numbers = ["" if module.reference is None else str(module.reference) for module in modules]
        texts = [f"{module.name} {module.info} {n}" for module, n in zip(modules, numbers, strict=True)]
        found = set(containing(part, texts) if part else texts)
        for module, number, text in zip(modules, numbers, texts, strict=True):
            if text in found:
                say(f"  {number:>6}  {module.name}  ({module.config.hex(' ').upper()})")
        if not found:
            say(f"  no module has {part!r} in its name")

    # --- names ------------------------------------------------------------------------------------------------------

    def _names(self, choice: Choice) -> None:
        """Show the slots, and ask whether the table shall have the proposed names."""
        slots = slots_of(self._device, choice.modules)
        for slot in slots.slots:
            if not slot.is_empty:
                say(f"  {slot.text}")
        proposed = channel_names(slots)
        if proposed:
            some = some_of(proposed, _NAMED)
            choice.names = self.ask(f"names for the channels ({some}), y or n [n]: ", _yes, "n")

    # --- parameters -------------------------------------------------------------------------------------------------

    def _parameters(self, choice: Choice) -> None:
        """Ask for every parameter that may be changed; the values that differ from the default go into ``choice``."""
        configuration = plug(self._device, choice.modules)
        for note in configuration.notes:
            say(f"note: {note}")
        prm = configuration.user_prm()
        fields = [
            field
            for field in prm.fields
            if field.parameter.visible and field.parameter.changeable and not is_slot_number(field.parameter)
        ]
        if not fields or not self.ask(f"parameters: {len(fields)}; go through them, y or n [n]: ", _yes, "n"):
            return
        say("an empty line keeps the value, done keeps all that follow")
        for field in fields:
            prompt = f"{field.key} ({_allowed(field)}) [{field.text}]: "
            value = self.ask(prompt, lambda text, field=field: _value(field, text), "")  # type: ignore[misc]
            if value is None:
                break
            if value != field.value:
                choice.parameters[prm.shortest_key(field)] = _written(field, value)


def _existing(path: str | None) -> Config | None:
    """The configuration at ``path``; None without one, or if it is empty. Raises ConfigError."""
    if path is None:
        return None
    if not os.path.exists(path) or (os.path.isfile(path) and not os.path.getsize(path)):
        return None
    return load_config(path)


def _seen_from(path: str, config: str) -> str:
    """``path`` of a GSD file as the configuration at ``config`` names it; a bundled device's name stays as it is."""
    file = Path(path)
    if not os.path.exists(file) or file.is_absolute():
        return path
    return os.path.relpath(file.resolve(), Path(config).resolve().parent)


def _places(device: Device, modules: list[Module | None] | tuple[Module, ...]) -> str:
    numbered = enumerate(modules, device.first_slot)
    return ", ".join(f"slot {n} {module.name}" for n, module in numbered if module is not None)


def _squeezed(name: str) -> str:
    """``name`` without blanks and in one case."""
    return folded(name).replace(" ", "")


def _is_number(device: Device, answer: str) -> bool:
    """Whether ``answer`` is the reference number of a module."""
    return answer.isdecimal() and len(answer) < 12 and device.module_numbered(int(answer)) is not None


def _yes(answer: str) -> bool:
    if answer.lower() not in ("y", "yes", "n", "no"):
        raise GsdError("y or n")
    return answer.lower().startswith("y")


def _value(field: PrmField, answer: str) -> int | None:
    """The number for ``answer``: an empty one keeps the value, ``done`` is None unless it is a text of the list."""
    if not answer:
        return field.value
    if answer == _DONE and _DONE not in map(folded, field.parameter.choices.values()):
        return None
    return value_of(field.parameter, answer)


def _written(field: PrmField, value: int) -> int | str:
    """``value`` as the table has it: its text if no other value has that text too."""
    text = field.parameter.texts.get(value)
    if text is None or sum(folded(text) == folded(other) for other in field.parameter.choices.values()) > 1:
        return value
    return text


def _allowed(field: PrmField) -> str:
    parameter = field.parameter
    return ", ".join(parameter.choices.values()) or ranges_text(parameter.allowed or (parameter.type.limits,))
