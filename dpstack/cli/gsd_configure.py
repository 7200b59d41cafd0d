"""``dpstack gsd configure``: asks its way from a GSD file to a [[slave]] table.

Questions go to stderr and the table to stdout, so that its output can be appended to a configuration; answers may come
from a pipe. An answer that cannot be is refused with the reason and asked for again; the end of input ends the whole.
"""

from __future__ import annotations

import argparse
import functools
import sys
from collections.abc import Callable
from typing import TypeVar

from dpstack.api.gsd_choice import Choice, as_toml, module_key
from dpstack.cli import options, output
from dpstack.cli.streams import guarded, warn
from dpstack.errors import GsdError, UsageError
from dpstack.gsd.configuration import default_modules, find_module, first_slot, plug
from dpstack.gsd.model import GsdFile, Module, ranges_text
from dpstack.gsd.prm import Field, value_of
from dpstack.text import printable

_T = TypeVar("_T")
#: more modules than this are not listed unasked
_LISTED = 40


def run(file: GsdFile, path: str) -> int:
    """Ask, then print the table."""
    device = file.device
    say(f"{device.vendor} {device.model}".strip() or path)
    name = ask("name", device.model.split()[0].lower() if device.model else "slave", _name)
    address = ask("address, 0..125", None, _address)
    choice = Choice(name, address, path, _modules(file))
    _parameters(file, choice)
    output.toml(as_toml(device, choice))
    return 0


def say(text: str) -> None:
    """One line for the person at the keyboard."""
    with guarded():
        sys.stderr.write(printable(text) + "\n")
        sys.stderr.flush()


def ask(question: str, default: str | None, read: Callable[[str], _T]) -> _T:
    """Ask until ``read`` accepts the answer (it raises GsdError otherwise). Raises UsageError at the end of input."""
    prompt = printable(f"{question} [{default}]: " if default else f"{question}: ")
    while True:
        with guarded():
            sys.stderr.write(prompt)
            sys.stderr.flush()
        line = sys.stdin.readline()
        if not line:
            raise UsageError("gsd configure: the answers ended before the table was complete; nothing was written")
        answer = line.strip() or (default or "")
        try:
            return read(answer)
        except GsdError as error:
            warn(str(error))


def _name(answer: str) -> str:
    if not answer or not answer.isprintable():
        raise GsdError("a name of at least one character is wanted; type one")
    return answer


def _address(answer: str) -> int:
    try:
        return options.address(answer)
    except argparse.ArgumentTypeError as error:
        raise GsdError(str(error)) from None


def _modules(file: GsdFile) -> list[Module | None]:
    """One module after the other, until an empty answer where the file wants no more."""
    device = file.device
    preset = default_modules(device)
    if preset is not None:
        say("preset: " + ", ".join(module.name for module in preset))
        if ask("take these modules, y or n", "y", _yes):
            return list(preset)
    if len(device.modules) <= _LISTED:
        _list_modules(file, "")
    say("a module is its name or number; ? lists all, ?text some, - is an empty slot, an empty line ends")
    chosen: list[Module | None] = []
    slots = {slot.number: slot for slot in device.slots}
    first = first_slot(device)
    while not device.max_module or len(chosen) < device.max_module:
        number = first + len(chosen)
        slot = slots.get(number)
        if slots and slot is None:
            break
        hint = f" {slot.name} ({ranges_text(slot.allowed)})" if slot else ""
        answer = ask(f"slot {number}{hint}", None, lambda text: _slot(file, chosen, text))
        if answer is _END:
            break
        chosen.append(answer if isinstance(answer, Module) else None)
    return chosen


class _End:
    """An empty answer: no more modules."""


_END = _End()


def _slot(file: GsdFile, chosen: list[Module | None], answer: str) -> Module | _End | None:
    if answer.startswith("?"):
        _list_modules(file, answer[1:].strip())
        raise GsdError("type a name or a number")
    if not answer:
        if not any(chosen):
            raise GsdError("no module is chosen yet; type a name or a number, ? lists them")
        return _END
    module = None if answer == "-" else find_module(file.device, answer)
    module_key(file.device, module)
    if module is not None:
        plug(file.device, [*chosen, module])
    return module


def _list_modules(file: GsdFile, part: str) -> None:
    for module in file.device.modules:
        if part.lower() in module.name.lower():
            number = "" if module.reference is None else str(module.reference)
            say(f"  {number:>6}  {module.name}  ({module.config.hex(' ').upper()})")


def _yes(answer: str) -> bool:
    if answer.lower() not in ("y", "yes", "n", "no"):
        raise GsdError("y or n")
    return answer.lower().startswith("y")


def _parameters(file: GsdFile, choice: Choice) -> None:
    """Every visible parameter with its default; what differs goes into the table."""
    prm = plug(file.device, choice.modules).user_prm()
    fields = [f for f in prm.fields if f.parameter.visible and f.parameter.changeable]
    if not fields or not ask(f"{len(fields)} parameters: go through them, y or n", "n", _yes):
        return
    for field in fields:
        read = functools.partial(value_of, field.parameter)
        value = ask(f"{field.key} ({_allowed(field)})", field.text, read)
        if value != field.value:
            choice.parameters[prm.shortest_key(field)] = field.parameter.texts.get(value, value)


def _allowed(field: Field) -> str:
    parameter = field.parameter
    return ", ".join(parameter.texts.values()) or ranges_text(parameter.allowed or (parameter.type.limits,))
