"""Errors over the control socket: those of a running program are the same errors at its client, with all they carry."""

from __future__ import annotations

import asyncio
import inspect
import json

import pytest

from dpstack import errors
from dpstack.api.control.client import connect
from dpstack.api.control.commands import COMMON, Spec
from dpstack.api.control.control_server import ControlServer, Handler
from dpstack.api.control.errors import error_fields, failure
from dpstack.errors import (
    AcyclicError,
    BaudError,
    BusError,
    ConfigError,
    DpError,
    GsdError,
    ParamError,
    ParameterError,
    PduError,
    PortError,
    RecordRefused,
    ServiceRefused,
    SlaveTimeout,
    UsageError,
)

#: every class of the tree
TREE = [kind for _, kind in inspect.getmembers(errors, inspect.isclass) if issubclass(kind, DpError)]
#: arguments by their type, as annotated
SAMPLES = {
    "int": 7,
    "str": "Read",
    "bool": True,
    "bytes": b"\x01\xff",
    "tuple[int, int, int]": (0x80, 0xB5, 3),
    "tuple[int, int, int] | None": (2, 1, 7),
    "int | None": 64,
}
FAIL = Spec("fail", "", "fails", "")


def example(kind: type[DpError]) -> DpError:
    if not inspect.isfunction(kind.__init__):
        return kind("slave 7 is odd; look at it")
    parameters = inspect.signature(kind).parameters
    given = {name: SAMPLES[str(one.annotation)] for name, one in parameters.items() if name != "message"}
    return kind(**given, **({"message": "slave 7 is odd; look at it"} if "message" in parameters else {}))


def as_answer(error: Exception) -> dict[str, object]:
    """The answer on the socket."""
    answer = json.loads(json.dumps({"ok": False, "error": str(error), **error_fields(error)}))
    assert isinstance(answer, dict)
    return answer


@pytest.mark.parametrize("kind", TREE, ids=lambda kind: kind.__name__)
def test_every_class_of_the_tree_comes_back_as_it_was(kind: type[DpError]) -> None:
    error = example(kind)
    back = failure(as_answer(error))
    assert type(back) is kind
    assert str(back) == str(error)
    assert vars(back) == vars(error)


@pytest.mark.parametrize(
    ("error", "answer"),
    [
        (UsageError("no"), {"usage": True}),
        (ValueError("no"), {"usage": True}),
        (ConfigError("no"), {"usage": True, "kind": "ConfigError"}),
        (ParamError("no"), {"usage": True, "kind": "ParamError"}),
        (GsdError("no"), {"usage": True, "kind": "GsdError"}),
        (PduError("no"), {"kind": "PduError"}),
        (PortError("no"), {"kind": "PortError"}),
        (BaudError("no"), {"kind": "BaudError"}),
        (BusError("no"), {"kind": "BusError"}),
        (SlaveTimeout(3, "no"), {"kind": "SlaveTimeout", "address": 3}),
        (
            ServiceRefused(3, "no", service="Write", status="RS"),
            {"kind": "ServiceRefused", "address": 3, "service": "Write", "status": "RS"},
        ),
        (
            AcyclicError(3, "no", service="Read", slot=1, index=47, codes=(0x80, 0xB5, 0)),
            {
                "kind": "AcyclicError",
                "address": 3,
                "service": "Read",
                "slot": 1,
                "index": 47,
                "codes": [0x80, 0xB5, 0],
            },
        ),
        (ParameterError("hoist", 17, "no"), {"kind": "ParameterError", "drive": "hoist", "number": 17}),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, Exception) else "",
)
def test_the_lines_on_the_socket(error: Exception, answer: dict[str, object]) -> None:
    assert as_answer(error) == {"ok": False, "error": "no", **answer}


def test_one_that_refuses_a_record_makes_its_own_text() -> None:
    back = failure(as_answer(RecordRefused(0xB0, 9)))
    assert isinstance(back, RecordRefused)
    assert (back.code_1, back.code_2) == (0xB0, 9)


class _ToldElsewhereError(SlaveTimeout):
    """Of another package: its client knows the class above it."""


def test_a_class_that_is_not_of_the_tree_comes_as_the_one_above_it() -> None:
    back = failure(as_answer(_ToldElsewhereError(3, "late")))
    assert (type(back), str(back), vars(back)) == (SlaveTimeout, "late", {"address": 3})


@pytest.mark.parametrize(
    "answer",
    [
        {"error": "odd"},
        {"error": "odd", "kind": "Nonsense"},
        {"error": "odd", "kind": "SystemExit"},
        {"error": "odd", "kind": ["SlaveTimeout"]},
        {"error": "odd", "kind": "SlaveTimeout"},
        {"error": "odd", "kind": "ParameterError", "drive": "hoist"},
        {"error": "odd", "kind": "AcyclicError", "address": 3, "service": "Read", "slot": 1, "index": 2, "codes": [1]},
    ],
)
def test_an_answer_of_another_version_is_an_error_of_the_bus(answer: dict[str, object]) -> None:
    back = failure(answer)
    assert (type(back), str(back)) == (BusError, "odd")
    assert type(failure({**answer, "usage": True})) is UsageError


async def test_a_client_raises_what_was_raised() -> None:
    raised: list[DpError] = [example(kind) for kind in TREE]
    left = list(raised)

    def fail(_args: list[str]) -> object:
        raise left.pop(0)

    def ask() -> list[DpError]:
        caught: list[DpError] = []
        with connect("COM3") as client:
            for _ in raised:
                with pytest.raises(DpError) as info:
                    client.call("fail")
                caught.append(info.value)
        return caught

    handlers: dict[str, Handler] = {"status": lambda _: None, "fail": fail}
    async with ControlServer("sim", "COM3", (*COMMON, FAIL), handlers):
        caught = await asyncio.to_thread(ask)
    assert [(type(one), str(one), vars(one)) for one in caught] == [(type(one), str(one), vars(one)) for one in raised]
