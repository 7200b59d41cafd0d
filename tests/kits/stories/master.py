"""Stories of a DP master by seed: slaves that fail in every way, orders at any time, and each request and event.

``python tests/kits/stories master`` writes ``tests/snapshots/master_stories.jsonl``, one line a story. A hold with
the same requests as the one before is counted only (``*n``). A request is ``address=outputs`` for Data_Exchange, else
``address/SAP:octets``, with ``p`` (patient), ``r`` (restart), ``c`` (cyclic), ``x`` (long poll, ms), ``n`` (no
repetition), ``a`` (octets of its answer between two fixed cycles). Times are in ms.
"""

from __future__ import annotations

import json
import random
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scripted_link import (
    DIAG_FREE,
    DIAG_LOCKED,
    DIAG_NOT_READY,
    DIAG_PRM_FAULT,
    DIAG_READY,
    DIAG_STATIC,
    MS,
    Answer,
    ScriptedLink,
    ScriptedPlugin,
    ScriptedSlave,
    high,
    refuses,
    says,
    setup,
    silent,
)

from dpstack.dp.master.commands import (
    ActivateSlave,
    AddSlave,
    Alive,
    DeactivateSlave,
    DriveCommand,
    Mode,
    RemoveSlave,
    ReparameteriseSlave,
    SendControl,
    SetMode,
    Shutdown,
)
from dpstack.dp.master.master import Master
from dpstack.dp.master.settings import MasterSettings
from dpstack.dp.master.slave_reports import DiagObserver
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.slave_params import SlaveParams
from dpstack.errors import DpError
from dpstack.fdl.events import StationFound
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import MAX_DATA, SHORT_ACK, StationType, Telegram
from dpstack.machine import HeldUp, LineDown
from dpstack.params import BusParams

#: the place of a failure in this file, which any edit moves
_PLACE = re.compile(r", in \w+\(\), \w+\.py line \d+")
SNAPSHOT = Path(__file__).parents[2] / "snapshots" / "master_stories.jsonl"
STORIES = 48

_EXT = bytes.fromhex("08 0C 00 02 06 96 42 01 03 AA BB")
_DIAGNOSES = (DIAG_FREE, DIAG_READY, DIAG_STATIC, DIAG_NOT_READY, DIAG_PRM_FAULT, DIAG_LOCKED, _EXT)
_TROUBLES: tuple[Answer, ...] = (
    silent,
    lambda request: Failure.GARBLED,
    lambda request: Failure.WRONG,
    lambda request: SHORT_ACK,
    high,
    says(b"\1"),
    *(refuses(code) for code in (1, 2, 3, 9)),
    *(says(octets) for octets in _DIAGNOSES),
)


def _shown(request: Request) -> str:
    data = request.data.hex()
    if request.dsap is None:
        return f"{request.da}={data}" + "!" * (not (request.cyclic and request.patient and request.retry))
    flags = "p" * request.patient + "r" * request.restart + "n" * (not request.retry) + "c" * request.cyclic
    flags += f"x{request.extra_ns // MS}" if request.extra_ns else ""
    flags += f"a{request.answer}" if request.answer != MAX_DATA else ""
    return f"{request.da}/{request.dsap}{':' * bool(data)}{data}{flags}"


class _Observer(DiagObserver):
    """Writes down its calls."""

    def __init__(self, address: int, lines: list[str]) -> None:
        self._name = f"observer {address}"
        self._lines = lines

    def opened(self, last: Diagnosis | None, now: int) -> None:
        self._lines.append(f"{self._name} opened {last is not None}")

    def read(self, diagnosis: Diagnosis, flagged_at: int, exchanges: int, now: int) -> None:
        self._lines.append(f"{self._name} read {flagged_at} {exchanges}")

    def closed(self, now: int) -> None:
        self._lines.append(f"{self._name} closed")


