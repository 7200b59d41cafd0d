"""Stories of a DP slave by seed: requests of two masters in any order, a device that fails, switches, time.

``python tests/kits/stories slave`` writes ``tests/snapshots/slave_stories.jsonl``, one line a story. A step is the
request, ``->`` its answer (status and octets), calls of the device in brackets, and the events. Times are in ms.
"""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Any

from slave_kit import CFG, DATA_EXCH, MASTER, OTHER, PRM, Bench, Recorder

from dpstack.dp.pdu.diag_blocks import NO_DIAG, UserDiag, channel_block, device_block, identifier_block
from dpstack.dp.slave.application import SlaveApp
from dpstack.dp.slave.events import Report
from dpstack.dp.slave.extension import SlaveService
from dpstack.fdl.interface import Reply
from dpstack.fdl.telegram import Kind, Telegram
from dpstack.units import NEVER

SNAPSHOT = Path(__file__).parents[2] / "snapshots" / "slave_stories.jsonl"
STORIES = 40
MS = 1_000_000

_PRMS = tuple(
    bytes.fromhex(octets)
    for octets in (
        "88 01 0A 0B 0A 35 02",
        "80 01 01 0B 0A 35 00",
        "40 01 01 00 0A 35 00",
        "00 01 01 37 FF FF 00",
        "C8 01 01 0B 0A 35 00",
        "B8 02 03 3C 0A 35 81",
        "88 00 0A 0B 0A 35 00",
        "88 01 0A 0B 0A 36 00",
        "88 01 0A 0B 0A",
        "8C 01 05 0B 0A 35 FF",
        "88 05 05 0B 0A 35 01 04 00 00",
        "88 05 05 0B 0A 35 01 44 00 00",
        "88 01 05 0B 0A 35 01 FF 00 00 01 02",
    )
)
_CFGS = (CFG, CFG, CFG, b"\x20", b"\x10", b"\x11\x21", b"", b"\x77")
_CONTROLS = ("02 00", "00 00", "20 00", "10 00", "08 00", "04 00", "20 01", "28 02", "14 02", "00", "22 00", "0C 00")
_ADDRESSES = ("09 0A 35 00", "09 0A 35 01 CA FE", "7E 0A 35 00", "09 0A 36 00", "0B 0A 35 00", "09 0A")
_BROKEN = (
    "",
    "",
    "check_prm",
    "check_cfg",
    "enter",
    "exchange",
    "clear",
    "operate",
    "leave",
    "ext_diag",
    "address_set",
)
_DIAGS = (
    NO_DIAG,
    UserDiag(device_block(b"\1\2").octets, fault=True),
    UserDiag(identifier_block([1], 2).octets, stat=True),
    UserDiag(channel_block(0, 1, 9).octets),
    UserDiag(device_block(bytes(40)).octets + channel_block(0, 1, 9).octets, overflow=True),
)


class _Service(SlaveService):
    """Writes down its calls; asks for a tick now and then."""

    def __init__(self, calls: list[str]) -> None:
        self._calls = calls

    def parameterised(self, prm: object) -> None:
        self._calls.append("parameterised")

    def entered(self) -> None:
        self._calls.append("entered")

    def left(self) -> None:
        self._calls.append("left")

    def tick(self, now: int) -> None:
        self._calls.append(f"service tick {now // MS}")
        self.at = NEVER

    def end(self, why: str, now: int) -> None:
        self._calls.append(f"end {why}")


class _Device(Recorder):
    """A recorder with a diagnosis, a service, and a clock."""

    def __init__(self, dice: random.Random) -> None:
        super().__init__(CFG, b"\x20", b"\x10")
        self.fail_safe = dice.random() < 0.3
        self.fail_safe_required = self.fail_safe and dice.random() < 0.3
        self.sync_supported, self.freeze_supported = dice.random() < 0.8, dice.random() < 0.8
        self.set_slave_add = dice.random() < 0.7
        self.wd_base_1ms = dice.random() < 0.3
        self.max_diag_len = dice.choice((244, 32))
        self.keeps = dice.random() < 0.5
        self.found: object = NO_DIAG
        self.service = _Service(self.calls)
        self.restart_at: int | None = None

    def services(self, report: Report) -> tuple[SlaveService, ...]:
        return (self.service,)

    def enter(self, config: bytes, now: int) -> None:
        super().enter(config, now)
        self.input_len = 0 if config == b"\x20" else 1

    def user_diag(self) -> Any:
        if self.broken == "ext_diag":
            raise ZeroDivisionError("the device is broken")
        return self.found

    def tick(self, now: int) -> int | None:
        self._call(f"tick {now // MS}")
        self.due_at = NEVER
        return self.restart_at


