"""What a slave is asked between Set_Prm and data exchange, and what its diagnoses mean there (protocol facts B6)."""

from __future__ import annotations

from typing import Final

from dpstack.dp import faults
from dpstack.dp.bringup import Ev
from dpstack.dp.diagnosis import Diagnosis
from dpstack.dp.events import Fault, SlaveState
from dpstack.dp.judge import verdict_ready
from dpstack.units import NS_PER_S

_READY_LIMIT: Final = 10 * NS_PER_S
_UNACKED_LIMIT: Final = NS_PER_S
_MAX_PRM_ROUNDS: Final = 3


class Readiness:
    """Of one slave. ``cfg_sent``: Chk_Cfg went out; ``unacked``: the service that it did not acknowledge."""

    __slots__ = ("_prm_rounds", "cfg_sent", "unacked")

    def __init__(self) -> None:
        self.cfg_sent = False
        self.unacked = ""
        self._prm_rounds = 0

    def entered(self, state: SlaveState) -> None:
        """The master's handling reached ``state``."""
        if state in (SlaveState.DATA_EXCHANGE, SlaveState.FAULT):
            self._prm_rounds = 0
        if state in (SlaveState.DATA_EXCHANGE, SlaveState.SET_PRM):
            self.unacked = ""
        if state is SlaveState.SET_PRM:
            self.cfg_sent = False

    def judge(self, diagnosis: Diagnosis, waited_ns: int) -> tuple[Ev, Fault | None]:
        """What ``diagnosis`` means ``waited_ns`` after the last step, and what is wrong."""
        verdict = verdict_ready(diagnosis, cfg_sent=self.cfg_sent)
        if verdict is Ev.DIAG_WAIT:
            if self.unacked and waited_ns > _UNACKED_LIMIT:
                return Ev.TOO_LONG, faults.silent(self.unacked)
            if waited_ns > _READY_LIMIT:
                return Ev.TOO_LONG, faults.waited(diagnosis, _READY_LIMIT / NS_PER_S)
        elif verdict is Ev.DIAG_PRM_REQ:
            if self._prm_rounds >= _MAX_PRM_ROUNDS:
                return Ev.REFUSED, faults.silent(self.unacked) if self.unacked else faults.not_taken()
            self._prm_rounds += 1
        return verdict, None
