"""What a slave is asked between Set_Prm and data exchange, and what its diagnoses mean there (protocol facts B6)."""

from __future__ import annotations

from functools import partial
from typing import Final

from dpstack.dp.master import fault_texts
from dpstack.dp.master.events import Fault, SlaveState
from dpstack.dp.master.slave_states import Ev
from dpstack.dp.master.verdicts import verdict_ready
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.services import SERVICE_NAMES
from dpstack.dp.slave_params import SlaveSetup
from dpstack.fdl.telegram import SAP_SET_PRM
from dpstack.units import NS_PER_S

_READY_LIMIT: Final = 10 * NS_PER_S
_UNACKED_LIMIT: Final = NS_PER_S
_MAX_PRM_ROUNDS: Final = 3
_SET_PRM: Final = SERVICE_NAMES[SAP_SET_PRM]


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

    def judge(
        self, setup: SlaveSetup, diagnosis: Diagnosis, prm_sent: bytes, waited_ns: int
    ) -> tuple[Ev, Fault | fault_texts.FaultOfCfg | None]:
        """What ``diagnosis`` means ``waited_ns`` after the last step, and what is wrong.

        ``setup``: of its slave; ``prm_sent``: the octets of its last Set_Prm.

        A :data:`~dpstack.dp.master.fault_texts.FaultOfCfg` needs the answer to Get_Cfg first.
        """
        verdict = verdict_ready(diagnosis, cfg_sent=self.cfg_sent)
        if verdict is Ev.DIAG_WAIT:
            if self.unacked and waited_ns > _UNACKED_LIMIT:
                return Ev.TOO_LONG, self._silent(setup, prm_sent)
            if waited_ns > _READY_LIMIT:
                seconds = _READY_LIMIT / NS_PER_S
                if diagnosis.stat_diag:
                    return Ev.TOO_LONG, fault_texts.statically_ill(seconds)
                return Ev.TOO_LONG, partial(fault_texts.not_ready, setup, seconds)
        elif verdict is Ev.DIAG_PRM_REQ:
            if self._prm_rounds >= _MAX_PRM_ROUNDS:
                if self.unacked:
                    return Ev.REFUSED, self._silent(setup, prm_sent)
                return Ev.REFUSED, partial(fault_texts.not_taken, setup)
            self._prm_rounds += 1
        elif verdict is Ev.DIAG_REFUSED:
            return verdict, fault_texts.refusal(setup, diagnosis, prm_sent)
        return verdict, None

    def _silent(self, setup: SlaveSetup, prm_sent: bytes) -> Fault | fault_texts.FaultOfCfg:
        return fault_texts.prm_silent(prm_sent) if self.unacked == _SET_PRM else partial(fault_texts.cfg_silent, setup)