@dataclass
class Story(ScriptedLink):
    """A link whose answers are now and then lost, abandoned or held back, and that keeps a transcript."""

    dice: random.Random = field(default_factory=random.Random)
    noise: float = 0.0
    lines: list[str] = field(default_factory=list)
    observed: list[str] = field(default_factory=list)
    _again: int = 0
    _last: str = ""
    _images: str = ""

    def __post_init__(self) -> None:
        self.master.roster.observe(lambda handler, before: _Observer(handler.setup.address, self.observed))
        self.master.on_round = lambda now: None

    def _answer(self, request: Request) -> Telegram | Failure:
        if request.still is not None and not request.still(self.now):
            return Failure.ABANDONED
        if self.noise and self.dice.random() < self.noise:
            held = Failure.ABANDONED if request.cyclic else Failure.HELD_BACK
            return self.dice.choice((Failure.NO_ANSWER, Failure.GARBLED, Failure.ABANDONED, held))
        return super()._answer(request)

    def note(self, line: str) -> None:
        """Add ``line``, with the number of equal holds before it."""
        if self._again:
            self.lines[-1] += f"*{self._again + 1}"
            self._again = 0
        self._last = ""
        self.lines.append(line)

    def step_on(self) -> None:
        """A hold, the deadlines that are over, and the events."""
        began = self.now
        made = " ".join(map(_shown, self.hold()))
        if made and made == self._last:
            self._again += 1
        elif made:
            self.note(f"{(began - 1_000) / MS:.2f} {made}")
            self._last = made
        self.deadlines()

    def deadlines(self) -> None:
        """The deadlines that are over, and the events so far."""
        if self.now >= self.master.wake_at():
            self.master.tick(self.now)
        self.events += self.master.take_events()
        for event in self.events:
            self.note(f"{(event.t_ns - 1_000) / MS:.3f} {_PLACE.sub('', event.text)}")
        self.events.clear()
        for line in self.observed:
            self.note(line)
        self.observed.clear()

    def images(self) -> None:
        """The inputs, where they have changed."""
        shown = " ".join(
            f"{address}{'+' if image.valid else '-'}{image.inputs.hex()}"
            for address, image in sorted(self.master.images.items())
        )
        if shown != self._images:
            self.note(f"images {shown}")
        self._images = shown

    def order(self, order: object) -> None:
        """Give an order and write it down, also where the master refuses it."""
        shown = type(order).__name__
        try:
            self.send(order)
        except DpError as error:
            shown += f": {error}"
        self.note(f"> {shown}")
        self.deadlines()


def _slave(dice: random.Random, address: int, **more: Any) -> SlaveParams:
    changes: dict[str, Any] = {
        "every": dice.choice((1, 1, 2, 3)),
        "min_slave_interval_ns": dice.choice((0, 0, 0, 2 * MS, 4 * MS)),
        "groups": dice.choice(((), (1,), (2,), (1, 2))),
        "sync": dice.random() < 0.7,
        "freeze": dice.random() < 0.7,
        "safe": dice.choice((b"", b"\4\x7e\0\0")),
        "initial": dice.choice((None, b"\4\x7f\0\0")),
        "fail_safe": dice.random() < 0.2,
        "watchdog_ms": dice.choice((None, 0, 30, 100)),
        "max_diag_len": dice.choice((None, 20)),
        "ignore_auto_clear": dice.random() < 0.2,
        "ident": dice.choice((0x0696, None)),
    }
    return setup(address, **changes | more)


def _begin(dice: random.Random) -> Story:
    cycle_ns = dice.choice((0, 0, 5 * MS))
    group = dice.choice(((), (1,))) if cycle_ns else ()
    settings = MasterSettings(
        cycle_ns=cycle_ns,
        cycle_sync=group,
        cycle_freeze=dice.choice(((), group)),
        auto_clear=dice.random() < 0.4,
        data_control_ns=dice.choice((20, 60)) * MS,
        absent_divisor=dice.choice((0, 8)),
        application_watchdog_ns=dice.choice((0, 0, 90 * MS)),
        watchdog_ms=dice.choice((20, 200)),
        safe_after_stall=dice.random() < 0.8,
    )
    able = {"sync": True, "freeze": True} if group else {}
    count = dice.choice((1, 2, 3, 4))
    slaves = [_slave(dice, 3 + number, **able) for number in range(count)]
    story = Story(Master(BusParams.preset(500_000, address=2), slaves, settings), dice=dice)
    story.slaves = {one.address: ScriptedSlave() for one in slaves if dice.random() < 0.9}
    story.period = dice.choice((300_000, 700_000, 1_500_000))
    story.step = dice.choice((50_000, 150_000))
    return story