def _answer(reply: Reply | None) -> str:
    if reply is None:
        return "RS"
    return f"{'SC' if reply.short else reply.status.name} {reply.data.hex()}".strip()


def _step(bench: Bench, device: _Device, dice: random.Random) -> str:
    """One thing that happens to the slave; its text."""
    sa = dice.choice((MASTER, MASTER, MASTER, MASTER, OTHER))

    def ask(sap: int | None, data: bytes) -> str:
        function = 0x5D if dice.random() < 0.95 else 0x4C
        told = f"{sa}>{sap} {data.hex()}"
        request = Telegram(Kind.SD2, 8, sa, function, sap, None if sap is None else 62, data)
        return f"{told} -> {_answer(bench.app.serve(request, bench.now))}"

    if bench.app.state is not DATA_EXCH and dice.random() < 0.25:
        octets = dice.choice((PRM, PRM, *_PRMS[-3:]))
        cfg = dice.choice((CFG, CFG, b"\x20", b"\x10"))
        return f"{octets.hex()} {cfg.hex()} -> {_answer(bench.prm(octets))} {_answer(bench.cfg(cfg))}"
    match dice.randrange(24):
        case 0 | 1 | 2:
            return ask(61, dice.choice((PRM, PRM, *_PRMS)))
        case 3 | 4 | 5:
            return ask(62, dice.choice(_CFGS))
        case 6 | 7 | 8 | 9:
            length = 1 if dice.random() < 0.85 else dice.choice((0, 2))
            return ask(None, bytes([dice.randrange(256)] * length))
        case 10 | 11:
            return ask(60, b"")
        case 12:
            return ask(dice.choice((56, 57, 59, 51, 53)), b"")
        case 13:
            return ask(55, bytes.fromhex(dice.choice(_ADDRESSES)))
        case 14 | 15 | 16:
            octets = bytes.fromhex(dice.choice(_CONTROLS))
            bench.control(octets, sa)
            return f"{sa}>58 {octets.hex()}"
        case 17 | 18:
            ms = dice.choice((1, 20, 60, 110))
            bench.pass_time(ms * MS)
            return f"{ms} ms"
        case 19:
            chosen = dice.choice((*range(len(_DIAGS)), *range(len(_DIAGS)), None))
            device.found = "no diagnosis" if chosen is None else _DIAGS[chosen]
            return f"diagnosis {chosen}"
        case 20:
            device.broken = dice.choice(_BROKEN)
            return f"broken {device.broken}"
        case 21:
            device.prm_reason = dice.choice((None, None, "octet 8 is odd"))
            device.input_len = dice.choice((1, 1, 1, 2))
            return f"{device.prm_reason} {device.input_len}"
        case 22:
            if dice.random() < 0.5:
                device.due_at = bench.now + dice.choice((1, 30)) * MS
                device.restart_at = dice.choice((None, None, 8, 44))
            else:
                device.service.at = bench.now + dice.choice((1, 30)) * MS
            return f"due {device.due_at == NEVER} {device.restart_at}"
        case _:
            call = dice.choice(("restart", "initial_reset", "rate_lost"))
            getattr(bench.app, call)(bench.now)
            device.broken = ""
            return call


def story(seed: int) -> str:
    """The transcript of one story."""
    dice = random.Random(seed)
    device = _Device(dice)
    bench = Bench(device, SlaveApp(device, address=dice.choice((8, 126, None))))
    if dice.random() < 0.8:
        bench.prm()
        bench.cfg()
    lines = []
    shown = ""
    for _ in range(70):
        line = _step(bench, device, dice)
        calls = device.take()
        line += f" [{', '.join(calls)}]" if calls else ""
        line += "".join(f" ({event.t_ns // MS} {event.text})" for event in bench.app.take_events())
        app = bench.app
        at = app.wake_at()
        now = (
            f"{app.state.name} {app.master} {app.group} {app.failure} {app.outputs.hex()}/{app.inputs.hex()} "
            f"{'-' if at == NEVER else at // 1000}"
        )
        if now != shown:
            line += f" {{{now}}}"
        shown = now
        lines.append(line)
    lines.append(repr(bench.app.stats))
    return "|".join(lines)


def lines(seeds: range) -> list[str]:
    """The lines of the snapshot for these seeds."""
    return [json.dumps([seed, story(seed)], ensure_ascii=False) for seed in seeds]
