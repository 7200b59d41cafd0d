"""The common part of a simulated drive: a DP device with an internal scan, a motor and a parameter channel.

The drive reads its outputs and refreshes its inputs once in ``scan_ns`` of the bus's clock, on a grid that begins when
it is switched on (at its first call). It catches up the scans between two exchanges at the next exchange, so results do
not depend on how often it is called.
"""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Mapping
from functools import cache
from typing import Final

from dpstack.dp.pdu.alarm_blocks import Alarm, AlarmType, Specifier
from dpstack.dp.pdu.diagnosis import FIXED_LEN
from dpstack.dp.slave.device import Leave
from dpstack.dpv1.slave.alarms import AlarmServer, AlarmSupport
from dpstack.dpv1.slave.device import Device
from dpstack.errors import AlarmError
from dpstack.profile.channel.base import ChannelServer
from dpstack.profile.channel.indexed import IndexedDialect, IndexedServer, RefusedAccess
from dpstack.profile.channel.pkw import ARRAYS, PLAIN_PKW, READS, Pkw, PkwDialect, PkwServer, ReplyId, TaskId
from dpstack.profile.model.drive_type import CHANNEL_LEN, DriveType, Options, TelegramSpec
from dpstack.profile.model.param_errors import BAD_SUBINDEX, BAD_TYPE, ILLEGAL_NUMBER, OPERATING_STATE, READ_ONLY
from dpstack.profile.model.param_store import ParamStore
from dpstack.profile.model.params import ParamSpec, ParamTable
from dpstack.profile.record47.parameter_server import ParameterServer
from dpstack.profile.simulator.motor import Motor
from dpstack.units import NEVER, NS_PER_MS

#: from a setting that restarts the station to the restart: time to fetch the answer (made up)
RESTART_NS: Final = 100 * NS_PER_MS
#: ids of the parameter channel: read, write of a word (a double word is the next one), replies with either
_PLAIN_IDS: Final = (TaskId.READ, TaskId.WRITE_WORD, ReplyId.WORD, ReplyId.LONG)
_ARRAY_IDS: Final = (TaskId.READ_ARRAY, TaskId.WRITE_ARRAY_WORD, ReplyId.ARRAY_WORD, ReplyId.ARRAY_LONG)
#: scans that are caught up one by one; the first part of a longer pause is skipped
_MOST_SCANS = 20_000


