"""State, lock, watchdog and address of a slave application, and its steps through the table of states.

Every way out of data exchange and every exception of the device go through :class:`SlaveCore`, which gives up outputs
and lock in one place. :class:`DeviceClock` calls ``wake_at`` and ``tick`` of the device, so that a faulty device can
neither hang nor stop the bus.

The diagnosis of a slave application: its fault bits, and whether the master has read the rest.

Blocks stand in this order: alarm, status message, then what the device itself says, which is cut if there is no room
(Max_Diag_Data_Len).
"""

from __future__ import annotations

from collections.abc import Callable

from dpstack.dp.error_origin import DEVICE_CALL
from dpstack.dp.pdu.diag_bits import ALWAYS_ONE
from dpstack.dp.pdu.diag_blocks import NO_DIAG, UserDiag
from dpstack.dp.pdu.diagnosis import FIXED_LEN, Diagnosis
from dpstack.dp.pdu.requests import SetSlaveAdd
from dpstack.dp.slave.cyclic_data import CyclicData
from dpstack.dp.slave.device import DpV0Device, Leave
from dpstack.dp.slave.events import AddressChanged, Report, SlaveAppStateChanged
from dpstack.dp.slave.extension import BroadcastService, DiagMessages
from dpstack.dp.slave.state_table import TABLE, AppTrigger, SlaveAppState
from dpstack.fdl.passive.station import LOWEST_TSDR
from dpstack.fdl.telegram import FC_FCB, FC_FCV
from dpstack.params import MAX_STATION
from dpstack.units import NEVER, NOW


class DiagState:
    """Fault bits of one slave application, and what its owner has read of the application's own diagnosis.

    ``user`` asks the device, None if it never has anything to report; ``messages``: alarms and status messages,
    None if it has none. ``silent``: neither of them, there is never anything to fetch.
    """

    def __init__(self, device: DpV0Device, messages: DiagMessages | None = None) -> None:
        #: the ident number that it shows
        self.ident = device.ident
        self._room = device.max_diag_len - FIXED_LEN
        self._read_by_owner = NO_DIAG
        self._offered: UserDiag | None = None  # in an answer that the owner may not have received
        self.prm_fault = self.cfg_fault = self.not_supported = False
        is_plain = device.overrides_none("user_diag", "ext_diag")
        self.user: Callable[[], UserDiag] | None = None if is_plain else device.user_diag
        self._of_device = self.user
        self._messages = messages
        self.silent = self.user is None and messages is None

    def extend(self, more: Callable[[UserDiag], UserDiag]) -> None:
        """Report ``more`` of what the device itself reports, from now on."""
        ask = self._of_device
        self.user = lambda: more(NO_DIAG if ask is None else ask())
        self.silent = False

    def clear_faults(self) -> None:
        """Good parameters, release or restart."""
        self.prm_fault = self.cfg_fault = self.not_supported = False

    def new_owner(self) -> None:
        """Another master has read nothing yet."""
        self._read_by_owner = NO_DIAG
        self._offered = None

    def offer(self, user: UserDiag) -> None:
        """An answer with ``user`` in it goes to the owner; :meth:`owner_asked` finds out whether it arrived."""
        if self._messages is not None:
            self._messages.offered()
        self._offered = user

    def owner_asked(self, fc: int) -> None:
        """The owner's next new request: it has the answer before, unless it had to take the station up afresh.

        A request again with the same FCB never gets here: the link layer repeats the answer
        (docs/reference/protocol.md#frame-count-bit).
        """
        if self._offered is not None:
            if fc & (FC_FCV | FC_FCB) != FC_FCB:
                self._read_by_owner = self._offered
                if self._messages is not None:
                    self._messages.fetched()
            self._offered = None

    def waiting(self, fc: int) -> bool:
        """True when the owner, whose request has ``fc``, must fetch the diagnosis (DH)."""
        if self.silent:
            return False
        self.owner_asked(fc)
        # both are asked: with the first Data_Exchange alarms may be shown
        must_fetch = self._messages is not None and self._messages.must_fetch()
        if must_fetch or self.user is None:
            return must_fetch
        try:
            return self.user() != self._read_by_owner
        except Exception as error:
            DEVICE_CALL.mark(error)
            raise

    def build(
        self, state: SlaveAppState, master: int | None, data: CyclicData | None, user: UserDiag, *, wd: bool, ill: bool
    ) -> Diagnosis:
        """The diagnosis of this moment (docs/reference/protocol.md#slave_diag); ``wd``: the watchdog is on, ``ill``:
        the device is broken."""
        blocks = b"" if self._messages is None else self._messages.octets()
        user = user.limited(self._room - len(blocks))
        status1 = (
            (data is None) << 1 | self.cfg_fault << 2 | user.fault << 3 | self.not_supported << 4 | self.prm_fault << 6
        )
        status2 = ALWAYS_ONE | (state is SlaveAppState.WAIT_PRM) | (ill or user.stat) << 1 | wd << 3
        if data is not None:
            status2 |= data.frozen << 4 | data.synced << 5
        return Diagnosis(status1, status2, user.overflow << 7, master, self.ident, blocks + user.ext)


