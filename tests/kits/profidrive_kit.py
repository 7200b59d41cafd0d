"""A drive of the PROFIdrive profile without peculiarities, for tests of what the core of every plugin can do."""

from __future__ import annotations

import dataclasses
from typing import Final

from acyclic_kit import outcome
from drive_bench import PluginBench

from dpstack.dpv1.master.plugin_queue import PendingRecord
from dpstack.profile import (
    DriveCore,
    DriveDevice,
    DriveProfile,
    ParamSpec,
    ParamTable,
    ParamType,
    TelegramSpec,
    Word,
    profidrive_states,
)
from dpstack.profile.record47 import RecordQueue, WriteReq

PPO1: Final = TelegramSpec(name="PPO1", config=bytes.fromhex("F3 F1"), outputs=4, inputs=4, channel=True)
STD1: Final = TelegramSpec(name="STD1", config=bytes.fromhex("F1"), outputs=4, inputs=4)
PARAMETERS: Final = ParamTable(
    (
        ParamSpec(700, "source", "Command source", 0, 6, 2),
        ParamSpec(1082, "p1082", "Maximum frequency", 0, 650, 50, type=ParamType.F32, unit="Hz"),
        ParamSpec(1120, "p1120", "Ramp-up time", 0, 650, 10, type=ParamType.F32, unit="s"),
        ParamSpec(1121, "p1121", "Ramp-down time in ms", 0, 650, 10, type=ParamType.U32, decimals=3, unit="s"),
        ParamSpec(1140, "p1140", "Trim", -2, 1.9, type=ParamType.N2),
        ParamSpec(1141, "p1141", "Offset", type=ParamType.I16),
        ParamSpec(1142, "p1142", "Node address", 0, 126, 3, type=ParamType.U8),
    )
)


class Core(DriveCore):
    table = profidrive_states.table(
        Word("control word", profidrive_states.CONTROL_BITS), Word("status word", profidrive_states.STATUS_BITS)
    )
    scan_ns = 8_000_000
    record_slot = 0
    parameter_table = PARAMETERS


class Device(DriveDevice):
    parameter_table = PARAMETERS

    def scan(self, words: tuple[int, ...] | None, now: int) -> tuple[int, ...]:
        return 0x0040, 0


DRIVE: Final = DriveProfile(
    name="profidrive-kit",
    title="Drive of tests",
    ident=0xACE5,
    telegrams={one.name: one for one in (PPO1, STD1)},
    default_telegram="PPO1",
    reference_hz=50.0,
    on_loss="it stops",
    core_factory=Core,
    device_factory=Device,
)
READY: Final = "00 40 00 00"
NO_REPLY: Final = "00 " * 8


class RecordBench(PluginBench):
    """The master's end over record 47: each Write is accepted, each Read answered by the next of ``responses``."""

    def __init__(self, core: DriveCore, records: RecordQueue, inputs: str = READY) -> None:
        self.records = records
        self.requests: list[str] = []
        self.responses: list[str] = []
        self._pending: PendingRecord | None = None
        super().__init__(core, inputs)

    def run(self, rotations: int = 1) -> bytes:
        out = b""
        for _ in range(rotations):
            out = super().run()
            pending = self._pending = self._pending or self.records.take()
            if pending is not None and isinstance(pending.request, WriteReq):
                self.requests.append(pending.request.data.hex(" ").upper())
                pending.outcome = outcome("")
            elif pending is not None and self.responses:
                pending.outcome = outcome(self.responses.pop(0))
            if pending is not None and pending.outcome is not None:
                self._pending = None
        return out

    def answer(self, *responses: str) -> None:
        """Answer the next requests, as many rotations as that takes."""
        self.responses += responses
        self.run(10 * len(responses))


def over_pkw(core: type[DriveCore] = Core) -> PluginBench:
    """The plugin with PPO1, at standstill."""
    return PluginBench(core(DRIVE, "belt", PPO1, {"check_settings": False}), NO_REPLY + READY)


def over_records(core: type[DriveCore] = Core) -> RecordBench:
    """The plugin without a parameter channel in its telegram, over record 47."""
    records = RecordQueue()
    profile = dataclasses.replace(DRIVE, core_factory=core)
    return RecordBench(profile.core("belt", "STD1", {"check_settings": False}, records=records), records)
