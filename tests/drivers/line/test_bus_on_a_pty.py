"""The whole stack under each real-time driver on ptys, far ends that know only octets, also in pieces: what happens,
never when."""

from __future__ import annotations

import asyncio
import itertools
import subprocess
import sys
from pathlib import Path
from time import monotonic_ns

import pytest
from far_ends import PtyFarEnd, beside, open_slave, until

from dpstack.dp.master.commands import Mode, SetMode, Shutdown
from dpstack.dp.master.events import MasterStopped, SlaveState
from dpstack.dp.master.master import Master
from dpstack.dp.master.settings import MasterSettings
from dpstack.dp.slave.application import SlaveApp
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.slave.description import SlaveDescription
from dpstack.dpv1.slave.user_slave import DpSlave
from dpstack.drivers.line import answer_timing
from dpstack.drivers.line.echo import Echo
from dpstack.drivers.line.port_latency import patience_of
from dpstack.drivers.segment.hub import Segment
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.passive.station import PassiveStation
from dpstack.fdl.telegram import Resp, Telegram
from dpstack.params import BusParams
from dpstack.phy.patience import HOST
from dpstack.ports import open_port
from dpstack.trace import Event
from dpstack.units import NEVER
from tests.drivers.driver_rig import driver_on
from tests.drivers.line.asker_kit import ANSWER, BAUD, SHORT, Asker

pytestmark = pytest.mark.usefixtures("each_driver")

RESPONDER = str(Path(__file__).parents[2] / "kits" / "support_responder.py")
SPECS = ("3:0696:f3f1:12:12", "4:1234:2010:1:1,fixed=5a")


async def _responder(path: str) -> asyncio.subprocess.Process:
    process = await asyncio.create_subprocess_exec(sys.executable, RESPONDER, path, *SPECS, stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert await process.stdout.readline() == b"ready\n"
    return process


async def test_bring_up_exchange_restart_and_an_ordered_end(tmp_path: Path) -> None:
    async with Segment(2, tmp_path / "bus", baud=1_500_000) as segment:
        responder = await _responder(segment.paths[1])
        port = open_port(segment.paths[0], 1_500_000)
        params = BusParams.preset(1_500_000, address=2, gap=0)
        master = Master(
            params,
            [
                SlaveParams(address=3, name="drive", ident=0x0696, config=bytes.fromhex("f3f1")),
                SlaveParams(address=4, name="valves", ident=0x1234, config=bytes.fromhex("2010")),
            ],
            MasterSettings(watchdog_ms=1000),
        )
        station = ActiveStation(params, [master], patience=patience_of(port), now=monotonic_ns())
        events: list[Event] = []
        driver = driver_on(port, station, events.extend)
        await driver.open()
        driver.command(GoOnline())
        driver.command(SetMode(Mode.OPERATE))

        def exchanging() -> list[int]:
            return [a for a, handler in master.handlers.items() if handler.state is SlaveState.DATA_EXCHANGE]

        await until(lambda: exchanging() == [3, 4], "data exchange with both")
        master.images[3].outputs = bytes(range(12))
        await until(lambda: bytes(master.images[3].inputs) == bytes(range(12)), "the mirrored outputs")
        await until(lambda: bytes(master.images[4].inputs) == b"\x5a", "the other one's inputs")  # maybe a round later

        responder.kill()
        await responder.wait()
        await until(lambda: exchanging() == [], "the loss of both")
        responder = await _responder(segment.paths[1])
        await until(lambda: exchanging() == [3, 4], "data exchange again")

        driver.command(Shutdown())
        await until(lambda: any(isinstance(event, MasterStopped) for event in events), "the ordered end")
        await driver.close()
        responder.kill()
        await responder.wait()
        assert driver.failed is None


async def test_a_slave_of_ours_on_a_pty_answers_a_master_of_literal_octets() -> None:
    params = BusParams.preset(500_000, address=2)
    port = open_port("pty", 500_000)
    app = SlaveApp(
        DpSlave(SlaveDescription(ident=0x1234, configs=(b"\x20\x10",)), lambda outputs, _elapsed: outputs), address=3
    )
    driver = driver_on(port, PassiveStation(3, app, params, patience=patience_of(port)), lambda _events: None)
    await driver.open()
    for _ in range(2):  # and again for a master that comes later
        master = open_slave(port.name)
        for request, answer in (
            ("10 03 02 49 4E 16", "10 02 03 00 05 16"),
            ("68 0C 0C 68 83 82 6D 3D 3E 80 01 01 0B 12 34 00 C0 16", "E5"),
            ("68 07 07 68 83 82 5D 3E 3E 20 10 0E 16", "E5"),
            ("68 04 04 68 03 02 7D 77 F9 16", "68 04 04 68 02 03 08 77 84 16"),
        ):
            master.send(bytes.fromhex(request))
            expected = bytes.fromhex(answer)
            assert await master.recv(len(expected)) == expected
        master.hang_up()
        await until(lambda: not port.write(b""), "the departure")
    await driver.close()


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
    async with beside(far.serve()):
        driver.command(GoOnline())
        await until(lambda: driver._answers.sleep_until > 0, "an answer that nobody listens for")
        before = len(user.outcomes)
        await until(lambda: len(user.outcomes) >= before + 20, "twenty more answers")
        far.instead = SHORT
        await until(lambda: Resp.RS in [o.function for o in user.outcomes if isinstance(o, Telegram)], "a shorter one")
        after = len(user.outcomes)
        await until(lambda: len(user.outcomes) >= after + 10, "ten more")
    await driver.close()
    far.end.hang_up()
    heard = itertools.dropwhile(lambda outcome: not isinstance(outcome, Telegram), user.outcomes)
    assert all(isinstance(outcome, Telegram) for outcome in heard)