# No_Add_Chg closes the service for good; only an initial reset, done at the device itself, gives the slave the address
# 126 and opens it again.


class SlaveAddress:
    """The station address of one slave. ``fixed``: Set_Slave_Add is closed."""

    def __init__(self, device: DpV0Device, report: Report, fixed: bool) -> None:
        self._device = device
        self._report = report
        self.fixed = fixed
        #: the address from the next power-on, and whether Set_Slave_Add is closed then
        self.kept = (report.address, fixed)

    @property
    def open(self) -> bool:
        """True while the slave serves Set_Slave_Add."""
        return self._device.set_slave_add and not self.fixed

    def judge(self, wanted: SetSlaveAdd) -> str | None:
        """A reason to leave the address as it is, or None."""
        if wanted.ident != self._device.ident:
            return f"octets 2-3: ident number 0x{wanted.ident:04X}, this device is 0x{self._device.ident:04X}"
        if wanted.address > MAX_STATION:
            return f"octet 1: address {wanted.address} is outside 0..{MAX_STATION}"
        return None

    def keep(self, address: int | None) -> None:
        """Use ``address`` from the next restart on: it is the first one of the station, or a parameter of the device
        sets it."""
        self.kept = (address, self.kept[1])

    def restart(self) -> None:
        """The slave is switched on again: use the address that was kept."""
        address, self.fixed = self.kept
        if address is not None:
            self._report.readdress(address)

    def change(self, wanted: SetSlaveAdd, master: int | None, now: int) -> None:
        """Change the address as ``wanted`` says: by ``master``, or None for an initial reset. Exceptions of the device
        pass through, nothing is changed then."""
        address, fixed = wanted.address, wanted.no_add_chg
        before = self._report.address
        with DEVICE_CALL:
            kept = self._device.address_set(address, fixed, wanted.rem_slave_data) or master is None
        if kept:
            self.kept = (address, fixed)
        self.fixed = fixed
        self._report.readdress(address)
        self._report.emit(AddressChanged, now, before=before, master=master, fixed=fixed, kept=kept)


class Watchdog:
    """The watchdog of a slave: supervises the master that owns it. ``last_request``: time of the master's last request.

    ``at``: time of the next check by :meth:`expired`, or NEVER. All times in ns. A request only stores its time;
    ``at`` is moved on by the check.
    """

    def __init__(self) -> None:
        self.at = NEVER
        self.last_request = 0
        self.time_ns = 0

    def arm(self, time_ns: int, now: int) -> None:
        """Watch for ``time_ns`` from now on, 0 = off."""
        self.last_request = now
        self.time_ns = time_ns
        self.at = now + time_ns if time_ns else NEVER

    def expired(self, now: int) -> bool:
        """True when the time is over; otherwise the deadline moves on."""
        if self.at > now:
            return False
        self.at = self.last_request + self.time_ns
        return self.at <= now


