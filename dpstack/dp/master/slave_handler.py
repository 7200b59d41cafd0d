"""The master's handling of one slave: its next request, and the meaning of its answers.

The table of states is :mod:`dpstack.dp.master.slave_states`, the texts of the faults
:mod:`dpstack.dp.master.fault_texts`, the back-off :mod:`dpstack.dp.master.retry_timing`; here is the judging of answers
(:meth:`SlaveHandler.service_result`, :meth:`SlaveHandler.data_result`) and the book-keeping.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dpstack.dp.master import fault_texts
from dpstack.dp.master.bring_ups import DATA_EXCHANGE, BringUps
from dpstack.dp.master.events import Fault, OutputsWithheld, SlaveState, SlaveStateChanged
from dpstack.dp.master.fault_texts import CfgFault
from dpstack.dp.master.plugin_host import PluginHost
from dpstack.dp.master.retry_timing import Pacing
from dpstack.dp.master.settings import MasterContext
from dpstack.dp.master.slave_reports import AlarmCounts, SlaveReports
from dpstack.dp.master.slave_states import TABLE, Trigger
from dpstack.dp.master.verdicts import OddAnswers, Readiness, foreign_owner, masters_view, verdict_exchanging
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.process_image import SlaveImage, image_of
from dpstack.dp.services import DATA_STATUS, EMPTY_STATUS, SERVICE_NAMES, positive, refusal_text, set_prm
from dpstack.dp.slave_params import IsochronousDemand, SlaveParams, WatchdogTime
from dpstack.fdl.interface import LONG_NS, Failure, Request
from dpstack.fdl.standing import Standing
from dpstack.fdl.telegram import (
    SAP_CHK_CFG,
    SAP_GET_CFG,
    SAP_SET_PRM,
    SAP_SLAVE_DIAG,
    SSAP_MS0,
    Req,
    Resp,
    Telegram,
)
from dpstack.units import NEVER, NS_PER_S

_MAX_BUSY: Final = 5
#: unanswered polls after which the slave is reported as absent
_ABSENT_AFTER: Final = 3
#: a slave that demands isochronous mode is asked for this long until the port is measured
_MEASURING_NS: Final = 10 * NS_PER_S
_DH: Final = int(Resp.DH)
_SRD_HIGH: Final = Req.SRD_HIGH
#: asked in every exchange: an enum's member costs ten times a name of the module
_DATA_EXCHANGE: Final = SlaveState.DATA_EXCHANGE
#: states of a slave that is absent, in fault or out of service
AWAY: Final = (SlaveState.OFFLINE, SlaveState.FAULT, SlaveState.DEACTIVATED)
_BEFORE_PRM: Final = (SlaveState.OFFLINE, SlaveState.DIAGNOSIS, SlaveState.FAULT)
_BRINGING_UP: Final = (SlaveState.DIAGNOSIS, SlaveState.SET_PRM, SlaveState.CHK_CFG, SlaveState.WAIT_READY)


class SlaveHandler:
    """State and requests of one slave. It calls ``changed(handler, now)`` after a change of its state.

    ``still(now)``: whether outputs may still be sent (see :class:`~dpstack.fdl.interface.Request`). ``before``: the
    handler of the slave under other parameters: counters go on, and the image as :func:`image_of` says.
    """

    def __init__(
        self,
        setup: SlaveParams,
        context: MasterContext,
        changed: Callable[[SlaveHandler, int], None],
        still: Callable[[int], bool],
        before: SlaveHandler | None,
    ) -> None:
        self.setup = setup = setup.on_bus(context.params)
        watchdog = setup.watchdog(context.settings.watchdog_ms)
        #: the watchdog time of the slave in ns, 0 when off
        self.watchdog_effective_ns = watchdog.ns if watchdog else 0
        self.image: SlaveImage = image_of(setup, None if before is None else before.image)
        self.reports = SlaveReports(setup, context.emit, context.params.address, context.changed)
        self.plugin_host = PluginHost(self.image, setup, self.reports)
        #: the last bring-ups step by step
        self.bring_ups: BringUps = BringUps() if before is None else before.bring_ups
        self.state = SlaveState.OFFLINE
        #: time in ns at which this state was entered
        self.since = 0
        self.exchanges: int = 0 if before is None else before.exchanges
        #: Set_Prm was sent, and no answer since shows that this master does not own the slave
        self.owned = False
        #: time in ns of the diagnosis with Prm_Req after the slave left data exchange by itself, or NEVER
        self.prm_req_at = NEVER
        self._overdue_at = 0
        #: Slave_Diag is due in data exchange (DH, Stat_Diag)
        self.diag_due = False
        self._context = context
        self._changed = changed
        self._pacing = Pacing()
        self._silent = 0
        self._busy = 0
        self._odd = OddAnswers()
        #: the last answer to Data_Exchange, if it was good and asked for nothing; the same object again is, too
        self._plain: Telegram | None = None
        #: the next service is a first request (FCV 0, FCB 1)
        self.restart = True
        self._ready = Readiness()
        #: the trigger and the fault to be reported after the answer to Get_Cfg
        self._inquiry: tuple[Trigger, CfgFault] | None = None
        #: reason for leaving data exchange, until the next diagnosis: the status of the refusal, "" for Prm_Req
        self._left: str | None = None
        self._refused_data = False  # the slave left data exchange by itself, and there was no diagnosis since
        # left data exchange, was in fault or out of service, or got other parameters
        self._was_away = before is not None
        # withheld outputs that were reported
        self._reported: bytes | None = None if before is None else before._reported
        self._asked_at = 0
        #: the request of Data_Exchange, with its last outputs
        self.data = Request(
            setup.address,
            Req.MSRD if setup.publishes else _SRD_HIGH,
            patient=True,
            tag=self,
            cyclic=True,
            still=still,
            done=self.data_result,
            standing=Standing(quiet=not setup.min_slave_interval_ns),
        )
        if before is not None:
            self.plugin_host.fault = before.plugin_host.fault
            self.state = before.state if before.state is SlaveState.DEACTIVATED else self.state

    @property
    def _standing(self) -> Standing:
        standing = self.data.standing
        assert standing is not None
        return standing

    @property
    def asked_at(self) -> int:
        """First bit of the last request to it, in ns."""
        return max(self._asked_at, self.data_at)

    @asked_at.setter
    def asked_at(self, at: int) -> None:
        self._asked_at = at
        self._standing.at = -NEVER

    @property
    def data_at(self) -> int:
        """First bit of the last Data_Exchange in ns, if that was the last request."""
        return self._standing.at

    def tell_start(self) -> None:
        """Let the link layer report the first bit of the next Data_Exchange, which is the first of a round."""
        if (standing := self.data.standing) is not None:
            standing.quiet = False

    def data_started(self, at: int) -> None:
        """The first bit of Data_Exchange was reported. In the middle of a round only Min_Slave_Interval needs it."""
        self._asked_at = at
        standing = self._standing
        standing.at = -NEVER
        standing.quiet = not self.setup.min_slave_interval_ns

    @property
    def _watchdog(self) -> WatchdogTime | None:
        return self.setup.watchdog(self._context.settings.watchdog_ms)

    @property
    def ident(self) -> int:
        """The ident number in Set_Prm: as configured, or as taken from the first diagnosis (0 before)."""
        return self.reports.ident or 0

    @property
    def diagnosis(self) -> Diagnosis | None:
        """The last diagnosis with the bits that a master sets (Deactivated, Station_Non_Existent ...)."""
        return masters_view(self.reports.diagnosis, self.state, self.reports.fault)

    @property
    def fault(self) -> Fault | None:
        """The last fault since the slave was in data exchange."""
        return self.reports.fault

    @property
    def why_not_exchanging(self) -> str:
        """Text: why the slave is not in data exchange."""
        fault = self.reports.fault
        return fault.message if fault is not None else f"it is in {self.state.value}"

    @property
    def alarm_counts(self) -> AlarmCounts | None:
        """Counters of its alarms; None for a slave without alarms."""
        return self.reports.observer.counts

    # --- cyclic path --------------------------------------------------------------------------------------------

    def data_result(self, outcome: Telegram | Failure, now: int) -> None:
        """Handle the answer to Data_Exchange: copy good data into the image, judge everything else."""
        if outcome is self._plain and self.image.valid:
            self.image.input_time = now
            self.exchanges += 1
            return
        self._plain = None
        if isinstance(outcome, Telegram):
            status = outcome.fc & 0x0F
            # SC (fc = -1) and an empty LE = 3 answer are legal if there are no inputs
            # (docs/reference/protocol.md#le-3)
            image = self.image
            if status in DATA_STATUS if image.input_len else (outcome.fc < 0 or status in EMPTY_STATUS):
                data = outcome.data
                if len(data) == image.input_len and self.state is _DATA_EXCHANGE:
                    image.inputs = data
                    image.input_time = now
                    if not image.valid:
                        last = self.reports.diagnosis
                        image.valid = last is None or not last.stat_diag
                        if self.bring_ups.first_due:
                            self.bring_ups.first_exchange(self.data.data, outcome, now)
                    self.exchanges += 1
                    if not self._odd.none:
                        self._odd.clear()
                    if status == _DH:
                        if not self.reports.flagged:
                            self.reports.flagged = self.exchanges
                            self._context.announced.add(self.setup.address)
                        self.want_diagnosis(now)
                    else:
                        self._plain = outcome
                    return
        self._odd_data(outcome, now)

    def doubt_inputs(self, since: int, now: int) -> None:
        """The answers that came after ``since`` may be damaged: no inputs are valid until the next exchange."""
        image = self.image
        if image.valid and image.input_time > since:
            image.valid = False
            self.reports.mark_changed()
            self.reports.remark(fault_texts.IN_DOUBT, now)

    def _odd_data(self, outcome: Telegram | Failure, now: int) -> None:
        if outcome is Failure.ABANDONED or self.state is not SlaveState.DATA_EXCHANGE:
            return
        self.bring_ups.answered(self.state, DATA_EXCHANGE, self.data.data, outcome, now)
        if not isinstance(outcome, Telegram):
            self._step(Trigger.SILENT, now, fault_texts.lost("Data_Exchange", outcome, self.plugin_host.moved()))
            return
        verdict = self._odd.judge(outcome)
        if verdict is Trigger.WRONG_LENGTH:
            self._step(verdict, now, fault_texts.wrong_length(self.setup, self.image.input_len, len(outcome.data)))
        elif verdict is not None:
            self._left = refusal_text(outcome)
            self._step(verdict, now)

    # --- services -----------------------------------------------------------------------------------------------

    def wants_service(self, now: int) -> bool:
        """True when a request other than Data_Exchange is due."""
        if self.state is SlaveState.DEACTIVATED:
            return False
        if self._inquiry is not None:
            return True
        return self._pacing.due <= now and (self.state is not _DATA_EXCHANGE or self.diag_due)

    @property
    def under_way(self) -> bool:
        """Whether a bring-up is under way: after the diagnosis that allows Set_Prm, until the first one after Chk_Cfg.

        Other slaves wait meanwhile, because its watchdog runs and that diagnosis must not become outdated.
        """
        if self.state is SlaveState.WAIT_READY:
            return self._pacing.due <= self.since
        return self.state in (SlaveState.SET_PRM, SlaveState.CHK_CFG)

    def is_long_poll_due(self, *, only_first: bool) -> bool:
        """Whether the slave is absent and its next poll is a long one; with ``only_first`` its first long one."""
        pacing = self._pacing
        return self.state is SlaveState.OFFLINE and pacing.long_poll_due and not (only_first and pacing.had_long_poll)

    def service_request(self, now: int, *, long: bool = False) -> Request:
        """The next step of the bring-up, or the diagnosis in data exchange. ``long``: a long poll."""
        if self._inquiry is not None:
            return self._service(SAP_GET_CFG, b"")
        state = self.state
        if state is SlaveState.FAULT:
            self.restart = True
        if state is SlaveState.SET_PRM:
            self.owned = True
            self._ready.prm_sent = set_prm(self.setup, self.ident, self._watchdog)
            return self._service(SAP_SET_PRM, self._ready.prm_sent)
        if state is SlaveState.CHK_CFG:
            self._ready.cfg_sent = True
            return self._service(SAP_CHK_CFG, self.setup.config)
        return self._service(SAP_SLAVE_DIAG, b"", long=long)

    def _service(self, sap: int, data: bytes, *, long: bool = False) -> Request:
        restart, self.restart = self.restart, False
        return Request(
            self.setup.address,
            _SRD_HIGH,
            data,
            sap,
            SSAP_MS0,
            patient=self.state is not SlaveState.OFFLINE,
            restart=restart,
            tag=self,
            extra_ns=LONG_NS if long else 0,
        )

    def service_result(self, request: Request, outcome: Telegram | Failure, now: int) -> None:
        """The end of a request that :meth:`service_request` made."""
        if outcome is Failure.ABANDONED or self.state is SlaveState.DEACTIVATED:
            return
        good = outcome if isinstance(outcome, Telegram) and positive(request.dsap, outcome) else None
        service = SERVICE_NAMES[request.dsap or 0]
        self.bring_ups.answered(self.state, service, request.data, outcome, now)
        if request.dsap == SAP_GET_CFG:
            self._end_inquiry(good.data if good else None, now)
        elif not isinstance(outcome, Telegram):
            self._on_silence(service, outcome, now, long=request.extra_ns > 0)
        else:
            self._silent = 0
            if good is None:
                self._on_refusal(outcome, service, now)
                return
            self._busy = 0
            if request.dsap == SAP_SLAVE_DIAG:
                self._on_diagnosis(good, now)
            else:
                self._step(Trigger.ACK, now)

    def _on_silence(self, service: str, why: Failure, now: int, *, long: bool) -> None:
        if self.state is SlaveState.OFFLINE:
            self._silent += 1
            self._pacing.absent(now, long=long)
            if self._silent >= _ABSENT_AFTER and not self.reports.is_silent:
                baud = self._context.params.baud
                self.reports.set_fault(fault_texts.absent(self.setup.address, baud, why), now)
            self._step(Trigger.SILENT, now)
            return
        fault = None
        if self.state in (SlaveState.SET_PRM, SlaveState.CHK_CFG):
            self._ready.unacked = service
        else:
            fault = fault_texts.lost(service, why, self.plugin_host.moved())
        self._step(Trigger.SILENT, now, fault)

    def _on_refusal(self, outcome: Telegram, service: str, now: int) -> None:
        self._busy += 1
        self._pacing.busy(now)
        if self._busy >= _MAX_BUSY:
            self._busy = 0
            self._step(Trigger.REFUSED, now, fault_texts.refused(service, refusal_text(outcome)))

    # --- diagnosis ----------------------------------------------------------------------------------------------

    def _on_diagnosis(self, answer: Telegram, now: int) -> None:
        diagnosis = self.reports.read_diagnosis(answer.data, now)
        if diagnosis is None:
            self._on_refusal(answer, "Slave_Diag", now)
            return
        owner = foreign_owner(diagnosis, self._context.params.address)
        if self._refused_data:
            self._refused_data = False
            if diagnosis.prm_req and self.image.input_time >= self._overdue_at:
                self.prm_req_at = now
                self._changed(self, now)
        other = self._other_device(diagnosis) if diagnosis.ident != self.ident else None
        if diagnosis.prm_req or owner is not None or other is not None:
            self.owned = False
        if other is not None:
            self._step(Trigger.DIAG_OTHER, now, other)
        elif owner is not None:
            self._step(Trigger.DIAG_LOCKED, now, fault_texts.locked(diagnosis, owner, self._context.ring()))
        elif self.state is SlaveState.DATA_EXCHANGE:
            self._judge_exchanging(diagnosis, now)
        elif self.state is SlaveState.WAIT_READY:
            self._judge_ready(diagnosis, now)
        else:
            if self._left is not None:
                self.reports.set_fault(fault_texts.left(diagnosis, self._left), now)
                self._left = None
            if not self._pacing.pauses(now):
                self._ready.shown_ident = diagnosis.ident
                if diagnosis.ident != self.ident:
                    self.reports.remark(fault_texts.adapts(self.ident, diagnosis.ident), now)
                if self.setup.isochronous is not None:
                    self._refuse_isochronous(self.setup.isochronous, now)
                    return
                self._step(Trigger.DIAG_FREE, now)

    def _refuse_isochronous(self, demand: IsochronousDemand, now: int) -> None:
        """Refuse a slave that demands isochronous mode with the lateness of the port. Its own diagnoses measure that
        first, if nobody else's answers have."""
        lateness = self._context.lateness()
        is_new = self.state in (SlaveState.OFFLINE, SlaveState.DIAGNOSIS)
        measures = self.state is SlaveState.OFFLINE or now - self.since < _MEASURING_NS
        if lateness is not None and not lateness.answers and is_new and measures:
            self._step(Trigger.DIAG_MEASURING, now)
            self._pacing.due = now
            return
        self._step(Trigger.DIAG_ISOCHRONOUS, now, self._ready.demands(demand, lateness))

    def _other_device(self, diagnosis: Diagnosis) -> Fault | None:
        """The fault of a device with another ident number; None if it adapts, or has adapted, to the configured one.

        Such a device shows its own number until Set_Prm, and may show it afterwards, too.
        """
        if not self.setup.ident_adapts:
            return fault_texts.wrong_ident(self.ident, diagnosis.ident)
        if self.state in _BEFORE_PRM:
            return None
        if self.state is SlaveState.WAIT_READY and (diagnosis.prm_fault or diagnosis.prm_req):
            why = "Prm_Fault" if diagnosis.prm_fault else "Prm_Req after Set_Prm"
            return fault_texts.not_adapted(self.ident, diagnosis.ident, why, self._ready.prm_sent)
        if diagnosis.prm_req or diagnosis.ident == self._ready.shown_ident:
            return None
        return fault_texts.wrong_ident(self.ident, diagnosis.ident)

    def _judge_ready(self, diagnosis: Diagnosis, now: int) -> None:
        waited = now - self.since
        verdict, fault = self._ready.judge(self.setup, diagnosis, waited)
        if verdict is Trigger.DIAG_WAIT:
            self._pacing.not_ready(now, waited)
        elif verdict is Trigger.DIAG_READY and self._watchdog and not diagnosis.wd_on:
            self.reports.remark(fault_texts.NOT_WATCHING, now)
        self._step(verdict, now, fault)

    def _end_inquiry(self, actual: bytes | None, now: int) -> None:
        """The end of Get_Cfg: the ``actual`` identifier octets, None without a good answer."""
        if self._inquiry is None:
            return
        (event, fault), self._inquiry = self._inquiry, None
        if self.state is SlaveState.FAULT:
            self.reports.set_fault(fault.compared(actual), now)
            self._changed(self, now)
        else:
            self._step(event, now, fault.compared(actual))

    def _judge_exchanging(self, diagnosis: Diagnosis, now: int) -> None:
        verdict = verdict_exchanging(diagnosis)
        self.diag_due = verdict is Trigger.DIAG_WAIT
        self._pacing.exchanging(now, static=self.diag_due)
        self.image.valid = verdict is Trigger.DIAG_READY
        self._left = "" if verdict is Trigger.DIAG_PRM_REQ else None
        refused = verdict is Trigger.DIAG_REFUSED
        self._step(verdict, now, fault_texts.refusal(self.setup, diagnosis, self._ready.prm_sent) if refused else None)
        if self.state is SlaveState.DATA_EXCHANGE:
            self.reports.observer.read(diagnosis, self.reports.flagged, self.exchanges, now)
            self._forget_announcement()
        self._changed(self, now)

    def _forget_announcement(self) -> None:
        self.reports.flagged = 0
        self._context.announced.discard(self.setup.address)

    def operate_ordered(self, now: int) -> None:
        """An event before the order of Operate is no stall. A slave that was not asked until then, as in Stop, wants
        parameters because of that: its Prm_Req counts again when it has exchanged data."""
        # the next request comes later than the order, so half of the watchdog is enough
        if 2 * (now - self.asked_at) > self.watchdog_effective_ns:
            self._overdue_at = now
        self.asked_at = max(self.asked_at, now)
        self.prm_req_at = NEVER

    def not_asked(self, now: int) -> None:
        """A stall, or all slaves want parameters at once: this slave does not count as flapping, and its Prm_Req is no
        second stall."""
        if self.state is _DATA_EXCHANGE:
            if self.watchdog_effective_ns and now - self.asked_at > self.watchdog_effective_ns:
                self._overdue_at = now
                self._pacing.excuse(now, left=False)
        elif self.prm_req_at != NEVER:
            self._pacing.excuse(now, left=True)
            self._changed(self, now)

    def want_diagnosis(self, now: int) -> None:
        """Request Slave_Diag as the next service of the slave."""
        if not self.diag_due:
            self.diag_due = True
            self._changed(self, now)

    # --- states -------------------------------------------------------------------------------------------------

    def _step(self, trigger: Trigger, now: int, fault: Fault | None = None) -> None:
        """Take the row of the table. After a CfgFault the master sends Get_Cfg, to report the configuration of the
        slave.

        In Wait_Ready the state changes only after that answer. A slave in data exchange goes to Fault at once, which
        leads to safe outputs and Unlock.
        """
        row = TABLE.get((self.state, trigger))
        if row is None:
            self.reports.remark(fault_texts.unlisted(self.state, trigger), now)
            return
        if isinstance(fault, CfgFault):
            self._inquiry = (trigger, fault)
            if self.state is SlaveState.WAIT_READY:
                return
            self.reports.keep_fault(fault.compared(None))
        elif fault is not None:
            self.reports.set_fault(fault, now)
        if row.next is not self.state:
            self._enter(row.next, now)
        elif row.next is SlaveState.FAULT:
            self._busy = 0
            self._pacing.refused(now)

    def _enter(self, state: SlaveState, now: int) -> None:
        was, self.state = self.state, state
        self.reports.mark_changed()
        if was is SlaveState.DATA_EXCHANGE:
            self._leave_exchange(now, silent=state is SlaveState.OFFLINE)
        elif was is SlaveState.OFFLINE:
            self._pacing.answered()
        self.since = now
        self._busy = 0
        self._was_away |= state in AWAY
        self._refused_data = was is _DATA_EXCHANGE and state is SlaveState.DIAGNOSIS
        if state not in _BRINGING_UP:
            self.prm_req_at = NEVER
        self._odd.clear()
        self._ready.entered(state)
        if state is SlaveState.DATA_EXCHANGE and (self._was_away or self.reports.fault is not None):
            self._was_away = False
            self._withhold()
        if state in (SlaveState.DATA_EXCHANGE, SlaveState.DEACTIVATED):
            self.reports.clear()
        if state is SlaveState.DATA_EXCHANGE:
            self.bring_ups.entered_exchange()
            self.plugin_host.remind(now)
            self.reports.observer.opened(self.reports.diagnosis, now)
        elif state is SlaveState.FAULT:
            self._pacing.refused(now)
        elif state in (SlaveState.OFFLINE, SlaveState.DEACTIVATED):
            self.restart = True
            self.owned = False
            self._left = self._inquiry = None
            self._silent = 0
            self._pacing.absent(now)
        self.reports.event(SlaveStateChanged, now, state=state)
        self.report_withheld(now)
        self._changed(self, now)

    def _leave_exchange(self, now: int, *, silent: bool) -> None:
        """Make the inputs invalid, end pending orders of the plugin, begin the next bring-up with a first request."""
        self.image.valid = False
        self._forget_announcement()
        self.bring_ups.left_exchange(now, now - self.since)
        self.diag_due = False
        self.restart = True
        self._pacing.left(now, now - self.since, silent=silent)
        self._was_away = True
        self.interrupted(now)
        self.reports.observer.closed(now)

    # --- outputs of the application (docs/reference/decisions/master.md#outputs-after-a-slave-was-away) ----------

    def set_outputs(self, octets: bytes) -> None:
        """The application sets the outputs of the next round in Operate. Raises ValueError for a wrong length."""
        self.image.outputs = octets
        if self.image.withheld is not None:
            self.image.withheld = self._reported = None
            self.reports.mark_changed()

    def outputs_too_old(self, octets: bytes, now: int) -> None:
        """The application set ``octets`` before it could know that the slave was away: they are withheld."""
        self.image.withheld = octets
        self.reports.mark_changed()
        self.report_withheld(now)

    def interrupted(self, now: int) -> None:
        """Data exchange ended, or outputs went to their safe values: neither drive nor outputs go on by themselves."""
        self.plugin_host.lost(now)
        self._withhold()

    def _withhold(self) -> None:
        if self.setup.after_return == "safe" and self.image.plugin is None:
            self.image.withhold(self.setup.safe_outputs)
            self.reports.mark_changed()

    def report_withheld(self, now: int) -> None:
        """Report outputs that are withheld once, when the slave gets outputs."""
        withheld = self.image.withheld
        new = withheld is not None and withheld != self._reported
        if new and self.state is _DATA_EXCHANGE and self._context.operates:
            self._reported = withheld
            self.reports.event(OutputsWithheld, now, outputs=withheld)

    # --- orders and news of other parts --------------------------------------------------------------------------

    def deactivate(self, now: int) -> None:
        """Take it out of service; nothing is asked of it until :meth:`activate`."""
        if self.state is not SlaveState.DEACTIVATED:
            self._step(Trigger.DEACTIVATE, now)

    def activate(self, now: int) -> None:
        """Bring it up (again), from the beginning."""
        if self.state is SlaveState.DEACTIVATED:
            self._step(Trigger.ACTIVATE, now)
            self._pacing = Pacing()

    def station_found(self, now: int) -> None:
        """A GAP poll of its address was answered after silence. It may be another device: reset the back-off."""
        if self.state in (SlaveState.FAULT, SlaveState.OFFLINE):
            self._pacing.anew(now)

    def diagnosis_seen(self, octets: bytes, now: int) -> None:
        """Another user of this station has read its diagnosis: another ident number means another device."""
        diagnosis, last = Diagnosis.parse(octets), self.reports.diagnosis
        if diagnosis is not None and last is not None and diagnosis.ident != last.ident:
            self.station_found(now)

    def line_lost(self, reason: str, now: int) -> None:
        """The bus is gone (port vanished, out of the ring): nobody is in data exchange any more."""
        if self.state not in (SlaveState.OFFLINE, SlaveState.DEACTIVATED):
            if self.state is SlaveState.DATA_EXCHANGE:
                self.reports.set_fault(fault_texts.bus_gone(reason), now)
            self._enter(SlaveState.OFFLINE, now)
            self._pacing.due = now
