"""Modules that are loaded in a thread while a bus runs: whoever asks second waits until they are whole."""

from __future__ import annotations

import asyncio
import importlib
from pathlib import Path

import pytest

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
