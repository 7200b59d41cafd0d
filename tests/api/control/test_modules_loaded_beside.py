"""Modules that are loaded in a thread while a bus runs: whoever asks second waits until they are whole, and no import
nor a program that stood still changes what ``bus.why`` tells."""

from __future__ import annotations

import asyncio
import importlib
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

import pytest
from far_ends import until
from process_kit import VALVES, ready_bus

import dpstack.api.bus
from dpstack.api import streams
from dpstack.api.streams import load_beside

_SLOW = """
BEGUN.set()
assert MAY_END.wait(20)
value = 1
"""


async def test_the_second_task_waits_for_a_module_that_the_first_is_loading(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "events_of_slow.py").write_text(
        "import threading\nBEGUN, MAY_END = threading.Event(), threading.Event()\n"
    )
    (tmp_path / "slow_beside.py").write_text("from events_of_slow import *\n" + _SLOW)
    monkeypatch.syspath_prepend(tmp_path)
    events = importlib.import_module("events_of_slow")

    async def ask() -> int:
        await load_beside("slow_beside")
        return int(importlib.import_module("slow_beside").value)

    first = asyncio.create_task(ask())
    assert await asyncio.to_thread(events.BEGUN.wait, 20)
    second = asyncio.create_task(ask())
    for _ in range(5):
        await asyncio.sleep(0)
    assert not second.done()
    events.MAY_END.set()
    assert [await first, await second] == [1, 1]


async def test_the_modules_of_why_are_loaded_beside_the_bus(monkeypatch: pytest.MonkeyPatch) -> None:
    """Loading them takes 0.1 s, and more on a busy computer: for so long the master stood still."""
    loaded_in: list[int] = []

    class Finder:
        """Notes the threads that load ``dpstack.api.bus.why``, and finds nothing."""

        @staticmethod
        def find_spec(name: str, _path: Sequence[str] | None, _target: ModuleType | None = None) -> None:
            if name == "dpstack.api.bus.why":
                loaded_in.append(threading.get_ident())

    async with ready_bus(VALVES, driver="asyncio") as (bus, _there):
        await bus.why("valves")  # so that the module is there, and its parent has it
        monkeypatch.delitem(sys.modules, "dpstack.api.bus.why")
        monkeypatch.setattr(dpstack.api.bus, "why", dpstack.api.bus.why)
        monkeypatch.setattr(streams, "_loaded_beside", set())
        monkeypatch.setattr(sys, "meta_path", [Finder, *sys.meta_path])
        assert (await bus.why("valves")).first.cause == "healthy"
    assert len(loaded_in) == 1
    assert loaded_in != [threading.get_ident()]


async def test_a_program_that_stood_still_is_told_what_its_master_finds_after_it() -> None:
    async with ready_bus(VALVES | {"watchdog_ms": 5000}, driver="asyncio") as (bus, _there):
        await bus.why("valves")  # its modules are there then
        await until(lambda: bus.slave("valves").inputs_valid, "data of the slave")
        time.sleep(0.5)  # noqa: ASYNC251 the master stands still with its program
        story = await bus.why("valves")
        assert story.first.cause == "healthy"
        assert [step["asked"] for step in story.steps][-1] == "Data_Exchange"  # and no Get_Cfg
