"""The pages of docs/reference/api show each public attribute with a line, on a plain viewer of Markdown too."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import re
from collections.abc import Iterator
from decimal import Decimal
from functools import cache

import pytest
from api_kit import HOIST, RAW, in_virtual_time
from public_names import SNAPSHOT

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.api.slave.drive import DrivePlugin
from tools.class_attributes import attributes
from tools.make_reference_docs import NAMESPACES, REFERENCE, event_classes, public_classes

_TABLE = re.compile(r"^###? (\w+)\n(.*?)(?=^##|\Z)", re.MULTILINE | re.DOTALL)
_ROW = re.compile(r"^\| `(\w+)` \| .*? \| (.*) \|$", re.MULTILINE)


@cache
def rows(page: str) -> dict[str, dict[str, str]]:
    """The attributes on ``page`` below docs/reference by class, with the line about each."""
    text = (REFERENCE / page).read_text(encoding="utf-8")
    return {name: dict(_ROW.findall(body)) for name, body in _TABLE.findall(text)}


@cache
def shown(kind: type) -> dict[str, str]:
    """The attributes that the pages show of ``kind`` and of its public base classes."""
    if kind.__module__ == "dpstack.blocking" and kind.__name__ not in rows("api/dpstack.blocking.md"):
        (kind,) = [one for one in public_classes() if one.__name__ == kind.__name__ and one is not kind]
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        pages = [f"api/{public_classes()[base]}.md"] if base in public_classes() else []
        for page in [*pages, "events.md"] if base in event_classes() else pages:
            found |= rows(page).get(base.__name__, {})
    return found


def of_snapshot() -> Iterator[tuple[str, type, str]]:
    """Namespace, class and attribute of each public attribute: the properties, and the fields in a constructor."""
    for line in SNAPSHOT.read_text(encoding="utf-8").splitlines():
        match = re.match(rf"({'|'.join(map(re.escape, reversed(NAMESPACES)))})\.(\w+)(?:\.(\w+): )?", line)
        assert match is not None, line
        namespace, name, attribute = match.groups()
        kind = getattr(importlib.import_module(namespace), name)
        if attribute is not None:
            yield namespace, kind, attribute
        elif inspect.isclass(kind) and f"{namespace}.{name}(" in line.replace(" ", "(", 1):
            fields = [one.name for one in dataclasses.fields(kind)] if dataclasses.is_dataclass(kind) else []
            named = getattr(kind, "_fields", ()) if issubclass(kind, tuple) else ()
            for field in [*fields, *getattr(kind, "__struct_fields__", ()), *named]:
                yield namespace, kind, field


def test_each_attribute_of_the_snapshot_has_a_row_with_a_line() -> None:
    found = [one for one in of_snapshot() if not one[2].startswith("_")]
    assert len(found) > 700
    missing = [f"{namespace}.{kind.__name__}.{name}" for namespace, kind, name in found if not shown(kind).get(name)]
    assert missing == []


@pytest.mark.parametrize("namespace", NAMESPACES)
def test_no_row_is_without_a_line(namespace: str) -> None:
    bare = [
        f"{kind}.{name}"
        for kind, table in rows(f"api/{namespace}.md").items()
        for name, line in table.items()
        if not line
    ]
    assert bare == []


def value_of(thing: object, name: str) -> object:
    """None of a property that has no value now, as the set point in rpm of a drive whose reference nobody knows."""
    try:
        return getattr(thing, name, None)
    except dpstack.UsageError:
        return None


@in_virtual_time
async def test_the_objects_of_a_running_bus_have_no_public_attribute_without_a_row() -> None:
    slaves = [
        HOIST,
        RAW,
    ]
    async with dpstack.open_bus(port="virtual", baud=1_500_000, slaves=slaves) as bus:
        await bus.operate()
        await bus.ready()
        drive = bus.drive("hoist")
        (entry,) = core_of(bus).parts.plugins[3]
        assert isinstance(entry, DrivePlugin)
        plugin = entry.core
        objects = [bus, bus.slave(3), bus.slave(9), drive, drive.status, bus.stats, bus.stats.slaves[9], bus.plan]
        for thing in [*objects, bus.snapshot, bus.config, bus.params, bus.world, plugin]:
            kind = next(base for base in type(thing).__mro__ if shown(base))
            names = {
                name for name in dir(thing) if not name.startswith("_") and not callable(getattr(kind, name, None))
            }
            own = {name for name in names if not inspect.ismethod(value_of(thing, name))}
            assert sorted(own - set(shown(kind)) - set(dir(dict))) == [], kind
    assert {"access", "lookups", "online", "words", "status_word"} <= set(shown(dpstack.profile.DriveCore))


class _Base:
    """``first``: a sentence. ``second`` and ``third``: not used. The last one is ``fourth``."""

    first: int
    #: a line of its own,
    #: which goes on
    second: str = ""
    third = 3  #: behind it

    def __init__(self, fourth: bytes) -> None:
        self.fourth = fourth
        self.fifth = Decimal(5)
        """below it"""
        self._hidden = 0

    @property
    def sixth(self) -> float:
        """The docstring."""
        return 0.0


class _Derived(_Base):
    second = "other"
    third = 4  #: another meaning


def test_the_line_of_an_attribute_is_found_wherever_it_may_stand() -> None:
    assert attributes(_Base) == [
        ("first", "int", "a sentence"),
        ("second", "str", "a line of its own, which goes on"),
        ("third", "int", "behind it"),
        ("fourth", "bytes", "The last one is ``fourth``"),
        ("fifth", "Decimal", "below it"),
        ("sixth", "float", "The docstring."),
    ]
    assert attributes(_Derived, {_Base}) == [("third", "int", "another meaning")]
    assert attributes(Decimal) == []
