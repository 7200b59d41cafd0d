"""The common part of a simulated drive: a DP device with an internal scan, a motor and a parameter channel.

The drive looks at its outputs and refreshes its inputs once in ``scan_ns`` of the bus's clock, on a grid that begins
when it is switched on (first seen). What happens between two exchanges is caught up at the next one, so results do
not depend on how often it is asked.
"""

from __future__ import annotations

import struct
from functools import cache

from dpstack.dp.device import Device, Leave
from dpstack.profile.acyclic.server import ParameterServer
from dpstack.profile.channel import CHANNEL_LEN, ChannelServer
from dpstack.profile.drive import DriveProfile, TelegramSpec
from dpstack.profile.motor import Motor
from dpstack.profile.store import ParamStore

#: scans that are caught up one by one; of a longer silence the first part is skipped
_MOST_SCANS = 20_000


class DriveDevice(Device):
    """Subclass it: :meth:`scan` (or :meth:`refresh`) and :meth:`master_lost`.

    ``telegram`` is the one in use, at first the drive's own.

    Faults and conditions from outside: :meth:`trip`, :meth:`warn`, :meth:`set_load`, :meth:`release`; they take
    effect at the next scan. ``address_parameter``: the one in ``store`` that holds the station address.
    """

    address_parameter: str = ""
    store: ParamStore

    def __init__(self, profile: DriveProfile, telegram: TelegramSpec, motor: Motor) -> None:
        self.profile = profile
        self.ident = profile.ident
        self.name = profile.name
        self.fail_safe = profile.fail_safe
        configs = [telegram.config, *(spec.config for spec in profile.telegrams.values())]
        self.configs = tuple(dict.fromkeys(configs))
        self.telegram = telegram
        self.motor = motor
        self.channel: ChannelServer | None = None
        #: record 47, for whoever makes it one of ``records``
        self.record47: ParameterServer | None = None
        self.warning_mask = 0
        self.released = True
        self._outputs: bytes | None = None
        self._inputs = b""
        self._next: int | None = None
        self._trip: int | None = None
        self._tripped: str | None = None  # by trip(), until the drive has no fault any more
        self._own_load: float | None = None  # before set_load()
        self._jog = 0

    # -- what happens to it from outside --------------------------------------------------------------------------

    def trip(self, code: str) -> None:
        """A fault by its code or name. Raises ValueError naming what the drive knows."""
        self._trip = self.fault_code(code)
        self._tripped = code

    def warn(self, mask: int) -> None:
        """Set the warning word; 0 clears it."""
        self.warning_mask = mask & 0xFFFF

    def set_load(self, load: float) -> None:
        """Load torque of the rated torque, against the motion."""
        if self._own_load is None:
            self._own_load = self.motor.load
        self.motor.load = load

    def release(self, on: bool) -> None:
        """The hardware release inputs."""
        self.released = on

    def jog(self, direction: int) -> None:
        """Jog terminals: 1 forward, -1 reverse, 0 off. Raises ValueError where the drive has none."""
        raise ValueError(f"{self.profile.name} has no jog terminals here")

    @property
    def faulted(self) -> bool:
        """Whether a fault stands, until it is acknowledged."""
        return False

    @property
    def injected(self) -> tuple[str, ...]:
        """What was done to it from outside and is not over, written as the orders of ``dpstack ctl``."""
        told = []
        if self._tripped is not None:
            told.append(f"trip {self._tripped}")
        if self.warning_mask:
            told.append(f"warn {self.warning_mask:04X}")
        if self._own_load not in (None, self.motor.load):
            told.append(f"load {self.motor.load:g}")
        if not self.released:
            told.append("release off")
        if self._jog:
            told.append("jog forward" if self._jog > 0 else "jog reverse")
        return tuple(told)

    def inherit(self, before: DriveDevice) -> None:
        """Switched on again: ``before`` is the drive as it was; take what it kept in its EEPROM."""

    def installed(self, address: int, baud: int | None) -> None:
        """Where it stands: its address and the baud rate in bit/s, None while it is not known."""
        if self.address_parameter:
            self.store.install(self.address_parameter, address)

    @property
    def own_address(self) -> int | None:
        """The station address that it has by its own setting from the next power-on; None: the one it has."""
        return int(self.store.value(self.address_parameter)) if self.address_parameter else None

    def address_set(self, address: int, fixed: bool, rem_slave_data: bytes) -> bool:
        """Set_Slave_Add, of a drive that has the service: kept as its address parameter."""
        if self.address_parameter:
            self.store.install(self.address_parameter, address)
        return bool(self.address_parameter)

    # -- Device ---------------------------------------------------------------------------------------------------

    def check_cfg(self, config: bytes) -> str | None:
        """A telegram of the drive."""
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
        self._outputs = None
        if self.channel is not None:
            self.channel.reset()
        if self.record47 is not None:
            self.record47.reset()
        self._next = now + self.scan_ns
        self.motor.advance(now)
        self._refresh(now)

    def exchange(self, outputs: bytes, now: int) -> bytes:
        """Take ``outputs`` for the next scan, return the inputs of the last one."""
        self.advance(now)
        self._outputs = outputs if len(outputs) == self.telegram.output_octets else None
        return self._inputs

    def clear(self, now: int) -> None:
        """Outputs are void until they come again."""
        self.advance(now)
        self._outputs = None

    def leave(self, reason: Leave, now: int) -> None:
        """Data exchange ended."""
        self.advance(now)
        self._outputs = None
        self.master_lost(reason, now)

    @property
    def seen_until(self) -> int | None:
        """Up to when it has caught up with the bus's clock; None before it was ever looked at."""
        return None if self._next is None else self._next - self.scan_ns

    def advance(self, now: int) -> None:
        """Catch up with the bus's clock: every scan up to ``now``. For whoever looks at the drive between exchanges."""
        at = self._next
        if at is not None and now < at:
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

    @property
    def scan_ns(self) -> int:
        """The internal scan time with the telegram in use."""
        return 4_000_000

    def fault_code(self, code: str) -> int:
        """The number of a fault from its code or name. Raises ValueError."""
        raise ValueError(f"{self.name} knows no fault {code!r}")

    def refresh(self, process: bytes | None, now: int) -> bytes:
        """One internal scan over octets, which hands words to :meth:`scan`; ``process`` None: void."""
        telegram = self.telegram
        words = None if process is None else _layout(telegram.outputs).unpack(process)
        return _layout(telegram.inputs).pack(*self.scan(words, now))

    def scan(self, words: tuple[int, ...] | None, now: int) -> tuple[int, ...]:
        """One internal scan: process data from the master (None: void) -> process data to it."""
        raise NotImplementedError

    def master_lost(self, reason: Leave, now: int) -> None:
        """React to the end of data exchange."""

    def take_trip(self) -> int | None:
        """The trip that came since the last scan."""
        trip, self._trip = self._trip, None
        return trip

    # -- inside ---------------------------------------------------------------------------------------------------

    def _refresh(self, now: int) -> None:
        outputs = self._outputs
        lead = CHANNEL_LEN if self.telegram.channel else 0
        reply = b""
        if lead:
            order = bytes(lead) if outputs is None else outputs[:lead]
            reply = bytes(lead) if self.channel is None else self.channel.step(order)
        self._inputs = reply + self.refresh(None if outputs is None else outputs[lead:], now)
        if self._tripped is not None and self._trip is None and not self.faulted:
            self._tripped = None


@cache
def _layout(octets: int) -> struct.Struct:
    """Process data of so many octets as words."""
    return struct.Struct(f">{octets // 2}H")
