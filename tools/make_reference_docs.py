"""Writes the pages of docs/reference that follow from the sources; a test holds them to it.

- ``options.md``: every command with its arguments, from its parser
- ``events.md``: every event with its fields and text, from its class
- ``api/``: one page a public namespace; Sphinx fills it with the docstrings of ``__all__`` (docs/conf.py)
"""

from __future__ import annotations

import argparse
import importlib
import inspect
import re
from collections.abc import Iterable, Iterator
from enum import Enum
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Final, get_origin

from dpstack import events as bus_events
from dpstack import fdl as fdl_names
from dpstack import slave as slave_names
from dpstack.blocking import proxies
from dpstack.cli.main import build_parser
from dpstack.cli.parser import Parser
from dpstack.dp.master.fixed_cycle import CycleStats
from dpstack.dp.master.slave_reports import AlarmCounts
from dpstack.dp.plan.cycle_check import CyclePlan
from dpstack.dp.plan.plan import SlavePlan
from dpstack.dp.plan.rotation_time import Figures, Rotation
from dpstack.fdl.interface import LinkStats, StationStats
from dpstack.trace import Event
from dpstack.why.story import Likely
from tools.class_attributes import Attribute, attributes

ROOT: Final = Path(__file__).resolve().parent.parent
REFERENCE: Final = ROOT / "docs" / "reference"
#: the public namespaces. A new one is added here, and nowhere else in the book
NAMESPACES: Final = (
    "dpstack",
    "dpstack.events",
    "dpstack.slave",
    "dpstack.blocking",
    "dpstack.profile",
    "dpstack.devices",
    "dpstack.gsd",
    "dpstack.decode",
    "dpstack.fdl",
    "dpstack.ppi",
    "dpstack.testing",
)
#: classes without a public name whose objects stand in attributes of a namespace, and the attributes
_WITHIN: Final = {
    "dpstack": {
        Figures: "Plan.figures",
        Rotation: "Plan.rotations",
        SlavePlan: "Plan.slaves",
        CyclePlan: "Plan.cycle",
        LinkStats: "BusStats.link",
        StationStats: "BusStats.stations",
        CycleStats: "BusStats.cycles",
        AlarmCounts: "SlaveStats.alarms",
        Likely: "Story.causes",
    }
}
#: those with private base classes, whose members are listed; the members of these classes are not listed again
_INHERITING: Final = {"dpstack": "object, int, tuple, BaseException, Enum, DpError, Event, Slave"}

_MADE: Final = "Made from the sources by `tools/make_reference_docs.py`; do not edit."
#: sentences in front of the tables of attributes
_ABOUT_ATTRIBUTES: Final = {
    "dpstack.events": "[events.md](../events.md) has the fields of each event; all events have the attributes of "
    "[Event](dpstack.md#event), too.",
    "dpstack": "Some calls return objects whose class has no name here, for instance `bus.record()`: their attributes "
    "stand on the page of [dpstack.blocking](dpstack.blocking.md).",
    "dpstack.slave": "`SlaveServer.slave` is a [ServedSlave](dpstack.blocking.md#servedslave).",
    "dpstack.blocking": "A class has the attributes of the class of the same name on the pages of "
    "[dpstack](dpstack.md) and [dpstack.slave](dpstack.slave.md). The classes below have no name there: calls return "
    "their objects, which have the same attributes in asynchronous programs.",
}
_EVENT_CLASS: Final = re.compile(r"^class \w+\([\w, ]*(?:Event|Notice|ServiceEnd)\):", re.MULTILINE)
_ROLE: Final = re.compile(r":\w+:`~?([^`]+)`")
_FIRST: Final = re.compile(r".+?\.(?= |$)")
_EXAMPLE: Final = re.compile(r"dpstack (?:'[^']*'|[^;\n'])*")


def plain(docstring: str | None) -> str:
    """A docstring as one paragraph of Markdown: roles and double backquotes become code."""
    text = _ROLE.sub(r"`\1`", inspect.cleandoc(docstring or ""))
    return " ".join(text.replace("``", "`").split())


def first_sentence(docstring: str | None) -> str:
    head = inspect.cleandoc(docstring or "").partition("\n\n")[0]
    return plain(head)


def cell(text: str) -> str:
    return text.replace("|", "\\|")


def _row(attribute: Attribute) -> str:
    """Name, type and meaning of an attribute."""
    kind = f"`{cell(attribute.annotation)}`" if attribute.annotation else ""
    return f"| `{attribute.name}` | {kind} | {cell(first_sentence(attribute.line))} |"


# -- options.md --------------------------------------------------------------------------------------------------------


def commands(parser: Parser) -> Iterator[tuple[Parser, str]]:
    """Every command and the sentence of its list, those of groups like ``gsd`` too."""
    parser.load()
    for group in parser.actions():
        if isinstance(group, argparse._SubParsersAction):
            sentences = {choice.dest: choice.help or "" for choice in group._choices_actions}
            for name, command in group.choices.items():
                command.load()
                yield command, sentences[name]
                yield from commands(command)


