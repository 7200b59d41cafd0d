"""examples/fdl_controllers.py in virtual time: every block arrives once and in order, also at a late partner."""

from __future__ import annotations

import asyncio
import re
import runpy
import sys
from pathlib import Path

import pytest
from support import present

import dpstack

EXAMPLE = Path(__file__).resolve().parent.parent / "examples" / "fdl_controllers.py"


def test_blocks_between_two_controllers(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", [str(EXAMPLE)])
    runpy.run_path(str(EXAMPLE), run_name="__main__")
    lines = capsys.readouterr().out.splitlines()
    for station, partner in ((1, 2), (2, 1)):
        received = [line for line in lines if line.startswith(f"station {station} has")]
        assert received == [f"station {station} has received b'block {number}' from {partner}" for number in range(3)]


def test_a_partner_that_comes_late(capsys: pytest.CaptureFixture[str]) -> None:
    example = runpy.run_path(str(EXAMPLE))

    async def program() -> None:
        world = dpstack.World()
        first = dpstack.open_fdl(world=world, baud=187_500, address=1, hsa=5)
        second = dpstack.open_fdl(world=world, baud=187_500, address=2, hsa=5)
        async with first:
            sending = asyncio.create_task(example["exchange"](first, 2, 2))
            await asyncio.sleep(0.03)
            async with second:
                await asyncio.gather(sending, example["exchange"](second, 1, 2))
        present(world.referee).check()

    dpstack.run_virtual(program())
    out = capsys.readouterr().out
    assert "station 1: SDA to station 2: NA" in out
    assert re.findall(r"station 2 has received b'(.*?)'", out) == ["block 0", "block 1"]


def test_the_head_says_how_to_start_it() -> None:
    text = EXAMPLE.read_text(encoding="utf-8")
    assert "``python examples/fdl_controllers.py``" in text
    assert "``python examples/fdl_controllers.py /dev/ttyUSB0 1 2``" in text
