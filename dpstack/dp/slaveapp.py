"""The DP slave: the application of a passive station, around a device that somebody wrote.

It owns the services and the three states (tables in :mod:`dpstack.dp.slave_states`) and the lock to one master.
Cyclic data are in :mod:`dpstack.dp.slave_data`, the judging of parameters and the watchdog in
:mod:`dpstack.dp.slave_prm`, fault bits in :mod:`dpstack.dp.slave_diag`; what is done with the data is the device's.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dpstack.dp.device import Device, Leave
from dpstack.dp.diagnosis import Diagnosis
from dpstack.dp.pdu import GlobalControl, SetPrm
from dpstack.dp.slave_clock import DeviceClock
from dpstack.dp.slave_data import CyclicData, wrong_inputs
from dpstack.dp.slave_diag import DiagState
from dpstack.dp.slave_prm import Refusal, Watchdog, check_device, judge_cfg, judge_prm
from dpstack.dp.slave_report import Report, SlaveAppStats
from dpstack.dp.slave_states import ACCESS, TABLE, AppEv, SlaveAppState
from dpstack.errors import PduError
from dpstack.fdl.passive import PassiveStation
from dpstack.fdl.telegram import (
    SAP_CHK_CFG,
    SAP_GET_CFG,
    SAP_GLOBAL_CONTROL,
    SAP_RD_INP,
    SAP_RD_OUTP,
    SAP_SET_PRM,
    SAP_SLAVE_DIAG,
    Resp,
    Telegram,
)
from dpstack.fdl.user import RS_REPLY, SC_REPLY, Reply, StationControl
from dpstack.params import BusParams
from dpstack.phy.patience import EXACT, Patience
from dpstack.trace import Event

__all__ = ["SlaveApp", "SlaveAppState", "SlaveAppStats", "make_slave"]

_DL: Final = Resp.DL
_DH: Final = Resp.DH
#: SRD low and high differ in bit 0 of the function; bit 6 is that of a request.
_SRD_MASK: Final = 0x4E
_SRD: Final = 0x4C


class SlaveApp:
    """A ``Responder`` around ``device``; ``address`` is for messages, until a station is built around it.

    Raises ConfigError where ident number or configurations of the device cannot be.
    """

    __slots__ = (
        "_clock",
        "_data",
        "_diag",
        "_group",
        "_handlers",
        "_report",
        "device",
        "failure",
        "master",
        "state",
        "stats",
        "watchdog",
    )

    def __init__(self, device: Device, *, address: int | None = None) -> None:
        check_device(device)
        self.device = device
        self.state = SlaveAppState.WAIT_PRM
        #: the master that has locked the slave
        self.master: int | None = None
        #: what failed in the device, None while it works
        self.failure: str | None = None
        self._report = Report(device, address)
        self.stats: SlaveAppStats = self._report.stats
        self._diag = DiagState(device)
        self.watchdog = Watchdog()
        self._data: CyclicData | None = None
        self._group = 0
        self._clock = DeviceClock(device)
        self._handlers: dict[int, Callable[[Telegram, int], Reply]] = {
            SAP_SLAVE_DIAG: self._slave_diag,
            SAP_SET_PRM: self._set_prm,
            SAP_CHK_CFG: self._chk_cfg,
            SAP_GET_CFG: self._get_cfg,
            SAP_RD_INP: self._rd_inp,
            SAP_RD_OUTP: self._rd_outp,
        }

    def __repr__(self) -> str:
        return f"<SlaveApp {self.device.name} at {self.address}: {self.state.value}>"

    # --- what it is ---------------------------------------------------------------------------------------------

    @property
    def address(self) -> int | None:
        """The address of its station."""
        return self._report.address

    @property
    def outputs(self) -> bytes:
        """The outputs the device has; empty while not in data exchange."""
        return b"" if self._data is None else self._data.outputs

    @property
    def inputs(self) -> bytes:
        """The inputs the master reads; empty while not in data exchange."""
        return b"" if self._data is None else self._data.inputs

    @property
    def clear(self) -> bool:
        """True while the outputs are not valid: not in data exchange, or in Clear."""
        return self._data is None or self._data.void

    def diagnosis(self, now: int) -> Diagnosis:
        """The diagnosis as a Slave_Diag at ``now`` would read it."""
        ext = self._read_ext(now)
        wd_on, ill = self.watchdog.time_ns > 0, self.failure is not None
        return self._diag.build(self.state, self.master, self._data, wd_on=wd_on, ill=ill, ext=ext)

    def restart(self, now: int) -> None:
        """Off and on again: Wait_Prm, nothing kept, a failure forgotten."""
        self._step(AppEv.POWER_ON, now, Leave.POWER_OFF)
        self.failure = None
        self._diag.clear_faults()
        self._report.forget()

    # --- Responder ----------------------------------------------------------------------------------------------

    def attached(self, station: StationControl) -> None:
        """A station was built around this application."""
        self._report.station = station

    def serve(self, request: Telegram, now: int) -> Reply | None:
        """Answer a request; Data_Exchange first, it comes in every rotation."""
        if request.dsap is not None:
            return self._service(request, now)
        data = self._data
        if data is None or request.sa != self.master or request.fc & _SRD_MASK != _SRD:
            return self._service(request, now)  # not open
        self.watchdog.heard = now
        octets = request.data
        try:
            if data.plain and len(octets) == data.output_len:
                data.outputs = octets
                inputs = data.run(octets, now)
                if len(inputs) != data.input_len:
                    raise ValueError(wrong_inputs(len(inputs), data.input_len))
                data.inputs = inputs
            elif data.accepts(octets):
                inputs = data.exchange(octets, now)
            else:
                return self._wrong_length(request.sa, len(octets), data.output_len, now)
            waiting = self._diag.ext is not None and self._diag.waiting()
        except Exception as error:
            self._fail("Data_Exchange", error, now)
            return RS_REPLY
        self.stats.exchanges += 1
        if waiting:  # B6: DH until the diagnosis is fetched; SC could not say so
            return Reply(_DH, inputs)
        return Reply(_DL, inputs) if inputs else SC_REPLY

    def indicate(self, telegram: Telegram, now: int) -> None:
        """Global_Control of the owner; everything else is dropped."""
        data = self._data
        if telegram.dsap != SAP_GLOBAL_CONTROL or data is None:
            return
        if telegram.sa != self.master:
            self.stats.foreign += 1
            return
        try:
            command = GlobalControl.parse(telegram.data)
        except PduError as error:
            self._report.refused("Global_Control", telegram.sa, str(error), now)
            return
        if command.group_mask and not command.group_mask & self._group:
            return
        self.stats.services += 1
        try:
            data.control(command, now)
        except Exception as error:
            self._fail("Global_Control", error, now)

    def wake_at(self) -> int:
        """The watchdog, or what the device wants."""
        at = self.watchdog.at
        if self.failure is not None:
            return at
        due = self._clock.wake_at()
        return due if due < at else at

    def tick(self, now: int) -> None:
        """Judge the watchdog, let the device have its time."""
        if self.watchdog.expired(now):
            self._report.watchdog(self.master, self.watchdog.time_ns, now)
            self._step(AppEv.WATCHDOG, now, Leave.WATCHDOG)
        if self.failure is None:
            try:
                self._clock.tick(now)
            except Exception as error:
                self._fail("its own time", error, now)

    def take_events(self) -> list[Event]:
        """What there is to tell, oldest first."""
        return self._report.take()

    # --- services -----------------------------------------------------------------------------------------------

    def _service(self, request: Telegram, now: int) -> Reply:
        access = ACCESS.get(request.dsap)
        handler = self._handlers.get(request.dsap or 0)
        if access is None or handler is None or self.state not in access.states or request.fc & _SRD_MASK != _SRD:
            self.stats.refused += 1
            self.stats.foreign += self.master is not None and request.sa != self.master
            return RS_REPLY
        self.stats.services += 1
        if request.sa == self.master:
            self.watchdog.heard = now
        return handler(request, now)

    def _wrong_length(self, sa: int, got: int, expected: int, now: int) -> Reply:
        self._diag.cfg_fault = True
        self._report.refused("Data_Exchange", sa, f"{got} output octets, the configuration has {expected}", now)
        self._step(AppEv.LENGTH, now, Leave.WRONG_LENGTH)
        return RS_REPLY

    def _slave_diag(self, request: Telegram, now: int) -> Reply:
        octets = self.diagnosis(now).build()
        if request.sa == self.master:
            self._diag.fetched()
        return Reply(_DL, octets)

    def _read_ext(self, now: int) -> bytes:
        read = self._diag.ext
        if read is not None and self.failure is None:
            try:
                return bytes(read())
            except Exception as error:
                self._fail("Slave_Diag", error, now)
        return b""

    def _get_cfg(self, request: Telegram, now: int) -> Reply:
        return _data_reply(self.device.configs[0] if self._data is None else self._data.config)

    def _rd_inp(self, request: Telegram, now: int) -> Reply:
        return _data_reply(self.inputs)

    def _rd_outp(self, request: Telegram, now: int) -> Reply:
        return _data_reply(self.outputs)

    # --- Set_Prm ------------------------------------------------------------------------------------------------

    def _set_prm(self, request: Telegram, now: int) -> Reply:
        sa = request.sa
        if self.master is not None and sa != self.master:
            self._foreign("Set_Prm", sa, AppEv.PRM_FOREIGN, now)
            return SC_REPLY
        try:
            prm = SetPrm.parse(request.data)
            refusal = judge_prm(self.device, prm, ask_device=self.failure is None)
        except PduError as error:
            self._prm_bad(sa, Refusal(str(error)), now)
            return SC_REPLY
        except Exception as error:
            self._fail("Set_Prm", error, now)
            return SC_REPLY
        if refusal is not None:
            self._prm_bad(sa, refusal, now)
        elif prm.unlock:
            self._diag.clear_faults()
            self._step(AppEv.UNLOCK, now, Leave.UNLOCK)
        elif prm.lock:
            self._prm_good(sa, prm, now)
        else:
            self._take_min_tsdr(prm.min_tsdr)
            self._step(AppEv.PRM_KEEP, now)
        return SC_REPLY

    def _prm_bad(self, sa: int, refusal: Refusal, now: int) -> None:
        # B1: Not_Supported says it more exactly than Prm_Fault
        self._diag.clear_faults()
        self._diag.not_supported = refusal.not_supported
        self._diag.prm_fault = not refusal.not_supported
        self._report.refused("Set_Prm", sa, refusal.reason, now)
        self._step(AppEv.PRM_BAD, now, Leave.NEW_PARAMETERS)

    def _prm_good(self, sa: int, prm: SetPrm, now: int) -> None:
        self._diag.clear_faults()
        self._diag.new_owner()
        self._take_min_tsdr(prm.min_tsdr)
        self.master = sa
        self._group = prm.group_mask
        self.watchdog.arm(prm.watchdog, now)
        self._step(AppEv.PRM_GOOD, now, Leave.NEW_PARAMETERS)

    def _take_min_tsdr(self, bits: int) -> None:
        if self._report.station is not None:
            self._report.station.set_min_tsdr(bits)

    # --- Chk_Cfg ------------------------------------------------------------------------------------------------

    def _chk_cfg(self, request: Telegram, now: int) -> Reply:
        config = request.data
        if request.sa != self.master:
            self._foreign("Chk_Cfg", request.sa, AppEv.CFG_FOREIGN, now)
        elif self.failure is not None:
            self._step(AppEv.CFG_HELD, now)
        elif self._data is not None and config == self._data.config:
            self._step(AppEv.CFG_GOOD, now)
        else:
            self._judge_cfg(request.sa, config, now)
        return SC_REPLY

    def _judge_cfg(self, sa: int, config: bytes, now: int) -> None:
        try:
            verdict = judge_cfg(self.device, config)
        except Exception as error:
            self._fail("Chk_Cfg", error, now)
            return
        if isinstance(verdict, Refusal):
            self._diag.cfg_fault = True
            self._report.refused("Chk_Cfg", sa, verdict.reason, now)
            self._step(AppEv.CFG_BAD, now, Leave.NEW_CONFIGURATION)
        else:
            self._cfg_good(config, *verdict, now)

    def _cfg_good(self, config: bytes, inputs: int, outputs: int, now: int) -> None:
        if not self._leave(Leave.NEW_CONFIGURATION, now):
            return
        try:
            self.device.enter(config, now)
        except Exception as error:
            self._fail("Chk_Cfg", error, now)
            return
        self._diag.cfg_fault = False
        self._data = CyclicData(self.device, config, inputs, outputs)
        self._report.forget()
        self._step(AppEv.CFG_GOOD, now)

    # --- states -------------------------------------------------------------------------------------------------

    def _step(self, event: AppEv, now: int, leave: Leave | None = None) -> None:
        was = self.state
        state = self.state = TABLE[was, event].next
        if state is SlaveAppState.WAIT_PRM:
            self.master = None
            self._group = 0
            self.watchdog.disarm()
        if state is not was:
            self._report.state(state, event, self.master, now)
        if leave is not None and state is not SlaveAppState.DATA_EXCH:
            self._leave(leave, now)

    def _leave(self, reason: Leave, now: int) -> bool:
        """Give up the cyclic data, and the outputs with them; False when the device failed at that."""
        if self._data is None:
            return True
        self._data = None
        try:
            self.device.leave(reason, now)
        except Exception as error:
            self._fail(f"leaving ({reason.value})", error, now)
            return False
        return True

    def _fail(self, during: str, error: Exception, now: int) -> None:
        self.failure = f"{type(error).__name__}: {error}"
        self._report.failed(during, error, now)
        self._step(AppEv.FAILED, now, Leave.FAILURE)

    def _foreign(self, service: str, sa: int, event: AppEv, now: int) -> None:
        self.stats.foreign += 1
        owner = "nobody has parameterised the slave" if self.master is None else f"it is locked by master {self.master}"
        self._report.refused(service, sa, owner, now)
        self._step(event, now)


def make_slave(
    address: int, device: Device, params: BusParams, *, t_sdr: int | None = None, patience: Patience = EXACT
) -> PassiveStation:
    """A whole slave: a passive station at ``address`` with a :class:`SlaveApp` around ``device`` as its responder.

    ``params`` give baud rate, min T_SDR and slot time; ``t_sdr`` is the station's own response time in bit times.
    Raises ConfigError.
    """
    return PassiveStation(address, SlaveApp(device, address=address), params, t_sdr=t_sdr, patience=patience)


def _data_reply(octets: bytes) -> Reply:
    """Data, or NR where there are none (A3)."""
    return Reply(_DL, octets) if octets else Reply(Resp.NR)