def _happen(story: Story, dice: random.Random, number: int) -> None:
    """One thing that happens to the bus or the master."""
    master = story.master
    address = dice.choice((3, 3, 4, 5))
    slave = story.slaves.get(address)
    image = master.images.get(address)
    match dice.randrange(22):
        case 0 | 1:
            story.slaves.pop(address, None)
            story.note(f"{address} is gone")
        case 2 | 3 | 4:
            if address in master.handlers:
                story.slaves[address] = ScriptedSlave(configured=dice.random() < 0.2)
                story.note(f"{address} is new")
        case 5 | 6 | 7:
            if slave is not None:
                sap, trouble = dice.choice((None, None, 60, 61, 62, 59)), dice.randrange(len(_TROUBLES))
                slave.answers[sap] = _TROUBLES[trouble]
                story.note(f"{address} answers {sap} by trouble {trouble}")
        case 8 | 9:
            for one in story.slaves.values():
                one.answers.clear()
            story.note("all are well")
        case 10 | 11:
            if image is not None:
                image.outputs = bytes((4, 0x7F, number, address))
            if slave is not None:
                slave.inputs = bytes((1, 2, number, address))
        case 12 | 13 | 14:
            story.order(SetMode(dice.choice((Mode.OPERATE, Mode.OPERATE, Mode.CLEAR, Mode.STOP))))
        case 15 | 16:
            bits = {dice.choice(("sync", "unsync", "freeze", "unfreeze")): True}
            more = {"settle": dice.random() < 0.2, "picture": dice.random() < 0.4}
            story.order(SendControl(number, dice.choice(((), (1,), (2,))), **bits, **more))
        case 17:
            story.order(dice.choice((RemoveSlave, DeactivateSlave, ActivateSlave, ActivateSlave))(address))
        case 18:
            made = _slave(dice, address, sync=True, freeze=True)
            story.order(dice.choice((AddSlave, ReparameteriseSlave, ReparameteriseSlave))(made))
        case 19:
            gap = dice.choice((15, 40, 150, 1_300)) * MS
            suspended, unsent = dice.random() < 0.3, dice.random() < 0.3
            story.now += 0 if suspended else gap
            if dice.random() < 0.7:
                held = HeldUp(gap, "the test held it up", suspended, unsent)
                story.note(f"held up for {gap // MS} ms {suspended=} {unsent=} {master.command(held, story.now)}")
            story.deadlines()
        case 20:
            if image is not None:
                plugin = ScriptedPlugin()
                plugin.error = ValueError("no") if dice.random() < 0.4 else None
                image.plugin = plugin
                story.order(DriveCommand(address, "start", {}, number))
        case _:
            if dice.random() < 0.5:
                master.command(StationFound(t_ns=story.now, address=address, kind=StationType.SLAVE), story.now)
                story.note(f"station {address} found")
            else:
                master.command(LineDown("unplugged"), story.now)
                story.note("line down")
                story.deadlines()


def story(seed: int) -> str:
    """The transcript of one story."""
    dice = random.Random(seed)
    bus = _begin(dice)
    for _ in range(6):
        bus.step_on()
    bus.order(SetMode(Mode.OPERATE))
    for number in range(24):
        _happen(bus, dice, number)
        if dice.random() < 0.7:
            bus.send(Alive())
        bus.noise = dice.choice((0.0, 0.0, 0.0, 0.04))
        for _ in range(dice.choice((1, 4, 12, 25))):
            bus.step_on()
        bus.images()
    bus.order(Shutdown())
    for _ in range(150):
        bus.step_on()
        if bus.master.mode is Mode.OFFLINE:
            break
    master = bus.master
    bus.note(f"{master.cycle}")
    bus.note(f"{master.rounds} rounds, {master.rotation.count} rotations, {master.cycles}")
    for address, handler in sorted(master.handlers.items()):
        bus.note(f"{address}: {handler.exchanges} exchanges, {handler.diagnosis}, {handler.fault}")
        history = handler.bring_ups.history()
        told = f"{history.lost} {history.brought_up} {history.idents} {history.losses}"
        for up in history.bring_ups:
            told += f" [{up.left_out} {up.exchanging_ns // 1000}"
            told += "".join(f" {step.asked} {step.sent.hex()} {step.answered} {step.times}" for step in up.steps) + "]"
        bus.note(told)
    return "|".join(bus.lines)


def lines(seeds: range) -> list[str]:
    """The lines of the snapshot for these seeds."""
    return [json.dumps([seed, story(seed)], ensure_ascii=False) for seed in seeds]
