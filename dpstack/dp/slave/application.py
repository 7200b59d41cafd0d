"""The DP slave: the application of a passive station around a device.

:class:`SlaveApp` answers Data_Exchange, carries out Global_Control and keeps the deadlines. The device, written by its
author, processes the data. The other services are in :mod:`dpstack.dp.slave.services`, state, lock and watchdog in
:mod:`dpstack.dp.slave.state`, the tables of states in :mod:`dpstack.dp.slave.state_table`, cyclic data in
:mod:`dpstack.dp.slave.cyclic_data`, checks of parameters and configuration in :mod:`dpstack.dp.slave.prm_cfg_check`,
fault bits in :mod:`dpstack.dp.slave.state`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from dpstack.dp.error_origin import DEVICE_CALL
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.pdu.requests import GlobalControl, SetSlaveAdd
from dpstack.dp.slave.device import DpV0Device, Leave
from dpstack.dp.slave.events import SlaveAppStats, WatchdogExpired
from dpstack.dp.slave.extension import SlaveService
from dpstack.dp.slave.prm_cfg_check import check_device
from dpstack.dp.slave.services import handlers
from dpstack.dp.slave.state import DeviceClock, SlaveCore
from dpstack.dp.slave.state_table import ACCESS, CONNECTION, AppTrigger, SlaveAppState
from dpstack.errors import PduError
from dpstack.fdl.interface import RS_REPLY, Reply, StationControl
from dpstack.fdl.telegram import FC_FUNCTION, SAP_GLOBAL_CONTROL, Req, Resp, Telegram
from dpstack.params import UNADDRESSED
from dpstack.trace import Event

__all__ = ["SlaveApp", "SlaveAppState", "SlaveAppStats"]

_DH: Final = Resp.DH
#: SRD low and high differ in bit 0 of the function; bit 6 is that of a request.
_SRD_MASK: Final = 0x4E
_SRD: Final = 0x4C
_MSRD: Final = int(Req.MSRD)


class SlaveApp(SlaveCore):
    """A ``Responder`` around ``device``; ``address`` is for messages, until a station is built around it.

    ``address_fixed``: an earlier Set_Slave_Add came with No_Add_Chg, so that the address may not be changed any more.
    Raises ConfigError if ident number or configurations of the device cannot be.
    """

    def __init__(self, device: DpV0Device, *, address: int | None = None, address_fixed: bool = False) -> None:
        check_device(device)
        super().__init__(device, address, address_fixed)
        self._handlers = handlers(self)
        #: services of the device that have deadlines
        self._timed = [one for one in self.services if type(one).tick is not SlaveService.tick]
        self._clock = DeviceClock(device)
        self._device_due = self._clock.due
        broadcast = self.broadcast
        #: requests that are answered to all (MSRD) come to :meth:`serve`
        self.takes_msrd = broadcast is not None and broadcast.can_publish
        #: gets answers of other stations to all; None: this slave subscribes none
        self.overhear = self._overhear if broadcast is not None and broadcast.can_subscribe else None
        self._stats: SlaveAppStats = self.report.stats
        self._exchanges = 0  # a Struct takes ten times as long to count
        #: the events that its station has not taken yet
        self.events: Sequence[Event] = self.report.events
        #: returns the events since the last call, oldest first; the station calls it in every step
        self.take_events: Callable[[], list[Event]] = self.report.take_events

    def __repr__(self) -> str:
        return f"<SlaveApp {self.device.name} at {self.address}: {self.state.value}>"

    # --- its state ------------------------------------------------------------------------------------------------

    @property
    def address(self) -> int | None:
        """The address of its station."""
        return self.report.address

    @property
    def stats(self) -> SlaveAppStats:
        """Counters since the start, always the same object."""
        self._stats.exchanges = self._exchanges
        return self._stats

    @property
    def address_fixed(self) -> bool:
        """No_Add_Chg was set: Set_Slave_Add is closed until :meth:`initial_reset`."""
        return self.set_address.fixed

    @property
    def kept_address(self) -> tuple[int | None, bool]:
        """The address that it has from the next power-on, and whether that is fixed then."""
        return self.set_address.kept

    @property
    def clear(self) -> bool:
        """True while the outputs are not valid: not in data exchange, or in Clear."""
        return self.data is None or self.data.void

    def diagnosis(self, now: int) -> Diagnosis:
        """The diagnosis as a Slave_Diag at ``now`` would read it."""
        return self.build_diagnosis(self.user_diag(now))

    # --- at the device itself -------------------------------------------------------------------------------------

    def initial_reset(self, now: int) -> None:
        """As delivered: address 126, open for Set_Slave_Add; then as after :meth:`restart`."""
        self.step(AppTrigger.POWER_ON, now, Leave.POWER_OFF)
        try:
            self.set_address.change(SetSlaveAdd(UNADDRESSED, self.device.ident), None, now)
        except Exception as error:
            self.fail("an initial reset", error, now)
            return
        self.restart(now)

    def rate_lost(self, now: int) -> None:
        """The baud rate is searched again: no master can use the services of the device any more."""
        self.end_services("the baud rate was lost", now)

    # --- Responder ----------------------------------------------------------------------------------------------

    def attached(self, station: StationControl) -> None:
        """A station was built around this application."""
        self.report.station = station
        self.set_address.keep(station.address)

    def serve(self, request: Telegram, now: int) -> Reply | None:
        """Answer a request; Data_Exchange first, it comes in every rotation."""
        if request.dsap is not None:
            return self._service(request, now)
        data = self.data
        if data is None or request.sa != self.master or request.fc & _SRD_MASK != _SRD:
            is_broadcast = self.takes_msrd and request.fc & FC_FUNCTION == _MSRD
            if not is_broadcast or data is None or request.sa != self.master:
                return self._service(request, now)  # not open
            if self.broadcast is None or not self.broadcast.publishes:
                return None  # docs/reference/decisions/dxb.md#publisher
        self.watchdog.last_request = now
        octets = request.data
        try:
            if data.plain and len(octets) == data.output_len:
                data.outputs = octets
                try:
                    run = data.run  # an attribute: called as a method it is looked up as such in vain
                    inputs = run(octets, now)
                except Exception as error:
                    DEVICE_CALL.mark(error)
                    raise
                if inputs is not data.inputs and (inputs != data.inputs or type(inputs) is not bytes):
                    data.take(inputs, hold=False)
            elif len(octets) == data.output_len or data.accepts(octets):
                data.exchange(octets, now)
            else:
                return self._wrong_length(request.sa, len(octets), data.output_len, now)
            waiting = not self.diag.silent and self.diag.waiting(request.fc)
        except Exception as error:
            self.fail("Data_Exchange", error, now)
            return RS_REPLY
        self._exchanges += 1
        if waiting:  # DH until the diagnosis is fetched; SC could not say so
            return Reply(_DH, data.inputs)
        return data.reply

    def indicate(self, telegram: Telegram, now: int) -> None:
        """Global_Control of the owner, and the time of a class 3 master; everything else is dropped."""
        if telegram.function == Req.TIME_EVENT:
            for service in self.services:
                service.hear_clock(telegram, now)
            return
        data = self.data
        if telegram.dsap != SAP_GLOBAL_CONTROL or data is None:
            return
        if telegram.sa != self.master:
            self._stats.foreign += 1
            return
        try:
            command = GlobalControl.parse(telegram.data)
        except PduError as error:
            self.report.refused("Global_Control", telegram.sa, str(error), now)
            return
        if command.group_mask and not command.group_mask & self.group:
            return
        self._stats.services += 1
        try:
            data.control(command, now)
        except Exception as error:
            self.fail("Global_Control", error, now)

    def _overhear(self, telegram: Telegram, now: int) -> None:
        """The answer of a publisher to all stations."""
        if self.data is not None and self.broadcast is not None:
            self.broadcast.hear(telegram, now)
            self._refresh(now)

    def _refresh(self, now: int) -> None:
        """Give the device outputs of publishers that have changed."""
        broadcast, data = self.broadcast, self.data
        if broadcast is None or data is None or not broadcast.stale:
            return
        broadcast.stale = False
        try:
            data.refresh(now)
        except Exception as error:
            self.fail("the broadcast of a publisher", error, now)

    def wake_at(self) -> int:
        """The next deadline of the watchdog, of the device's services, or of the device itself."""
        at = self.watchdog.at
        if self._timed:
            for service in self._timed:
                if service.at < at:
                    at = service.at
        if self.failure is not None:
            return at
        due = self._device_due
        if due is None:
            wanted = self.device.due_at
            return wanted if wanted < at else at
        try:
            wanted = due()
        except Exception as error:
            wanted = self._clock.failed(error)
        return wanted if wanted < at else at

    def tick(self, now: int) -> None:
        """Check the watchdog and the deadlines of the device's services, then call ``tick`` of the device."""
        for service in self._timed:
            if service.at <= now:
                service.tick(now)
        if self.broadcast is not None:
            self._refresh(now)
        if self.watchdog.expired(now):
            self._stats.watchdogs += 1
            self.report.emit(WatchdogExpired, now, master=self.master, watchdog_ns=self.watchdog.time_ns)
            self.step(AppTrigger.WATCHDOG, now, Leave.WATCHDOG)
        if self.failure is None:
            try:
                restart_at = self._clock.tick(now)
            except Exception as error:
                self.fail("its own time", error, now)
                return
            if restart_at is not None:
                self.restart_at(restart_at, now)

    # --- inside -------------------------------------------------------------------------------------------------

    def _service(self, request: Telegram, now: int) -> Reply:
        dsap = request.dsap
        access = ACCESS.get(dsap, CONNECTION)
        handler = self._handlers.get(dsap)
        foreign = request.sa != self.master
        closed = handler is None or self.state not in access.states or (access.owner_only and foreign)
        if handler is None or closed or request.fc & _SRD_MASK != _SRD:
            self._stats.refused += 1
            self._stats.foreign += self.master is not None and foreign
            return RS_REPLY
        self._stats.services += 1
        if not foreign:
            self.watchdog.last_request = now
            self.diag.owner_asked(request.fc)
        reply = handler(request, now)
        if reply is None:
            self._stats.refused += 1
            return RS_REPLY
        return reply

    def _wrong_length(self, sa: int, got: int, expected: int, now: int) -> Reply:
        self.diag.cfg_fault = True
        self.report.refused("Data_Exchange", sa, f"{got} output octets, the configuration has {expected}", now)
        self.step(AppTrigger.LENGTH, now, Leave.WRONG_LENGTH)
        return RS_REPLY
