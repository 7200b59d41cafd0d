"""Every class of events tells in words what happened, whatever its attributes are; remarks are reported once each, and
at most so many of them."""

from __future__ import annotations

import dataclasses
import enum
import importlib
import inspect
import pkgutil
import types
import typing
from collections.abc import Iterator

import msgspec
import pytest

import dpstack
from dpstack.dp.master.events import SlaveRemark
from dpstack.dp.master.slave_reports import SlaveReports
from dpstack.dp.slave_params import SlaveParams
from dpstack.report_once import Novelty, ReportOnce
from dpstack.text import printable
from dpstack.trace import Event

#: bases without a text of their own
BASES = {"ServiceEnd", "SlaveEvent", "SlaveAppEvent", "ForcedClear"}


def below(kind: type[Event]) -> Iterator[type[Event]]:
    for one in kind.__subclasses__():
        yield one
        yield from below(one)


#: they run a program, or need an extra that the tests do without, and have no events
NOT_LOADED = (".__main__", ".cli.assistants.server")


def classes() -> list[type[Event]]:
    for module in pkgutil.walk_packages(dpstack.__path__, "dpstack."):
        if not module.name.endswith(NOT_LOADED):
            importlib.import_module(module.name)
    # the events of the package, not those of other tests
    known = [one for one in below(Event) if one.__module__.startswith("dpstack")]
    return sorted(known, key=lambda one: (one.__module__, one.__name__))


def made(hint: object, *, full: bool) -> object:
    """A value of the type ``hint``: the least one, or one with everything in it, and with an escape sequence."""
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return made(inner[0], full=full) if full or type(None) not in inner else None
    if origin is tuple:
        return tuple(made(one, full=full) for one in inner if one is not ...) if full or ... not in inner else ()
    if origin in (dict, types.MappingProxyType):
        return {made(inner[0], full=full): made(inner[1], full=full)} if full else {}
    if hint is str:
        return "a\x1b[2Jb" if full else ""
    assert isinstance(hint, type), hint
    if issubclass(hint, enum.Enum):
        return list(hint)[-1 if full else 0]
    if dataclasses.is_dataclass(hint) or issubclass(hint, msgspec.Struct):
        return hint(**fields(hint, full=full))
    if hint is bytes:
        return bytes(8) if full else b""
    return hint(3) if hint is int else hint(full) if hint is bool else hint()


def fields(kind: type, *, full: bool) -> dict[str, object]:
    hints = typing.get_type_hints(kind)
    if issubclass(kind, msgspec.Struct):
        return {name: made(hints[name], full=full) for name in kind.__struct_fields__}
    assert dataclasses.is_dataclass(kind)
    return {one.name: made(hints[one.name], full=full) for one in dataclasses.fields(kind) if one.init}


@pytest.mark.parametrize("full", [False, True], ids=["least", "full"])
@pytest.mark.parametrize("kind", classes(), ids=lambda kind: kind.__name__)
def test_text(kind: type[Event], full: bool) -> None:
    if kind.__name__ in BASES:
        assert "TEMPLATE" not in vars(kind)
        return
    assert not inspect.isabstract(kind)
    event = kind(**typing.cast(dict[str, typing.Any], fields(kind, full=full)))
    assert kind.__name__ not in event.text
    assert event.text.strip()
    assert event.text == printable(event.text)
    assert event.text.isascii()


def test_up_to_a_limit() -> None:
    once = ReportOnce(3)
    assert [once.novelty(what) for what in "aabacbd"] == [
        Novelty.NEW,
        Novelty.KNOWN,
        Novelty.NEW,
        Novelty.KNOWN,
        Novelty.LAST,
        Novelty.KNOWN,
        Novelty.KNOWN,
    ]


def test_a_slave_that_deviates_in_another_way_each_time_fills_no_log() -> None:
    told: list[Event] = []
    reports = SlaveReports(SlaveParams(address=4, name="s4", ident=None, config=b"\x10"), told.append, 2, set())
    for number in range(1000):
        reports.remark(f"answers Slave_Diag with {number % 500} octets", number)
    texts = [event.message for event in told if isinstance(event, SlaveRemark)]
    assert len(texts) == len(set(texts)) == 20
    assert texts[-1] == "answers Slave_Diag with 19 octets; further deviations are not reported"
    assert texts[-2] == "answers Slave_Diag with 18 octets"