def _written(action: argparse.Action) -> str:
    """An argument or option as it is typed."""
    value = "" if action.nargs == 0 else str(action.metavar or action.dest.upper())
    return " ".join(filter(None, [", ".join(action.option_strings), value]))


def _command(command: Parser, sentence: str) -> Iterator[str]:
    yield f"## {command.prog}\n\n{sentence[0].upper()}{sentence[1:]}.\n"
    rows = [
        f"| `{cell(_written(action))}` | {cell(action.help or '')} |"
        for action in command.actions()
        if action.dest != "help" and not isinstance(action, argparse._SubParsersAction)
    ]
    if rows:
        yield "\n".join(["| argument | meaning |", "|---|---|", *rows]) + "\n"
    examples = [f"$ {' '.join(example.split())}" for example in _EXAMPLE.findall(command.epilog or "")]
    if examples:
        yield "\n".join(["```console", *examples, "```"]) + "\n"


def options_page() -> str:
    head = (
        f"# Arguments of every command\n\n{_MADE}\n\n`dpstack COMMAND --help` prints the same. "
        "[commands.md](commands.md) says what each command does, and describes its output.\n"
    )
    return "\n".join([head, *(part for one in commands(build_parser()) for part in _command(*one))])


# -- events.md ---------------------------------------------------------------------------------------------------------


def event_modules() -> list[ModuleType]:
    found = (
        path.relative_to(ROOT).with_suffix("")
        for path in sorted((ROOT / "dpstack").rglob("*.py"))
        if _EVENT_CLASS.search(path.read_text(encoding="utf-8"))
    )
    return [importlib.import_module(".".join(path.parts)) for path in found]


@cache
def event_classes() -> list[type[Event]]:
    """The events of all modules by name, without base classes that have no text."""
    found = {
        one.__name__: one
        for module in event_modules()
        for one in vars(module).values()
        if isinstance(one, type) and issubclass(one, Event) and _has_text(one)
    }
    return [found[name] for name in sorted(found)]


def _has_text(event: type[Event]) -> bool:
    return hasattr(event, "TEMPLATE") or event._text is not Event._text


def _event(event: type[Event]) -> Iterator[str]:
    yield f"## {event.__name__}\n\n{plain(event.__doc__)}\n"
    if not hasattr(bus_events, event.__name__):
        where = "it is internal"
        if event.__name__ in slave_names.__all__:
            where = "a served slave has it, import it from `dpstack.slave`"
        elif event.__name__ in fdl_names.__all__:
            where = "a SAP of one's own gets it, import it from `dpstack.fdl`"
        yield f"Not of a bus: {where}.\n"
    fields = [one for one in attributes(event, {Event}) if one.name in event.__struct_fields__]
    if fields:
        yield "\n".join(["| field | type | |", "|---|---|---|", *map(_row, fields)]) + "\n"
    if event._text is Event._text:
        yield f"Text: `{event.TEMPLATE.replace('{e.', '{')}`\n"


def events_page() -> str:
    head = f"""# Events

{_MADE}

`async for event in bus.events()` yields those of a bus; programs import their classes from `dpstack.events`. The others
belong to served slaves, scans, and searches for a rate, and stand where their sections say. Most wanted of a bus:
`SlaveFaulted` (a slave is lost or refuses, with cause and remedy), `SlaveStateChanged` (it comes and goes),
`SlaveDiagnosis`, `AlarmRaised`, `DriveEvent`, `ModeChanged`, `ForcedClear` (the master went to Clear by itself; the
base class of `ApplicationSilent`, `AutoCleared` and `Stalled`), `PortLost`, and `BusFailed`.

Each event has `t_ns`, the time of the machine in nanoseconds, `time`, the wall clock (`wall_ns` in nanoseconds),
`severity`, and `text`: one line for people, with what to do where something is to be done. Where a text is given here,
names in braces stand for fields or properties of the event; the other texts depend on the values of the fields. Faults
of a slave and the remedy for each:
[troubleshooting.md](troubleshooting.md).
"""
    return "\n".join([head, *(part for event in event_classes() for part in _event(event))])


# -- api/ --------------------------------------------------------------------------------------------------------------


def elsewhere(namespace: str) -> dict[str, str]:
    """The names of ``namespace`` that stand on the page of a namespace before it, with that one."""
    own = importlib.import_module(namespace)
    found: dict[str, str] = {}
    for other in reversed(NAMESPACES[: NAMESPACES.index(namespace)]):
        before = importlib.import_module(other)
        found |= {name: other for name in before.__all__ if getattr(before, name) is getattr(own, name, before)}
    return dict(sorted(found.items()))


def _line(value: object) -> str:
    """One line about a public name: the first sentence of its docstring, or the value of a constant."""
    if get_origin(value) is not None:
        return "a type alias"
    if isinstance(value, int | float | str):
        return f"`{value!r}`"
    if inspect.isclass(value) and value.__module__ == "builtins":
        return f"another name of `{value.__name__}`"
    if inspect.ismodule(value) or inspect.isclass(value) or inspect.isroutine(value):
        text = first_sentence(value.__doc__)
        sentence = _FIRST.match(text)
        return (text if sentence is None else sentence[0]) + _members(value)
    return f"a `{type(value).__name__}`"


