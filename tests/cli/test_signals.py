"""The first signal ends in order, the second one at once."""

from __future__ import annotations

import asyncio
import os
import signal

import pytest

import dpstack
from dpstack.cli.signals import StopSignal


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("virtual", [False, True])
def test_first_and_second(monkeypatch: pytest.MonkeyPatch, number: signal.Signals, virtual: bool) -> None:
    ended: list[int] = []
    before = signal.getsignal(number)

    async def program() -> None:
        monkeypatch.setattr(os, "_exit", ended.append)
        with StopSignal() as stop:
            assert await stop.or_done(asyncio.sleep(0))
            asyncio.get_running_loop().call_later(0.01, os.kill, os.getpid(), number)
            assert not await stop.or_done(asyncio.sleep(1000))
            assert stop.received
            assert not ended
            os.kill(os.getpid(), number)
            await stop.wait()
        assert ended == [130]

    (dpstack.run_virtual if virtual else asyncio.run)(program())
    assert signal.getsignal(number) is before


def test_what_the_work_raises_is_raised() -> None:
    async def fails() -> None:
        raise ZeroDivisionError

    async def program() -> None:
        with StopSignal() as stop:
            await stop.or_done(fails())

    with pytest.raises(ZeroDivisionError):
        asyncio.run(program())
