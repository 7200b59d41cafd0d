"""Running an unmodified program in virtual time."""

from __future__ import annotations

from collections.abc import Coroutine
from typing import TypeVar

from dpstack.drivers import virtual_loop

T = TypeVar("T")


def run_virtual(program: Coroutine[object, object, T], *, paced: bool = False) -> T:
    """As ``asyncio.run``, in virtual time: exact, deterministic, and as fast as this computer can (a bus needs
    ``port="virtual"``). ``paced`` holds it back to real time.
    """
    return virtual_loop.run(program, paced=paced)