class SlaveCore:
    """One slave application, as :class:`~dpstack.dp.slave.application.SlaveApp` and its services share it."""

    def __init__(self, device: DpV0Device, address: int | None, address_fixed: bool) -> None:
        #: the device that it serves
        self.device = device
        #: state of the slave application (WAIT_PRM, WAIT_CFG, DATA_EXCH)
        self.state = SlaveAppState.WAIT_PRM
        #: address of the master that has locked the slave; None without one
        self.master: int | None = None
        #: exception of the device, one line; None while it works
        self.failure: str | None = None
        #: collects events and counters
        self.report = Report(device.name, address)
        #: services of the device beyond DP-V0
        self.services = device.services(self.report)
        #: its data exchange broadcast; None if it neither publishes nor subscribes
        self.broadcast = next((one for one in self.services if isinstance(one, BroadcastService)), None)
        #: its diagnosis for the master
        self.diag = DiagState(device, next((one.messages for one in self.services if one.messages is not None), None))
        #: the address service
        self.set_address = SlaveAddress(device, self.report, address_fixed)
        #: watchdog that the master set
        self.watchdog = Watchdog()
        #: inputs and outputs; None outside data exchange
        self.data: CyclicData | None = None
        #: Group_Ident: one bit for each of the groups 1 to 8
        self.group = 0

    @property
    def outputs(self) -> bytes:
        """The outputs the device has; empty while not in data exchange."""
        return b"" if self.data is None else self.data.outputs

    @property
    def inputs(self) -> bytes:
        """The inputs the master reads; empty while not in data exchange."""
        return b"" if self.data is None else self.data.inputs

    def build_diagnosis(self, user: UserDiag) -> Diagnosis:
        """The diagnosis of this moment, with ``user`` from the device."""
        wd, ill = self.watchdog.time_ns > 0, self.failure is not None
        return self.diag.build(self.state, self.master, self.data, user, wd=wd, ill=ill)

    def user_diag(self, now: int) -> UserDiag:
        """The diagnosis of the device; nothing from a broken one."""
        ask = self.diag.user
        if ask is not None and self.failure is None:
            try:
                with DEVICE_CALL:
                    user = ask()
                if not isinstance(user, UserDiag):
                    raise TypeError(f"user_diag() returned {type(user).__name__}, a UserDiag is wanted")
                return user
            except Exception as error:
                self.fail("Slave_Diag", error, now)
        return NO_DIAG

    def set_min_tsdr(self, bits: int) -> None:
        """Hand min T_SDR of Set_Prm to the station."""
        if self.report.station is not None:
            self.report.station.set_min_tsdr(bits)

    def restart(self, now: int) -> None:
        """Switch the slave off and on: only its address is kept, a failure is forgotten."""
        self.step(AppTrigger.POWER_ON, now, Leave.POWER_OFF)
        self.end_services("the slave was switched off", now)
        self.failure = None
        self.diag.clear_faults()
        self.set_min_tsdr(LOWEST_TSDR)
        self.set_address.restart()
        self.report.report_again()

    def restart_at(self, address: int, now: int) -> None:
        """The device restarts by itself, at an address that was set at it."""
        self.set_address.keep(address)
        before = self.report.address
        self.restart(now)
        if before != address:
            self.report.emit(AddressChanged, now, before=before, master=None, fixed=self.set_address.fixed, kept=True)

    def step(self, event: AppTrigger, now: int, leave: Leave | None = None) -> None:
        """Take the row of ``event``; ``leave``: why data exchange ends, unless the row leads back into it."""
        was = self.state
        state = self.state = TABLE[was, event].next
        if state is SlaveAppState.WAIT_PRM:
            self.master = None
            self.group = 0
            self.diag.ident = self.device.ident
            self.watchdog.arm(0, now)
        if state is not was:
            self.report.emit(SlaveAppStateChanged, now, state=state, why=event, master=self.master)
        if leave is not None and state is not SlaveAppState.DATA_EXCH:
            self.leave(leave, now)

    def leave(self, reason: Leave, now: int) -> bool:
        """Give up the cyclic data, and the outputs with them; False when the device failed at that."""
        if self.data is None:
            return True
        self.data = None
        for service in self.services:
            service.left()
        try:
            with DEVICE_CALL:
                self.device.leave(reason, now)
        except Exception as error:
            self.fail(f"leaving ({reason.value})", error, now)
            return False
        return True

    def fail(self, during: str, error: Exception, now: int) -> None:
        """The device raised ``error``: leave data exchange, report it."""
        self.failure = f"{type(error).__name__}: {error}"
        self.report.failed(during, error, now)
        self.step(AppTrigger.FAILED, now, Leave.FAILURE)

    def end_services(self, why: str, now: int) -> None:
        """End everything that the services of the device have under way."""
        for service in self.services:
            service.end(why, now)

    def refuse_foreign(self, service: str, sa: int, event: AppTrigger, now: int) -> None:
        """A service of a master that does not own the slave: counted and reported, without effect."""
        self.report.stats.foreign += 1
        owner = "nobody has parameterised the slave" if self.master is None else f"it is locked by master {self.master}"
        self.report.refused(service, sa, owner, now)
        self.step(event, now)


class DeviceClock:
    """Calls ``tick`` of ``device`` when its ``wake_at`` asks for it. Exceptions come out of :meth:`tick` only."""

    def __init__(self, device: DpV0Device) -> None:
        self._device = device
        self._error: Exception | None = None
        #: Called after each request, tick and command: the time in ns at which :meth:`tick` is wanted. None: the device
        #: states it in ``due_at``. Exceptions go to :meth:`failed`.
        self.due = None if device.overrides_none("wake_at") else device.wake_at

    def failed(self, error: Exception) -> int:
        """``due`` raised ``error``: :meth:`tick`, which knows the time, will raise it. Returns when it is wanted."""
        DEVICE_CALL.mark(error)
        self._error = error
        return NOW

    def tick(self, now: int) -> int | None:
        """Let the device catch up with ``now``; the address at which it restarts by itself, None if it does not.

        Raises what the device raises, and RuntimeError when it never catches up.
        """
        device = self._device
        if self.due is None and device.due_at > now:
            return None
        if self._error is not None:
            error, self._error = self._error, None
            raise error
        with DEVICE_CALL:
            due = device.wake_at()
        restart: int | None = None
        while due <= now:
            before = due
            with DEVICE_CALL:
                address, due = device.tick(now), device.wake_at()
            restart = restart if address is None else address
            if due <= before:
                raise RuntimeError(f"wake_at() stays at {due} after tick({now})")
        return restart