def _members(value: object) -> str:
    """The members of an enum with their values; "" for anything else."""
    if not (inspect.isclass(value) and issubclass(value, Enum)):
        return ""
    return f" Members: {', '.join(f'`{one.name}` = `{one.value!r}`' for one in value)}."


def names_table(namespace: str, left_out: Iterable[str]) -> str:
    """The public names of ``namespace`` with a line each."""
    module = importlib.import_module(namespace)
    rows = (
        f"| `{name}` | {cell(_line(getattr(module, name)))} |" for name in sorted(set(module.__all__) - set(left_out))
    )
    return "\n".join(["| name | |", "|---|---|", *rows])


@cache
def public_classes() -> dict[type, str]:
    """The public classes with the first namespace that has them."""
    found: dict[type, str] = {}
    for namespace in NAMESPACES:
        module = importlib.import_module(namespace)
        for name in sorted(module.__all__):
            if inspect.isclass(getattr(module, name)):
                found.setdefault(getattr(module, name), namespace)
    return found


def shown_attributes(kind: type, classes: Iterable[type]) -> list[Attribute]:
    """The attributes of ``kind`` on its page: of ``classes``, its base classes have their own; events.md has fields."""
    fields = set(kind.__struct_fields__) if kind in event_classes() else set()
    asynchronous = {proxy: one for one, proxy in proxies._CLASSES.items()}.get(kind, kind)
    if asynchronous is not kind and asynchronous in classes:
        return []
    return [one for one in attributes(asynchronous, set(classes) - {kind}) if one.name not in fields]


def attribute_tables(namespace: str) -> Iterator[str]:
    """A table for each class of ``namespace``, and the classes that have the attributes of base classes only."""
    classes = public_classes()
    inheriting = []
    for kind in (kind for kind, first in classes.items() if first == namespace and not issubclass(kind, Enum)):
        shown = shown_attributes(kind, classes)
        bases = [base for base in kind.__mro__[1:] if base in classes and shown_attributes(base, classes)]
        of_bases = ", ".join(f"`{base.__name__}`" for base in bases)
        if shown:
            also = f"Besides those of {of_bases}:\n\n" if bases else ""
            rows = "\n".join(map(_row, shown))
            yield f"### {kind.__name__}\n\n{also}| attribute | type | |\n|---|---|---|\n{rows}\n"
        elif bases and not issubclass(kind, Event):
            inheriting.append(f"`{kind.__name__}` ({of_bases})")
    for kind, place in _WITHIN.get(namespace, {}).items():
        rows = "\n".join(map(_row, attributes(kind)))
        yield f"### {kind.__name__}\n\nThe class of `{place}`.\n\n| attribute | type | |\n|---|---|---|\n{rows}\n"
    if inheriting:
        yield f"Classes with the attributes of their base classes (in brackets): {', '.join(inheriting)}.\n"


def _attributes_of(namespace: str) -> str:
    """The section of a page with the attributes of its classes."""
    tables = "\n".join(attribute_tables(namespace))
    about = f"{_ABOUT_ATTRIBUTES[namespace]}\n\n" if namespace in _ABOUT_ATTRIBUTES else ""
    return f"## Attributes\n\n{about}{tables}"


def api_page(namespace: str) -> str:
    others = elsewhere(namespace)
    links = ", ".join(f"[{name}]({other}.md)" for name, other in others.items())
    sentence = f"\nOn another page: {links}.\n" if links else ""
    excluded = f"\n   :exclude-members: {', '.join(others)}" if others else ""
    inherited = f"\n   :inherited-members: {_INHERITING[namespace]}" if namespace in _INHERITING else ""
    return f"""# {namespace}

{_MADE} `make docs` adds the whole docstrings; a plain viewer of Markdown shows a line for each name and attribute.
{sentence}
{names_table(namespace, others)}

{_attributes_of(namespace)}
## Docstrings

```{{eval-rst}}
.. automodule:: {namespace}{inherited}{excluded}
```
"""


def api_index() -> str:
    rows = (
        f"| [{name}]({name}.md) | {cell(first_sentence(importlib.import_module(name).__doc__))} |"
        for name in NAMESPACES
    )
    table = "\n".join(["| namespace | holds |", "|---|---|", *rows])
    return f"""# Python API

{_MADE}

Names in these namespaces are public; everything else may change without notice. Each page has the names of `__all__`
with a line each, a table of the attributes of each class with type and meaning, and in the built book all docstrings.

{table}
"""


def pages() -> dict[Path, str]:
    api = {REFERENCE / "api" / f"{name}.md": api_page(name) for name in NAMESPACES}
    return {
        REFERENCE / "options.md": options_page(),
        REFERENCE / "events.md": events_page(),
        REFERENCE / "api" / "README.md": api_index(),
        **api,
    }


def differing() -> Iterable[Path]:
    """The pages in docs/ that are not what the sources say."""
    return (path for path, text in pages().items() if not path.exists() or path.read_text(encoding="utf-8") != text)


if __name__ == "__main__":
    for path, text in pages().items():
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")