class DriveDevice(Device):
    """Subclass it: :meth:`scan` (or :meth:`refresh`) and :meth:`master_lost`. Raises ConfigError for wrong ``presets``.

    ``telegram`` is the one in use, at first the drive's own.

    Faults and conditions from outside: :meth:`trip`, :meth:`acknowledge`, :meth:`warn`, :meth:`set_load`,
    :meth:`release`, :meth:`contact`, :meth:`set_point`, :meth:`refuse`; they take effect at the next scan.
    ``parameter_errors``: texts of the errors of an access to a parameter, by number.
    """

    #: the parameters
    parameter_table: ParamTable = ParamTable(())
    #: number of data sets
    data_sets: int = 1
    #: names of the faults of :meth:`trip` by number
    trips: Mapping[int, str] = {}
    #: text for the number of a fault that :meth:`trip` does not know
    unknown_trip: str = "no fault of this drive"
    #: names of the contacts and terminals of :meth:`contact`
    contacts: tuple[str, ...] = ()
    #: internal scan time in ns
    scan_ns: int = 4 * NS_PER_MS
    #: layout of the parameter channel, and its differences from plain PKW
    dialect: PkwDialect | IndexedDialect = PLAIN_PKW
    #: name of the parameter that holds the station address; "": it has none
    address_parameter: str = ""
    parameter_errors: Mapping[int, str] = {}
    #: error numbers that only reads give
    read_errors: frozenset[int] = frozenset()
    #: error numbers that only writes give
    write_errors: frozenset[int] = frozenset()

    def __init__(
        self, profile: DriveType, telegram: TelegramSpec, options: Options, presets: Mapping[str, object]
    ) -> None:
        #: the simulated drive in messages about its configuration
        self.title = f"simulated {profile.name}"
        #: values of the parameters
        self.store = ParamStore(self.parameter_table, presets, sets=self.data_sets, where=self.title)
        #: the drive that it simulates
        self.profile = profile
        self.ident = profile.ident
        self.name = profile.name
        self.fail_safe = profile.fail_safe
        configs = [telegram.config, *(spec.config for spec in profile.telegrams.values())]
        self.configs = tuple(dict.fromkeys(configs))
        #: telegram in use, at first that of its options
        self.telegram = telegram
        #: the simulated motor
        self.motor: Motor = Motor(load=float(options["load"])) if "load" in options else Motor()
        #: its end of the parameter channel
        self.channel: ChannelServer = (
            IndexedServer(self.dialect, self.access_by_index)
            if isinstance(self.dialect, IndexedDialect)
            else PkwServer(self.dialect, self.carry_out, refuse=self.refuse_order)
        )
        #: record 47, for a subclass that has it among its ``records``
        self.record47: ParameterServer | None = None
        #: bits of the warnings that stand, as :meth:`warn` sets them
        self.warning_mask = 0
        #: the enable input is on, see :meth:`release`
        self.released = True
        #: contacts that are on now
        self.contacts_on = frozenset[str]()
        #: contacts that are on at its commissioning
        self.contacts_wired = frozenset[str]()
        #: outputs of the last exchange; None while there are no valid ones
        self.last_outputs: bytes | None = None
        self._inputs = b""
        self._next: int | None = None
        self._powered = True
        #: fault that begins with the next scan, see :meth:`take_trip`; None without one
        self.pending_trip: int | None = None
        self._tripped: str | None = None  # by trip(), while the fault stands
        self._own_load: float | None = None  # before set_load()
        #: 1 forward, -1 reverse, 0 no jog
        self.jog_direction = 0  # as in jog()
        #: the inverter has no power under its bus option: no answers in the parameter channel
        self.unpowered = False
        self._refusal: tuple[int, int, str] | None = None  # by refuse(): number, how many times left, the user's word
        #: its station address, None before it was installed
        self.station_address: int | None = None

    # -- faults and conditions from outside --------------------------------------------------------------------------

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.title}>"

    def trip(self, code: str) -> None:
        """Trip with a fault, by its code or name. Raises ValueError with the known ones."""
        self.pending_trip = self.fault_code(code)
        self._tripped = code

    def warn(self, mask: int) -> None:
        """Set the warning word; 0 clears it."""
        self.warning_mask = mask & 0xFFFF

    def set_load(self, load: float) -> None:
        """Load torque of the rated torque, against the motion."""
        if self._own_load is None:
            self._own_load = self.motor.load
        self.motor.load = load

    def acknowledge(self) -> None:
        """Acknowledge the fault at the keypad. Raises ValueError if none stands, or the drive locks it."""
        if not self.faulted:
            raise ValueError("no fault stands")
        self.reset_fault()

    def release(self, on: bool) -> None:
        self.released = on

    def contact(self, name: str, on: bool) -> None:
        """Switch one of :attr:`contacts` (any case). Raises ValueError with those that there are."""
        found = next((known for known in self.contacts if known.lower() == name.strip().lower()), None)
        if found is None:
            known = f"it has {', '.join(self.contacts)}" if self.contacts else "it has none here"
            raise ValueError(f"{name!r} is no contact of {self.profile.name}; {known}")
        self.contacts_on = self.contacts_on | {found} if on else self.contacts_on - {found}

    def set_point(self, hertz: float) -> None:
        """The internal set point. Raises ValueError if the drive has none here."""
        raise ValueError(f"{self.profile.name} has no internal set point here")

    def jog(self, direction: int) -> None:
        """Jog terminals: 1 forward, -1 reverse, 0 off. Raises ValueError if the drive has none."""
        raise ValueError(f"{self.profile.name} has no jog terminals here")

    def link(self, on: bool) -> None:
        """The link between the bus option and the inverter. Raises ValueError if it has none."""
        raise ValueError(f"{self.profile.name} has no link here that can break")

    def mains(self, on: bool) -> None:
        """The inverter's power under an option that stays on the bus. Raises ValueError if both have one supply."""
        raise ValueError(f"{self.profile.name} has one supply for all of it: power-off and power-on")

    def refuse(self, error: str, times: int = 1) -> None:
        """The next accesses to parameters end with an error, given by its number or a word of its text.

        Raises ValueError with the errors that the drive knows.
        """
        wanted = error.strip().lower()
        found = [number for number in self.parameter_errors if wanted == str(number)] or [
            number for number, text in self.parameter_errors.items() if wanted in text.lower().split()
        ]
        if len(found) == 1:
            self._refusal = (found[0], times, wanted)
            return
        known = ", ".join(f"{number} ({text})" for number, text in self.parameter_errors.items()) or "none"
        raise ValueError(f"{error!r} is not one error of parameters of {self.profile.name}; known: {known}")

    def refusal(self, *, write: bool) -> int | None:
        """The error number, ordered by :meth:`refuse`, of an access to a parameter that begins now, or None."""
        if self._refusal is None:
            return None
        number, times, given = self._refusal
        if number in (self.read_errors if write else self.write_errors):
            return None
        self._refusal = (number, times - 1, given) if times > 1 else None
        return number

    def refuse_order(self, order: Pkw) -> tuple[int, int] | None:
        """:meth:`refusal` as the parameter channel answers it."""
        number = self.refusal(write=order.id not in READS)
        return None if number is None else (ReplyId.ERROR, number)

    def has_alarms(self, *kinds: str) -> None:
        """Let it raise alarms of these ``kinds``, one of each at a time, if its master enables them."""
        self.alarm_server = AlarmServer(AlarmSupport(frozenset(kinds)), self.max_diag_len - FIXED_LEN, self.name)

    def diagnosis_alarm(self, slot: int, appears: bool, data: bytes = b"") -> None:
        """Raise a diagnosis alarm: a fault of ``slot`` appears, or the last one is gone. Does nothing if its master
        accepts no alarm now.
        """
        if self.alarm_server is not None:
            how = Specifier.APPEARS if appears else Specifier.DISAPPEARS
            with contextlib.suppress(AlarmError):
                self.alarm_server.alarm(Alarm(AlarmType.DIAGNOSIS, slot, how, data=data))

    @property
    def faulted(self) -> bool:
        """Whether a fault stands, until it is acknowledged."""
        return False

    @property
    def injected(self) -> tuple[str, ...]:
        """Faults and conditions of the drive from outside, written as the commands of ``dpstack ctl``."""
        found = []
        if self._tripped is not None:
            found.append(f"trip {self._tripped}")
        if self.warning_mask:
            found.append(f"warn {self.warning_mask:04X}")
        if self._own_load not in (None, self.motor.load):
            found.append(f"load {self.motor.load:g}")
        if not self.released:
            found.append("release off")
        found += [
            f"contact {name} {'on' if name in self.contacts_on else 'off'}"
            for name in self.contacts
            if (name in self.contacts_on) != (name in self.contacts_wired)
        ]
        if self.jog_direction:
            found.append("jog forward" if self.jog_direction > 0 else "jog reverse")
        if self._refusal is not None:
            _, times, given = self._refusal
            found.append(f"parameter-error {given} {times}")
        return tuple(found)

    def inherit(self, before: DriveDevice) -> None:
        """Take over EEPROM and contacts of ``before``, the same drive before it was switched off and on."""
        self.store.inherit(before.store)
        self.contacts_on = before.contacts_on

    def installed(self, address: int, baud: int | None) -> None:
        """Set its address and the baud rate in bit/s, None while it is not known."""
        self.station_address = address
        if self.address_parameter:
            self.store.install(self.address_parameter, address)

    def switch_off(self, now: int) -> None:
        """It has no power any more: its scans end, the motor coasts."""
        self.advance(now)
        self.motor.switch(False)
        self._powered = False

    def restart_soon(self) -> None:
        """Restart :data:`RESTART_NS` after the last scan, at the address of its own setting."""
        self.due_at = (self.seen_until or 0) + RESTART_NS

    def tick(self, now: int) -> int | None:
        """The address at which it restarts."""
        self.due_at = NEVER
        self.advance(now)
        if self.own_address is not None:
            self.station_address = self.own_address
        return self.station_address

    @property
    def own_address(self) -> int | None:
        """The station address of its own setting, valid from the next power-on; None: it has no such setting."""
        return int(self.store.value(self.address_parameter)) if self.address_parameter else None

    def address_set(self, address: int, fixed: bool, rem_slave_data: bytes) -> bool:
        """Set_Slave_Add, of a drive that has the service: store it as its address parameter."""
        if self.address_parameter:
            self.store.install(self.address_parameter, address)
        return bool(self.address_parameter)

    # -- Device ---------------------------------------------------------------------------------------------------

    def check_cfg(self, config: bytes) -> str | None:
        return None if self.profile.telegrams_of(config) else super().check_cfg(config)

    def check_prm(self, user_prm: bytes) -> str | None:
        """Any octets of the length the drive's GSD gives, and zeros behind them."""
        length = len(self.profile.user_prm)
        if len(user_prm) < length:
            return f"{len(user_prm)} octets of user parameters, {length} are needed"
        if any(user_prm[length:]):
            return f"user parameters after octet {length} must be 0"
        return None

    def enter(self, config: bytes, now: int) -> None:
        """Data exchange begins; the telegram follows from the identifier octets."""
        self.advance(now)
        self.telegram = self.profile.telegrams_of(config)[0]
        self.last_outputs = None
        self.channel.reset()
        if self.record47 is not None:
            self.record47.reset()
        self._next = now + self.scan_ns
        self.motor.advance(now)
        self._refresh(now)

    def exchange(self, outputs: bytes, now: int) -> bytes:
        """Set the outputs for the next scan, return the inputs of the last one."""
        if self._next is None or now >= self._next:
            self.advance(now)
        if outputs != self.last_outputs:
            self.last_outputs = outputs if len(outputs) == self.telegram.output_octets else None
        return self._inputs

    def clear(self, now: int) -> None:
        """Outputs are invalid until the next ones."""
        self.advance(now)
        self.last_outputs = None

    def leave(self, reason: Leave, now: int) -> None:
        self.advance(now)
        self.last_outputs = None
        self.master_lost(reason, now)

    @property
    def seen_until(self) -> int | None:
        """The time up to which its scans are done; None before its first call."""
        return None if self._next is None else self._next - self.scan_ns

    def advance(self, now: int) -> None:
        """Do every scan up to ``now``. Call it before reading the drive between exchanges."""
        at = self._next
        if at is not None and now < at:
            return
        if not self._powered:
            self.motor.advance(now)
            return
        scan_ns = self.scan_ns
        if at is None:  # switched on
            self._next = now + scan_ns
            self.motor.advance(now)
            return
        behind = (now - at) // scan_ns - _MOST_SCANS
        if behind > 0:
            at += behind * scan_ns
        while at <= now:
            self.motor.advance(at)
            self._refresh(at)
            at += scan_ns
        self._next = at

    # -- what a drive adds ----------------------------------------------------------------------------------------

    def fault_code(self, code: str) -> int:
        """The number of a fault from its number or name. Raises ValueError."""
        wanted = code.strip().lower()
        for number, name in self.trips.items():
            if wanted in (str(number), name.lower()):
                return number
        raise ValueError(f"{code!r} is {self.unknown_trip}")

    def reset_fault(self) -> None:
        """End the fault, as its acknowledgement does. Raises ValueError while it is locked."""
        raise ValueError(f"{self.profile.name} cannot be acknowledged at its keypad here")

    def live(self, spec: ParamSpec) -> int | None:
        """The actual value on the wire of a parameter that is not stored."""
        return None

    def locked(self, spec: ParamSpec) -> bool:
        """Whether the parameter cannot be written now: error 17."""
        return False

    def carry_out(self, order: Pkw) -> tuple[int, int]:
        """Reply id and PWE to an order of the parameter channel: every parameter by its PNU, and by its index if the
        drive has orders of arrays."""
        table, array = self.store.table, self.dialect.arrays and order.id in ARRAYS
        spec = table.get(order.pnu, order.ind if array else 0)
        if spec is None or spec.text:
            others = array and any(one.number == order.pnu for one in table)
            return ReplyId.ERROR, BAD_SUBINDEX if others else ILLEGAL_NUMBER
        wide = spec.type.wide
        read, write, word, long = _ARRAY_IDS if array else _PLAIN_IDS
        reply = long if wide else word
        if order.id == read:
            actual = self.live(spec)
            return reply, spec.pwe(self.store.raw(spec) if actual is None else actual)
        raw = spec.from_pwe(order.pwe)
        error = spec.write_error(raw)
        if error != READ_ONLY and order.id != write + wide:
            error = BAD_TYPE
        elif error is None and self.locked(spec):
            error = OPERATING_STATE
        if error is not None:
            return ReplyId.ERROR, error
        self.store.write(spec, raw)
        return reply, spec.pwe(raw)

    def access_by_index(self, index: int, subindex: int, raw: int | None, octets: int) -> tuple[int, int]:
        """Value and octets of a parameter of an :class:`IndexedDialect`, which is written if ``raw`` is not None."""
        assert isinstance(self.dialect, IndexedDialect)
        refusals = self.dialect.refusals
        if (ordered := self.refusal(write=raw is not None)) is not None:
            raise RefusedAccess(ordered)
        spec = self.store.table.get(index, subindex)
        if spec is None or spec.text:
            raise RefusedAccess(refusals[ILLEGAL_NUMBER])
        if raw is None:
            actual = self.live(spec)
            return (self.store.raw(spec) if actual is None else actual) & 0xFFFF_FFFF, 4
        value = spec.from_wire(raw, 8 * octets)
        error = spec.write_error(value)
        if error is None and self.locked(spec):
            error = OPERATING_STATE
        if error is not None:
            raise RefusedAccess(refusals[error])
        self.store.write(spec, value)
        return raw, octets

    def refresh(self, process: bytes | None, now: int) -> bytes:
        """An internal scan over octets, with words to and from :meth:`scan`; ``process`` None: invalid."""
        telegram = self.telegram
        words = None if process is None else _layout(telegram.outputs).unpack(process)
        found = self.scan(words, now)
        try:
            return _layout(telegram.inputs).pack(*found)
        except struct.error as error:
            text = f"{type(self).__name__}.scan() returned {found!r}"
            raise ValueError(
                f"{text}; {telegram.name} has {telegram.inputs // 2} words of 0..65535 ({error})"
            ) from None

    def scan(self, words: tuple[int, ...] | None, now: int) -> tuple[int, ...]:
        """An internal scan: process data from the master (None: invalid) -> process data to it."""
        raise NotImplementedError

    def master_lost(self, reason: Leave, now: int) -> None:
        """React to the end of data exchange."""

    def take_trip(self) -> int | None:
        """The trip since the last scan; resets it."""
        trip, self.pending_trip = self.pending_trip, None
        return trip

    # -- inside ---------------------------------------------------------------------------------------------------

    def _refresh(self, now: int) -> None:
        outputs = self.last_outputs
        lead = CHANNEL_LEN if self.telegram.channel else 0
        reply = b""
        if lead:
            order = bytes(lead) if outputs is None else outputs[:lead]
            reply = bytes(lead) if self.unpowered else self.channel.step(order)
        inputs = reply + self.refresh(None if outputs is None else outputs[lead:], now)
        if inputs != self._inputs:  # the slave takes the same object as unchanged
            self._inputs = inputs
        if self._tripped is not None and self.pending_trip is None and not self.faulted:
            self._tripped = None


@cache
def _layout(octets: int) -> struct.Struct:
    """Process data of so many octets as words."""
    return struct.Struct(f">{octets // 2}H")
