"""Simulated slaves that commands silence and switch off and on; those of a bus in virtual time."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import chain
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, cast

from dpstack.api.config.slave import SlaveConfig
from dpstack.api.injected import Injected, ScenarioEvent
from dpstack.dp.pdu.diag_blocks import FIRST_SLOT
from dpstack.dp.pdu.diagnosis import FIXED_LEN
from dpstack.dp.process_data import Field
from dpstack.dp.process_image import Value
from dpstack.dp.slave.application import SlaveApp
from dpstack.dp.slave.auto_baud import PortBaudChanged, SearchingSlave
from dpstack.dp.slave.events import SlaveAppEvent, SlaveAppStateChanged
from dpstack.dpv1.slave.alarms import AlarmServer, AlarmSupport
from dpstack.dpv1.slave.description import SlaveDescription
from dpstack.dpv1.slave.description_from_gsd import im_of_gsd
from dpstack.dpv1.slave.device import Device
from dpstack.dpv1.slave.loopback_device import HeldInputs, LengthsMirror, MirrorDevice, mirror_of
from dpstack.dpv1.slave.record_table import ImOf
from dpstack.dpv1.slave.user_slave import DpSlave
from dpstack.errors import UsageError
from dpstack.fdl.interface import BusStation
from dpstack.fdl.passive.station import PassiveStation
from dpstack.gsd.identifiers import io_lengths
from dpstack.machine import LineDown
from dpstack.params import BusParams
from dpstack.phy.patience import EXACT, Patience
from dpstack.sim.io_station import IDENT, NAME
from dpstack.sim.io_station.station import IoStation
from dpstack.sim.slave_faults import SlaveFaults, fault_text
from dpstack.sim.world import World
from dpstack.text import did_you_mean, octets_text
from dpstack.trace import Event
from dpstack.units import BAUD_RATES, NEVER, ns_to_s

if TYPE_CHECKING:
    from dpstack.api.config.cpu import CpuConfig
    from dpstack.api.slave_side.simulated_cpu import SimulatedPlantCpu
    from dpstack.devices.encoder_device import EncoderDevice
    from dpstack.devices.pa.device import PaDevice
    from dpstack.dpv1.slave.clock_receiver import PlantClock
    from dpstack.profile import DriveDevice
    from dpstack.profile.simulator.several_drives import SeveralDrivesDevice


#: the commands that a simulated S7-200 takes; the others are for slaves
CPU_COMMANDS: Final = ("set", "silence", "resume", "power-off", "power-on")


def sim_event_json(event: Event, t: float) -> dict[str, object]:
    """The JSON line of the ``event`` of a simulation or of a served slave at ``t`` seconds."""
    if isinstance(event, (Injected, ScenarioEvent)):
        return event.as_dict(t)
    line: dict[str, object] = {"event": "notice", "t": round(t, 6)}
    if isinstance(event, SlaveAppEvent):
        line |= {"address": event.address, "name": event.name}
    if isinstance(event, PortBaudChanged):
        return line | {"event": "baud", "state": event.state.value, "baud": event.baud}
    if isinstance(event, SlaveAppStateChanged):
        return line | {"event": "slave", "state": event.state.value, "master": event.master, "why": event.why.value}
    return line | {"text": event.text}


def device_of(slave: SlaveConfig, held: HeldInputs | None = None, im: ImOf = ()) -> Device:
    """The device that simulates ``slave``: its drive, the I/O station (by the ident number), or a loop-back device
    (mirror) of outputs to inputs, with the lengths, limits and services of the GSD file if it has one. Without ident
    number and with ``refuse_master`` it takes that of any master. ``held``: the inputs of a mirror from outside,
    ``im`` its I&M.

    One that adapts its ident number shows that of its GSD file, or else a made-up one, until Set_Prm.
    """
    device = _device_of(slave, held, im)
    can_publish = slave.params.dpv1 is not None and (slave.device is None or slave.device.publisher)
    if device.dxb is None and (can_publish or slave.params.links):
        _join_broadcast(device, slave, publisher=can_publish)
    wanted = slave.params.ident
    if slave.params.ident_adapts and wanted is not None:
        of_file = None if slave.device is None else slave.device.ident
        device.ident = wanted ^ _MADE_UP if of_file in (None, wanted) else of_file
        device.other_idents = frozenset((wanted,))
    return device


def _join_broadcast(device: Device, slave: SlaveConfig, *, publisher: bool) -> None:
    """Let a device of which no GSD file says what it can publish, also for a subscriber that comes later, and subscribe
    as its table wants."""
    from dpstack.dpv1.slave.dxb_links import DxbSupport  # here, as only slaves with DP-V1 have it

    device.dxb = DxbSupport(publisher, len(slave.params.links), first_slot=FIRST_SLOT)
    if slave.params.links and device.alarm_server is None:
        device.alarm_server = AlarmServer(AlarmSupport(), device.max_diag_len - FIXED_LEN, device.name)


#: what makes another ident number of the configured one
_MADE_UP: Final = 0x8000


def _device_of(slave: SlaveConfig, held: HeldInputs | None, im: ImOf) -> Device:
    if slave.drives:
        return _several(slave)
    profile = slave.any_profile
    if profile is not None:
        device: Device = profile.simulated(slave.telegram, slave.options, slave.simulated)
        if slave.params.ident is not None:
            device.ident = slave.params.ident
        device.name = slave.name
        return device
    params = slave.params
    if params.ident == IDENT:
        described = None if slave.description is None else _own(slave, slave.description)
        return IoStation(params.config, described, name=slave.name)
    if slave.description is not None:
        return mirror_of(_own(slave, slave.description), held, im)
    if params.ident is None and slave.refuse_master:  # its identifier octets only have the right lengths
        return LengthsMirror(0, params.config, params.name, fail_safe=True, held=held)
    return MirrorDevice(params.ident or 0, params.config, params.name, fail_safe=params.fail_safe, held=held)


def _several(slave: SlaveConfig) -> SeveralDrivesDevice:
    from dpstack.profile.simulator.several_drives import SeveralDrivesDevice, SimulatedPart  # here, as few have several

    parts = {
        one.name: SimulatedPart(
            one.profile.simulated(one.telegram, one.options, one.simulated),
            one.config,
            one.inputs,
            one.outputs,
            one.record_object,
        )
        for one in slave.drives
    }
    device = SeveralDrivesDevice(parts, slave.params.config, slave.params.input_len)
    if slave.params.ident is not None:
        device.ident = slave.params.ident
    device.name = slave.name
    return device


def _own(slave: SlaveConfig, description: SlaveDescription) -> SlaveDescription:
    """``description`` with the name of the slave, and with the ident number of its table if it has one."""
    ident = slave.params.ident
    return dataclasses.replace(description, name=slave.name, ident=description.ident if ident is None else ident)


def silence_text(left_ns: int) -> str:
    """The text of a silence with ``left_ns`` to go; NEVER: until a command ends it."""
    return "silence until resume" if left_ns >= NEVER // 2 else f"silence for {ns_to_s(left_ns):.1f} s more"


def rates_of(slave: SlaveConfig) -> Sequence[int]:
    """The baud rates of the device; all rates if it gives none."""
    return sorted(slave.baud_rates) or BAUD_RATES


def set_rate(slave: SlaveConfig) -> int | None:
    """The rate to which the device is set; None if it detects the rate."""
    fixed = slave.any_profile is not None and slave.any_profile.rate_setting is not None
    return rates_of(slave)[0] if fixed else None


class SimulatedSlave:
    """A simulated slave: station, application and device; :meth:`renew` creates them again.

    It keeps an address of Set_Slave_Add. A drive keeps its EEPROM and reads its address from there; an I/O station
    keeps its modules. ``searching``: it detects the baud rate, among those of the device. A device that cannot detect
    it stays at its set rate. ``own``: the device of a test, instead of a simulated one. ``t_sdr``: its T_SDR in bit
    times; None: min T_SDR.
    """

    def __init__(
        self,
        config: SlaveConfig,
        params: BusParams,
        patience: Patience = EXACT,
        *,
        searching: bool = False,
        own: Device | None = None,
        t_sdr: int | None = None,
    ) -> None:
        self.config = config
        self._t_sdr = t_sdr
        self.powered = True
        self._address = config.address
        self._address_fixed = False
        self._patience = patience
        self._searching = searching
        self._held = HeldInputs(config.params.input_len)
        self.faults = SlaveFaults()
        self._own = own
        self._im = {} if config.device is None else im_of_gsd(config.device, config.modules or ())
        self.device = self._new_device()
        self._create_station(params)

    @property
    def name(self) -> str:
        return self.config.name

    @property
    def kind(self) -> str:
        """The kind of the simulated device for people: its drive, the I/O station, or a mirror."""
        profile, description = self.config.any_profile, self.config.description
        if self._own is not None:
            return f"own, {self._own.name}"
        if profile is not None:
            return profile.name
        if self.config.drives:
            return ", ".join(f"{one.name}: {one.profile.name}" for one in self.config.drives)
        if isinstance(self.device, IoStation):
            return NAME
        return "mirror" if description is None else f"mirror, {description.name}"

    @property
    def address(self) -> int:
        """Its station address, which Set_Slave_Add may have changed."""
        return self.station.address

    @property
    def held_inputs(self) -> bytes | None:
        """The inputs of a mirror that were set from outside; None: it mirrors."""
        return self._held.octets

    @property
    def who(self) -> str:
        return f"slave {self.address} ({self.name})"

    @property
    def inputs(self) -> bytes:
        """The inputs as set from outside, else those of the last exchange, else zeros."""
        if isinstance(self.device, IoStation):
            return self.device.process_inputs
        if (process := self.process_device) is not None:
            return process.inputs()
        held = self._held.octets
        if held is not None:
            return held
        return self.app.inputs or bytes(self._held.length)

    def inputs_with(self, values: Mapping[str, object]) -> bytes:
        """:attr:`inputs` with named inputs set. Raises UsageError, ValueError."""
        image = self.inputs
        for name, value in values.items():
            image = self.put_input(image, name, value)
        return image

    def put_input(self, image: bytes, name: str, value: object) -> bytes:
        """``image`` with the named input as ``value``, a text or a number. Raises UsageError, ValueError."""
        field = self.input_field(name)
        return field.put(image, field.read(value) if isinstance(value, str) else value)

    @property
    def drive(self) -> DriveDevice | None:
        """The device if it is a simulated drive."""
        if self._own is not None:
            from dpstack.profile import DriveDevice  # here, as few tests have a device of their own

            return self._own if isinstance(self._own, DriveDevice) else None
        return None if self.config.profile is None else cast("DriveDevice", self.device)

    @property
    def encoder(self) -> EncoderDevice | None:
        """The device if it is a simulated encoder."""
        if self.config.device_profile is None or self._own:
            return None
        from dpstack.devices.encoder_device import EncoderDevice  # here, as few slaves are such devices

        return self.device if isinstance(self.device, EncoderDevice) else None

    @property
    def process_device(self) -> PaDevice | None:
        """The device if it is a simulated PROFIBUS PA device."""
        if self._own is None and (self.config.device_profile is None or self.encoder is not None):
            return None
        from dpstack.devices.pa.device import PaDevice  # as above

        return self.device if isinstance(self.device, PaDevice) else None

    @property
    def several(self) -> SeveralDrivesDevice | None:
        """The device if it is a simulated slave with several drives."""
        is_own = self._own is not None
        return None if is_own or not self.config.drives else cast("SeveralDrivesDevice", self.device)

    @property
    def _drives(self) -> DriveDevice | SeveralDrivesDevice | None:
        return self.drive or self.several

    @property
    def refused(self) -> str | None:
        """Its state and the reason of its last refusal since power-on or data exchange; None without one."""
        last = self.app.report.last_refusal
        return None if last is None else f"{self.app.state.value}: {last.text}"

    def check_settable(self) -> None:
        """Raises UsageError if the device makes its inputs itself: a drive, or the device of a test."""
        if self._own is not None:
            raise UsageError(f"{self.who}: its own function makes its inputs; change what the function returns")
        if self._drives is not None:
            raise UsageError(f"{self.who}: the simulated drive makes its inputs; trip, warn and load change them")
        if self.encoder is not None:
            raise UsageError(f"{self.who}: the simulated encoder makes its inputs; turn, trip and warn change them")

    def set_inputs(self, octets: bytes | None) -> str | None:
        """Set the inputs that the master reads; they stay over :meth:`renew`. None: mirror the outputs again.

        Returns a remark for people, or None. Raises UsageError for a drive, and for octets of another length.
        """
        self.check_settable()
        device, length = self.device, self._held.length
        if octets is not None and len(octets) != length:
            raise UsageError(f"{self.who} has {octets_text(length)} of inputs, {octets_text(len(octets))} given")
        if (process := self.process_device) is not None:
            process.release() if octets is None else process.set_inputs(octets)
            return None
        if not isinstance(device, IoStation):
            self._held.octets = octets
            return None
        if octets is None:
            raise UsageError(f"{self.who}: the I/O station mirrors nothing; give the octets of its inputs")
        return device.set_inputs(octets)

    def with_module_inputs(self, slot: int, octets: bytes) -> bytes:
        """The inputs with ``octets`` as those of the module in ``slot``, counted as its GSD file does.

        Raises UsageError with the slots that have inputs.
        """
        modules, device = self.config.modules, self.config.device
        if modules is None or device is None:
            raise UsageError(f"{self.who}: no GSD file says what its slots are; write `input SLAVE HEX`")
        at, known = 0, []
        for number, module in enumerate(modules, device.first_slot):
            length = 0 if module is None else io_lengths(module.config)[0]
            if number == slot and length == len(octets):
                return self.inputs[:at] + octets + self.inputs[at + length :]
            if length:
                known.append(f"slot {number}: {octets_text(length)}")
            at += length
        there = ", ".join(known) or "none"
        raise UsageError(f"{self.who}: slot {slot} has no {octets_text(len(octets))} of inputs; there are: {there}")

    def input_field(self, name: str) -> Field:
        """The declaration of a named input. Raises UsageError with the known ones."""
        fields = self.config.input_fields
        found = fields.fields.get(name)
        if found is not None:
            return found
        if name in self.config.output_fields:
            raise UsageError(f"{self.who}: {name} is an output, which its master sets")
        known = ", ".join(fields) or 'none; name them by its key inputs: { level = "i16@0" }'
        hint = did_you_mean(name, fields, f"there are: {known}")
        raise UsageError(f"{self.who}: no input is called {name!r}; {hint}")

    def as_dict(self) -> dict[str, object]:
        """State and counters since it was switched on. ``watchdogs``: expiries of its watchdog. ``too_late``: answers
        that it did not send because the next telegram had already begun.
        """
        stats = self.app.stats
        return {
            "name": self.name,
            "state": self.app.state.value,
            "exchanges": stats.exchanges,
            "watchdogs": stats.watchdogs,
            "too_late": self.station.stats.dropped,
        }

    def _new_device(self) -> Device:
        return device_of(self.config, self._held, self._im) if self._own is None else self._own

    def switch_off(self, now: int) -> None:
        """Take its power: its outputs are off, the motor of a drive coasts."""
        self.station.command(LineDown("switched off"), now)
        self.app.restart(now)
        if (drives := self._drives) is not None:
            drives.switch_off(now)

    def renew(self, params: BusParams) -> None:
        """Give it power again."""
        before, drives_before, encoder_before = self.device, self._drives, self.encoder
        process_before = self.process_device
        if isinstance(before, DpSlave):
            self._im = {slot: before.im_of(slot) for slot in self._im}
        self.device = self._new_device()
        kept, self._address_fixed = self.app.kept_address
        self._address = self._address if kept is None else kept
        if self._own is None and (drives := self._drives) is not None and drives_before is not None:
            drives.inherit(cast("Any", drives_before))  # of the same class
            own = drives.own_address
            self._address = self._address if own is None else own
        if self.encoder is not None and encoder_before is not None:
            self.encoder.inherit(encoder_before)
        if self.process_device is not None and process_before is not None:
            self.process_device.inherit(process_before)
        if self._own is None and isinstance(before, IoStation) and isinstance(self.device, IoStation):
            self.device.inherit(before)
        self._create_station(params)

    def _create_station(self, params: BusParams) -> None:
        own = set_rate(self.config)
        if own is not None and own != params.baud:
            params = BusParams.preset(own)
        if (drives := self._drives) is not None:
            drives.installed(self._address, None if self._searching else params.baud)
        self.app = SlaveApp(self.device, address=self._address, address_fixed=self._address_fixed)
        self.station = PassiveStation(self._address, self.app, params, t_sdr=self._t_sdr, patience=self._patience)
        device = self.device
        self.faults.attach(self.station, self.app, lambda: device.states if isinstance(device, IoStation) else ())
        #: the station, or the baud search around it
        self.on_bus: BusStation = self.station
        if self._searching and own is None:
            self.on_bus = SearchingSlave(self.station, self.app, rates=rates_of(self.config))


class Bench(ABC):
    """Simulated slaves that commands silence and switch off and on.

    A slave is known by the address of its configuration, also when it has another one in the meantime (a parameter,
    Set_Slave_Add). Methods with ``address`` mean that one and do not check it; those with ``which`` find a slave as
    :meth:`address_of` does.
    """

    #: True if the keys ``simulate`` of the slaves are carried out
    is_fed: bool = False
    #: simulated S7-200 CPUs by address
    cpus: Mapping[int, SimulatedPlantCpu] = MappingProxyType({})

    @property
    @abstractmethod
    def units(self) -> Mapping[int, SimulatedSlave]:
        """The slaves by the addresses of their configuration."""

    @property
    @abstractmethod
    def now(self) -> int:
        """The time of the line in ns."""

    @abstractmethod
    def call_at(self, at_ns: int, callback: Callable[[], None]) -> None:
        """Call ``callback`` at ``at_ns``, at once if that time is over; never after the end of the slaves."""

    @abstractmethod
    def _silence(self, address: int, for_ns: int | None) -> None: ...

    @abstractmethod
    def _resume(self, address: int) -> None: ...

    @abstractmethod
    def _silent_ns(self, address: int) -> int | None:
        """The rest of a silence in ns; None without a silence."""

    @abstractmethod
    def _switch(self, address: int, on: bool) -> None: ...

    @property
    def unfed(self) -> list[str]:
        """One line for each slave whose key ``simulate`` has no effect in this program."""
        if self.is_fed:
            return []
        units = [unit for unit in self.units.values() if unit.config.simulate is not None]
        return [
            f"{unit.who}: its key simulate has an effect in `dpstack run` and `dpstack sim` only; here its inputs are "
            "its outputs (a program sets them by dpstack.simulate(...).set())"
            for unit in units
        ]

    def names(self) -> dict[int, str]:
        """Address and name of every slave."""
        return {address: unit.config.name for address, unit in self.units.items()}

    def find(self, which: object) -> int | None:
        """A slave by its name, by its present address, or by that of its configuration. None: there is no such one."""
        wanted, units = str(which), self.units
        for names in (
            {unit.name: address for address, unit in units.items()},
            {str(unit.address): address for address, unit in reversed([*units.items()])},  # the first answers
            {str(address): address for address in units},
        ):
            if wanted in names:
                return units[names[wanted]].config.address
        return next((address for address, cpu in self.cpus.items() if wanted in (cpu.name, str(address))), None)

    def address_of(self, which: str | int) -> int:
        """As :meth:`find`. Raises UsageError, which lists the slaves."""
        found = self.find(which)
        if found is not None:
            return found
        stations: Iterator[SimulatedSlave | SimulatedPlantCpu] = chain(self.units.values(), self.cpus.values())
        known = ", ".join(f"{one.name} ({one.address})" for one in stations) or "none"
        raise UsageError(f"no slave {which!r} is simulated here; there are: {known}")

    def station(self, address: int) -> SimulatedSlave | SimulatedPlantCpu:
        """The simulated slave or CPU at ``address``."""
        return self.cpus[address] if address in self.cpus else self.units[address]

    def unit(self, which: str | int) -> SimulatedSlave:
        """A simulated slave. Raises UsageError, also for a CPU."""
        address = self.address_of(which)
        if address in self.cpus:
            raise UsageError(f"{self.cpus[address].who} is no DP slave: it takes {', '.join(CPU_COMMANDS)}")
        return self.units[address]

    def device(self, address: int) -> Device:
        return self.units[address].device

    def drive(self, which: str | int, *, or_encoder: bool = False) -> tuple[int, DriveDevice | EncoderDevice]:
        """A simulated drive, by the name or address of its slave, or by its own name; and the address of that slave.
        ``or_encoder``: an encoder too. Raises UsageError."""
        from dpstack.profile import DriveDevice  # here, as a bus without drives needs nothing of them

        for address, unit in self.units.items():
            if unit.several is not None and str(which) in unit.several.drives:
                return address, unit.several.drives[str(which)]
        address = self.unit(which).config.address
        found, encoder = self.device(address), self.units[address].encoder
        if isinstance(found, DriveDevice):
            return address, found
        if encoder is not None and or_encoder:
            return address, encoder
        what = "the I/O station" if isinstance(found, IoStation) else "it mirrors its outputs"
        what = what if encoder is None else "an encoder"
        if self.units[address].process_device is not None:
            what = "a PROFIBUS PA device"
        if (several := self.units[address].several) is not None:
            what = f"it has several, name one of {', '.join(several.drives)}"
        raise UsageError(f"slave {address} ({found.name}) is no simulated drive: {what}")

    def process_device(self, which: str | int) -> PaDevice:
        """A simulated PROFIBUS PA device, by the name or address of its slave: its process, and its faults. Raises
        UsageError."""
        unit = self.unit(which)
        if (found := unit.process_device) is None:
            raise UsageError(f'{unit.who} is no simulated process device; one has device = "pa-pressure" for instance')
        found.model.advance(self.now)
        return found

    def silence(self, which: str | int, for_ns: int | None = None) -> None:
        """Silence a slave, by name or address: it neither receives nor sends for ``for_ns`` nanoseconds; None: until
        :meth:`resume`. Its watchdog runs. Nothing happens while it is off. Raises UsageError."""
        address = self.address_of(which)
        if (cpu := self.cpus.get(address)) is not None:
            cpu.silence(NEVER if for_ns is None else self.now + for_ns)
        elif self.units[address].powered:
            self._silence(address, for_ns)

    def resume(self, which: str | int) -> None:
        """End the silence of a slave. Raises UsageError."""
        address = self.address_of(which)
        if (cpu := self.cpus.get(address)) is not None:
            cpu.silence(0)
        elif self.units[address].powered:
            self._resume(address)

    def power(self, which: str | int, on: bool) -> None:
        """Switch a slave, by name or address, off or on; a drive keeps its EEPROM. Raises UsageError."""
        address = self.address_of(which)
        if (cpu := self.cpus.get(address)) is not None:
            cpu.power(on)
            return
        unit = self.units[address]
        if on is not unit.powered:
            self._switch(address, on)
            if not on:
                unit.switch_off(self.now)
            unit.powered = on

    def clock(self, address: int) -> PlantClock | None:
        """The clock of a simulated slave at this moment; None if it cannot follow a master (DP-V2)."""
        from dpstack.dpv1.slave.clock_receiver import ClockReceiver  # here, as few buses send the time

        services = self.units[address].app.services
        receiver = next((one for one in services if isinstance(one, ClockReceiver)), None)
        return None if receiver is None else receiver.plant_clock(self.now)

    def injected(self, address: int) -> list[str]:
        """The injected faults that act on the slave, or on the CPU, at this moment."""
        if (cpu := self.cpus.get(address)) is not None:
            left_ns = cpu.silent_ns(self.now)
            return ["power-off"] if not cpu.powered else [silence_text(left_ns)] if left_ns else []
        unit = self.units[address]
        left_ns = self._silent_ns(address) or 0
        found = ["power-off"] if not unit.powered else [silence_text(left_ns)] if left_ns > 0 else []
        found += [fault_text(fault) for fault in unit.faults.active]
        if (device := unit.drive or unit.several or unit.encoder or unit.process_device) is not None:
            found += device.injected
        elif isinstance(unit.device, IoStation):
            found += unit.device.injected
        return found

    def status_of(self, address: int) -> dict[str, object]:
        """Keys of ``status`` for a simulated slave: ``slots`` of an I/O station, ``set_inputs`` in hex, ``injected``
        faults, ``refused``: its state and the reason of its last refusal."""
        device, injected, held = self.device(address), self.injected(address), self.units[address].held_inputs
        slots: dict[str, object] = {"slots": device.as_dict()} if isinstance(device, IoStation) else {}
        if held is not None:
            slots["set_inputs"] = held.hex()
        refused = self.units[address].refused
        if refused is not None:
            slots["refused"] = refused
        return slots | ({"injected": injected} if injected else {})


class VirtualBench(Bench):
    """The simulated slaves of a bus, see :func:`dpstack.simulate`: the plant of a program without hardware.

    :meth:`set` gives the inputs that a master reads, :meth:`power` switches slaves off and on.
    """

    def __init__(self, world: World, params: BusParams | None) -> None:
        """``params``: the rate of the slaves; None: they detect it."""
        self._world = world
        self._params = params or BusParams.preset(BAUD_RATES[0])
        self._searching = params is None
        self._units: dict[int, SimulatedSlave] = {}
        self.cpus: dict[int, SimulatedPlantCpu] = {}
        self._silent: dict[int, int] = {}  # ends of the silences in ns
        self._cut: Counter[int] = Counter()  # number of times that a slave was silenced or switched off
        #: gets the events of the slaves that only the device side knows, such as an exception in a simulated drive
        self.on_events: Callable[[list[Event]], None] | None = None

    def __repr__(self) -> str:
        return f"<VirtualBench {', '.join(unit.config.name for unit in self._units.values()) or 'without slaves'}>"

    def set(self, which: str | int, **values: object) -> None:
        """Set named inputs of a slave (the key ``inputs`` of its table), all or none: ``bench.set("tank", level=60)``.

        They stay over :meth:`power`. Without it the inputs of a slave are its outputs, see :meth:`mirror`. Raises
        UsageError for a name that no slave or no input has, a value that does not fit, and a simulated drive.

        Of an S7-200 it sets values by their names, also those that only its program sets on a wire.
        """
        if (cpu := self.cpus.get(self.address_of(which))) is not None:
            cpu.set_values(values)
            return
        unit = self.unit(which)
        unit.check_settable()
        try:
            unit.set_inputs(unit.inputs_with(values))
        except ValueError as error:
            raise UsageError(f"{unit.who}: {error}") from None

    def mirror(self, which: str | int) -> None:
        """The inputs of a slave are its outputs again. Raises UsageError for an I/O station and a simulated drive."""
        self.unit(which).set_inputs(None)

    def outputs(self, which: str | int) -> dict[str, Value]:
        """The named outputs (the key ``outputs``) that act at the slave; zeros outside data exchange, and while it is
        off."""
        unit = self.unit(which)
        fields = unit.config.output_fields
        return fields.values(unit.app.outputs.ljust(fields.length, b"\x00"))

    def add(self, config: SlaveConfig, own: Device | None = None, *, t_sdr: int | None = None) -> None:
        """Add a slave; it replaces one with the same address in its configuration. A drive of this kind that has moved
        to this address is the one that is meant: it stays, with its memory. ``own``: the device of a test. ``t_sdr``:
        its T_SDR in bit times; None: min T_SDR."""
        address = config.address
        before = self._units.get(address)
        if before is not None and before.config.address != address:
            before = None  # it has moved, and is another one's device now
        if before is None and own is None:
            for key, unit in self._units.items():
                if unit.address == address and config.any_profile is unit.config.any_profile is not None:
                    self._resume(key)
                    unit.config = config
                    self._units[address] = unit  # steps of a scenario and faults may still mean the former address
                    return
        if before is not None and before.powered:
            self._world.remove(before.on_bus)
        self._silent.pop(address, None)
        unit = SimulatedSlave(config, self._params, searching=self._searching, own=own, t_sdr=t_sdr)
        self._units[config.address] = unit
        unit.faults.connect(partial(self._send_at, unit))
        self._connect(unit)

    def add_cpu(self, config: CpuConfig) -> None:
        """Add an S7-200."""
        from dpstack.api.slave_side.simulated_cpu import SimulatedPlantCpu  # here, as most plants have none

        cpu = self.cpus[config.address] = SimulatedPlantCpu(config, self._params)
        self._world.add(cpu.station, name=config.name, on_events=self._on_events)

    def _connect(self, unit: SimulatedSlave) -> None:
        self._world.add(unit.on_bus, name=unit.config.name, on_events=self._on_events)

    def _on_events(self, events: list[Event]) -> None:
        if self.on_events is not None:
            self.on_events(events)

    @property
    def units(self) -> Mapping[int, SimulatedSlave]:
        """The simulated slaves by address."""
        return self._units

    @property
    def now(self) -> int:
        """Virtual time in ns."""
        return self._world.now

    def call_at(self, at_ns: int, callback: Callable[[], None]) -> None:
        self._world.call_at(max(at_ns, self._world.now), callback)

    def _send_at(self, unit: SimulatedSlave, octets: bytes, at_ns: int) -> None:
        """Put octets of a faulty slave on the line, unless it was switched off or silenced since."""
        station, cut = unit.station, self._cut[unit.config.address]

        def send() -> None:
            if unit.station is station and self._cut[unit.config.address] == cut:
                self._world.inject(octets, baud=unit.station.baud, sender=unit.name)

        self.call_at(at_ns, send)

    def _silence(self, address: int, for_ns: int | None) -> None:
        unit = self._units[address]
        self._cut[address] += 1
        self._world.unplug(unit.on_bus)
        self._world.command(unit.on_bus, LineDown("off the line"))
        until = self._silent[address] = NEVER if for_ns is None else self._world.now + for_ns
        if for_ns is not None:
            self._world.call_at(until, lambda: self._end(address, until))

    def _resume(self, address: int) -> None:
        self._end(address, self._silent.get(address))

    def _switch(self, address: int, on: bool) -> None:
        unit = self._units[address]
        if on:
            unit.renew(self._params)
            self._connect(unit)
        else:
            self._cut[address] += 1
            self._world.remove(unit.on_bus)
            self._silent.pop(address, None)

    def _silent_ns(self, address: int) -> int | None:
        until = self._silent.get(address)
        return None if until is None else until - self._world.now

    def _end(self, address: int, until: int | None) -> None:
        """End the silence with the end ``until``, unless another one has replaced it."""
        if until is not None and self._silent.get(address) == until:
            del self._silent[address]
            self._world.plug(self._units[address].on_bus)
