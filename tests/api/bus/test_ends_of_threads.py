"""Buses in several threads, each with a loop of its own: the end of the program finds all of them."""

from __future__ import annotations

import sys
import weakref
from types import FrameType
from typing import Any

from api_kit import bus_of, in_virtual_time

from dpstack.api.bus import shutdown

A = {"name": "a", "address": 5, "ident": 0x1234, "config": "20 10"}


@in_virtual_time
async def test_an_open_bus_is_listed_until_it_is_closed() -> None:
    before = len(shutdown.open_ends())
    async with bus_of(A) as bus:
        assert len(shutdown.open_ends()) == before + 1
        await bus.ready()
    assert len(shutdown.open_ends()) == before


def test_another_thread_opens_a_bus_while_all_are_ended() -> None:
    """It ended with "Set changed size during iteration", and no bus would have got its safe values.

    At each line that runs meanwhile, another bus is opened.
    """
    bus: Any = bus_of(A)
    hurried: list[int] = []
    ends: list[shutdown.OrderedEnd] = []

    def open_another() -> None:
        number = len(ends)
        ends.append(shutdown.OrderedEnd(bus, bus.close, lambda: hurried.append(number)))
        shutdown._open.add(weakref.ref(ends[-1]))

    def at_each_line(_frame: FrameType, event: str, _argument: Any) -> Any:
        if event == "line":
            sys.settrace(None)
            open_another()
            sys.settrace(at_each_line)
        return at_each_line

    for _ in range(3):
        open_another()
    before = sys.gettrace()
    sys.settrace(at_each_line)
    try:
        shutdown.hurry_all()
    finally:
        sys.settrace(before)
    assert {0, 1, 2} <= set(hurried)
    assert len(ends) > 3
    for end in ends:
        end._forget()
    assert shutdown.open_ends() == []
