"""An active station and a slave of literal octets."""

from __future__ import annotations

from ring_bus import ListUser, RingBus

from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.interface import Request
from dpstack.fdl.telegram import Req
from dpstack.phy.patience import EXACT, Patience

DX = Request(3, Req.SRD_HIGH, b"\x11\x22", patient=True)
DX_ANSWER = bytes.fromhex("68 05 05 68 02 03 08 AA BB 72 16")
DIAG = Request(3, Req.SRD_HIGH, b"", 60, 62)
DIAG_ANSWER = bytes.fromhex("68 0B 0B 68 82 83 08 3E 3C 02 05 00 FF 06 96 29 16")


Step = bytes | tuple[int, bytes] | None


class Slave:
    """Answers as ``plan`` says, then with ``answer``, after ``delay`` bits. In the plan None is silence, a pair has its
    own delay."""

    def __init__(self, *plan: Step, answer: bytes = DX_ANSWER, delay: int = 11) -> None:
        self.answer = answer
        self.delay = delay
        self.plan = list(plan)
        self.heard: list[bytes] = []

    def __call__(self, octets: bytes, now: int) -> tuple[int, bytes] | None:
        self.heard.append(octets)
        step = self.plan.pop(0) if self.plan else self.answer
        if step is None or isinstance(step, tuple):
            return step
        return self.delay, step

    @property
    def fcs(self) -> list[str]:
        return [f"{o[6] if o[0] == 0x68 else o[3]:02X}" for o in self.heard]


def bus_with(
    slave: Slave,
    *requests: Request,
    mode: str = "whole",
    patience: Patience = EXACT,
    baud: int = 500_000,
    run_ms: int = 0,
) -> tuple[RingBus, ListUser, ActiveStation]:
    bus = RingBus(baud, mode)
    bus.slaves[3] = slave
    user = ListUser(high=list(requests))
    station = bus.master(2, user, patience=patience, gap=0, run_ms=run_ms)
    return bus, user, station
