"""On a pty whose far end hands answers over in pieces: what happens, never when."""

from __future__ import annotations

import asyncio
import itertools
from time import monotonic_ns

import pytest
from far_ends import PtyFarEnd, until

from dpstack.drivers.line import answer_timing
from dpstack.drivers.line.echo import Echo
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.telegram import Resp, Telegram
from dpstack.params import BusParams
from dpstack.phy.patience import HOST
from dpstack.ports import open_port
from dpstack.units import NEVER
from tests.drivers.driver_rig import driver_on
from tests.drivers.line.asker_kit import ANSWER, BAUD, SHORT, Asker

pytestmark = pytest.mark.usefixtures("each_driver")


class InPieces:
    """A far end that answers in seven pieces 1 ms apart; ``instead``: what it says to the next request."""

    def __init__(self) -> None:
        self.end = PtyFarEnd()
        self.instead = b""
        self.asked = 0

    async def serve(self) -> None:
        held = b""
        while True:
            held += self.end.take()
            while held and held[0] != 0x68:  # tokens
                held = held[3:]
            if len(held) >= 21:
                held = held[21:]
                self.asked += 1
                answer, self.instead = self.instead or ANSWER, b""
                for first in range(0, len(answer), 3):
                    await asyncio.sleep(0.001)
                    self.end.send(answer[first : first + 3])
            await asyncio.sleep(0.0005)


async def test_a_bus_runs_while_its_driver_sleeps_during_known_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    # the times of a busy computer are never so regular, and its pieces come together: test_answer_timing.py has both
    monkeypatch.setattr(answer_timing, "_REGULAR_NS", NEVER)
    monkeypatch.setattr(answer_timing, "_LEAST_PIECES", 1)
    far, user = InPieces(), Asker()
    port = open_port(far.end.path, BAUD)
    params = BusParams.preset(BAUD, address=2, gap=0, max_retry=15)  # a busy computer may let the far end wait
    station = ActiveStation(params, [user], patience=HOST, now=monotonic_ns())
    driver = driver_on(port, station, lambda _events: None, echo=Echo.OFF)
    await driver.open()
    serving = asyncio.create_task(far.serve())
    try:
        driver.command(GoOnline())
        await until(lambda: driver._answers.sleep_until > 0, "an answer that nobody listens for")
        before = len(user.outcomes)
        await until(lambda: len(user.outcomes) >= before + 20, "twenty more answers")
        far.instead = SHORT
        await until(lambda: Resp.RS in [o.function for o in user.outcomes if isinstance(o, Telegram)], "a shorter one")
        after = len(user.outcomes)
        await until(lambda: len(user.outcomes) >= after + 10, "ten more")
    finally:
        serving.cancel()
        await asyncio.wait([serving])
        await driver.close()
        far.end.hang_up()
    heard = itertools.dropwhile(lambda outcome: not isinstance(outcome, Telegram), user.outcomes)
    assert all(isinstance(outcome, Telegram) for outcome in heard)
