"""The simulated I/O station: a head and up to eight modules. Each event from outside is a method.

It reports: identifier related diagnosis for every slot with a fault, channel related diagnosis for every broken wire
(modules count from 0 there, slots from 1); a module status whenever a slot's state changes, and when data exchange
begins with a fault; and these alarms, if the master enabled them:

| alarm | when | specifier | data |
|---|---|---|---|
| diagnosis | a wire breaks or is whole again | appears, disappears, disappears with others left | channel, error (6) |
| process | edges of digital inputs, as parameters say | none | edges, then the inputs |
| pull | a module is pulled | appears | the identifier octet it had |
| plug | the right module is plugged, a wrong one | disappears, disappears with others left | its identifier octet |
| update | parameters are changed at the device | none | the parameter octet |

An alarm that cannot be sent (not enabled, not in data exchange, too many) is left out: the diagnosis has its content,
and the method returns the reason.

The records of the I/O station: parameters and state of a module, I&M of every slot.

| slot | index | |
|---|---|---|
| 0 (the head) | 2 | the state of every slot, an octet each: 0 ok, 1 channel fault, 2 wrong module, 3 no module |
| 1 .. | 1 | the parameter octet of the module; written, it counts until the next Set_Prm |
| 1 .. | 2 | its state, the identifier octet configured, the one that is plugged (0: none), a bit for each broken wire |
| all | 255 | I&M0; at the head also I&M1 to 4, which can be written |
| of HART | 80 .., 131 .., 148, 149 | requests, parameters, directory, features (:mod:`dpstack.hart.module`) |

Masters of both classes can read them: MS1 in data exchange, class 2 connections at any time. Data_Transport, of class 2
only, is a loop back at slot 0, index 0: the octets sent come back.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Final

from dpstack.argcheck import octets, whole_number
from dpstack.dp.pdu.alarm_blocks import Alarm, AlarmType, ModuleState, Specifier, module_status
from dpstack.dp.pdu.diag_blocks import UserDiag, channel_block, identifier_block
from dpstack.dpv1.pdu.error_codes import Code
from dpstack.dpv1.pdu.im import IM_INDEX, Im0, Im1, Im2, Im3, Im4
from dpstack.dpv1.pdu.read_write import WriteReq
from dpstack.dpv1.slave.description import SlaveDescription
from dpstack.dpv1.slave.record_requests import RecordRequest
from dpstack.dpv1.slave.record_table import ImRecords
from dpstack.dpv1.slave.user_slave import DpSlave
from dpstack.errors import AlarmError, ConfigError
from dpstack.gsd.identifiers import io_lengths
from dpstack.params import DPV1_STATUS_LEN
from dpstack.sim.io_station import IDENT
from dpstack.sim.io_station.modules import EMPTY, MODULES, Slot, edges, module_named
from dpstack.text import brief

if TYPE_CHECKING:
    from dpstack.hart.module import HartModule

PARAMETERS: Final = 1
STATE: Final = 2
#: slot and index of the loop back
_LOOP: Final = (0, 0)


class StationRecords:
    """``slots`` in their order; ``set_prm`` sets a written parameter octet. Every request is answered at once."""

    def __init__(self, slots: Sequence[Slot | None], set_prm: Callable[[Slot, int], str | None]) -> None:
        self._slots = slots
        self._set_prm = set_prm
        self._head = ImRecords([_im0("IO-STATION", 0), Im1(), Im2(), Im3(), Im4()])
        self._modules = {
            slot.number: ImRecords([_im0(slot.module.name, slot.number)]) for slot in slots if slot is not None
        }

    def ask(self, request: RecordRequest) -> None:
        service = request.service
        slot = self._slots[service.slot - 1] if 0 < service.slot <= len(self._slots) else None
        if service.slot == 0 and service.index == STATE:
            _read_only(request, bytes(0 if slot is None else slot.state for slot in self._slots))
        elif service.slot == 0:
            self._head.ask(request)
        elif slot is None:
            request.refuse(Code.INVALID_SLOT)
        elif service.index == STATE:  # the head answers for a missing module
            _read_only(request, _state(slot))
        elif not slot.present:
            request.refuse(Code.MODULE_FAILURE)
        elif service.index == IM_INDEX:
            self._modules[slot.number].ask(request)
        elif service.index == PARAMETERS and slot.module.prm is not None:
            self._parameters(request, slot)
        elif slot.hart is not None and slot.hart.has(service.index):
            _hart(request, slot.hart)
        else:
            request.refuse(Code.INVALID_INDEX)

    def keep(self, before: StationRecords) -> None:
        """Take over the I&M data that a master wrote before the station was switched off and on."""
        self._head = before._head

    def _parameters(self, request: RecordRequest, slot: Slot) -> None:
        service = request.service
        if not isinstance(service, WriteReq):
            request.answer(bytes((slot.prm,)))
        elif len(service.data) != 1:
            request.refuse(Code.WRITE_LENGTH_ERROR)
        elif self._set_prm(slot, service.data[0]) is not None:
            request.refuse(Code.INVALID_RANGE)
        else:
            request.answer()


def loop_back(request: RecordRequest) -> None:
    """Data_Transport: a test of the connection; at once."""
    service = request.service
    if (service.slot, service.index) == _LOOP:
        request.answer(service.data)
    else:
        request.refuse(Code.INVALID_INDEX if service.slot == _LOOP[0] else Code.INVALID_SLOT)


def _im0(order_id: str, number: int) -> Im0:
    return Im0(order_id=order_id, serial_number=f"{number:04}", hardware_revision=1, software_revision="V1.0.0")


def _state(slot: Slot) -> bytes:
    plugged = EMPTY if slot.plugged is None else slot.plugged.config
    return bytes((slot.state, slot.module.config, plugged, sum(1 << channel for channel in slot.faults)))


def _hart(request: RecordRequest, module: HartModule) -> None:
    service = request.service
    if isinstance(service, WriteReq):
        refusal = module.write(service.index, service.data, request.at)
        request.answer() if refusal is None else request.refuse(refusal)
        return
    found = module.read(service.index, request.at)
    request.answer(found) if isinstance(found, bytes) else request.refuse(found)


def _read_only(request: RecordRequest, octets: bytes) -> None:
    if isinstance(request.service, WriteReq):
        request.refuse(Code.ACCESS_DENIED)
    else:
        request.answer(octets)


MAX_MODULES: Final = 8
ALARMS: Final = ("pull_plug", "process", "diagnostic", "update")
SEQUENCE: Final = 8
MAX_DIAG: Final = 64
#: class 2 connections, and octets of an Initiate
CONNECTIONS: Final = 2
MAX_INITIATE: Final = 52
#: of channel related diagnosis
_LINE_BREAK: Final = 6


class IoStation(DpSlave):
    """A station with ``config`` plugged: an identifier octet a slot, 0 for an empty one. Raises ConfigError.

    ``description``: the content of its GSD file, None: of dpstack's own file. Wrong arguments of its methods raise
    ValueError; they return the reason why an alarm was left out, or None.
    """

    def __init__(self, config: bytes, description: SlaveDescription | None = None, *, name: str = "io-station") -> None:
        config = octets(f"I/O station {name}: config", config, ConfigError)
        unknown = [octet for octet in config if octet not in MODULES and octet != EMPTY]
        if unknown or not 1 <= len(config) <= MAX_MODULES or not any(config):
            what = f"identifier octet {unknown[0]:02X}" if unknown else f"{len(config)} slots"
            raise ConfigError(
                f"I/O station {name}: {what}; it has 1 to {MAX_MODULES} slots, with the modules of its GSD file"
            )
        #: the slots in their order; None for one that is configured to be empty
        self.slots: tuple[Slot | None, ...] = tuple(
            None if octet == EMPTY else Slot(number, MODULES[octet]) for number, octet in enumerate(config, 1)
        )
        self._configured = tuple(place for place in self.slots if place is not None)
        self._with_parameters = tuple(place for place in self._configured if place.module.prm is not None)
        self._all_well = (ModuleState.OK,) * len(self.slots)
        self._states = self._all_well  # of the last module status
        self._entered = False
        self._prm = self._defaults = bytes(slot.prm for slot in self._with_parameters)
        super().__init__(description or _described(config, name, len(self._prm)), self._cycle, config=config)
        self._station_records = StationRecords(self.slots, self._change_parameter)
        self.records = self._station_records
        self.transport = loop_back
        self._seal(IoStation)

    @classmethod
    def of(cls, modules: Sequence[str], name: str = "io-station") -> IoStation:
        """A station with these modules plugged, by name from slot 1 on, "" for an empty slot. Raises ConfigError."""
        if isinstance(modules, (str, bytes)) or not isinstance(modules, Iterable):
            raise ConfigError(f'I/O station {name}: modules = {brief(modules)} is no list: write ["8 DI", "8 DO"]')
        try:
            config = bytes(module_named(module).config if module else EMPTY for module in modules)
        except ValueError as error:
            raise ConfigError(f"I/O station {name}: {error}") from None
        return cls(config, name=name)

    def table(self, address: int) -> dict[str, object]:
        """Its [[slave]] table with its modules and all its alarms, as ``open_bus(slaves=[...])`` takes it."""
        modules = ["" if slot is None else slot.module.name for slot in self.slots]
        return {
            "name": self.name,
            "address": address,
            "gsd": "io-station",
            "modules": modules,
            "dpv1": {"alarms": list(ALARMS), "alarm_mode": 0},
        }

    def as_dict(self) -> dict[str, object]:
        """Its slots by number as JSON shows them; an empty one is left out."""
        return {str(place.number): place.as_dict() for place in self._configured}

    # --- events from outside ----------------------------------------------------------------------------------------

    @property
    def injected(self) -> tuple[str, ...]:
        """Its faults from outside that are not over, written as the commands of ``dpstack ctl``."""
        found = []
        for place in self._configured:
            if place.plugged is None:
                found.append(f"pull {place.number}")
            elif not place.present:
                found.append(f'plug {place.number} "{place.plugged.name}"')
            found += [f"wire-break {place.number} {channel} on" for channel in sorted(place.broken)]
            if place.hart is not None:
                found += [f"hart {place.number} {channel} {text}" for channel, text in place.hart.faults.items()]
        return tuple(found)

    def set_input(self, slot: int, inputs: bytes) -> str | None:
        """Change all inputs of a module, octets as the master reads them."""
        place = self._slot(slot)
        inputs = octets("inputs", inputs, ValueError)
        if not place.module.inputs or len(inputs) != place.module.inputs:
            raise ValueError(f"{place.text} has {place.module.inputs} octets of inputs, {len(inputs)} were given")
        before, place.process = place.inputs, inputs
        if not place.module.analogue_inputs and place.present:
            changed = edges(before, place.inputs, place.prm)
            if any(changed):
                return self._alarm(AlarmType.PROCESS, place, Specifier.NONE, changed + place.inputs)
        return None

    @property
    def process_inputs(self) -> bytes:
        """The inputs of the process at all modules, in slot order, whether modules and wires are there or not."""
        return b"".join(place.process for place in self._configured)

    def set_inputs(self, inputs: bytes) -> str | None:
        """Change the inputs of all modules, octets in slot order; those of a module that stay the same change nothing.

        Returns the first reason why an alarm was left out.
        """
        length = len(self.process_inputs)
        if len(inputs) != length:
            raise ValueError(f"{self.name} has {length} octets of inputs, {len(inputs)} were given")
        left_out = None
        at = 0
        for place in self._configured:
            part = inputs[at : at + place.module.inputs]
            at += place.module.inputs
            if part != place.process:
                left_out = self.set_input(place.number, part) or left_out
        return left_out

    def wire_break(self, slot: int, channel: int, broken: bool) -> str | None:
        """Break the wire of an analogue input channel, 0 or 1, or repair it."""
        place = self._slot(slot)
        if (
            not place.module.analogue_inputs
            or not 0 <= whole_number("channel", channel, ValueError) < place.module.channels
        ):
            raise ValueError(f"{place.text} has no analogue input channel {channel}; channels count from 0")
        before = place.faults
        place.broken = place.broken | {channel} if broken else place.broken - {channel}
        return self._diagnosed(place, before)

    def hart_fault(self, slot: int, channel: int, fault: str, value: float | None = None) -> None:
        """A fault of a HART channel (:mod:`dpstack.hart.module`); ``value``: how many requests, or seconds of "slow".
        ``well`` ends it."""
        self._hart(slot).set_fault(whole_number("channel", channel, ValueError), fault, value)

    def hart_status(self, slot: int, channel: int, status: int) -> None:
        """The device status octet of the transmitter at a HART channel; 0x80 also sets "electronic defect" of command
        48."""
        whole_number("device status", status, ValueError)
        self._hart(slot).set_status(whole_number("channel", channel, ValueError), status)

    def _hart(self, slot: int) -> HartModule:
        place = self._slot(slot)
        if place.hart is None:
            raise ValueError(f'{place.text} has no HART channels; the module "2 AI HART" has some')
        return place.hart

    def set_parameter(self, slot: int, octet: int) -> str | None:
        """Change the parameters of a module at the device itself: an update alarm."""
        place = self._slot(slot)
        reason = self._change_parameter(place, octet)
        if reason is not None:
            raise ValueError(reason)
        return self._alarm(AlarmType.UPDATE, place, Specifier.NONE, bytes((octet,)))

    def pull(self, slot: int) -> str | None:
        """Take the module out: its inputs are zero, its outputs off."""
        place = self._slot(slot)
        if place.plugged is None:
            raise ValueError(f"{place.text}: no module is plugged")
        was, place.plugged = place.plugged, None
        self._report()
        return self._alarm(AlarmType.PULL, place, Specifier.APPEARS, bytes((was.config,)))

    def plug(self, slot: int, module: str = "") -> str | None:
        """Put in the configured module, or ``module`` by name. It gets the parameters of Set_Prm."""
        place = self._slot(slot)
        if place.plugged is not None:
            raise ValueError(f"{place.text}: a module is plugged; pull it first")
        place.plugged = module_named(module) if module else place.module
        self._parameterise()
        self._report()
        well = place.present and not place.faults
        how = Specifier.DISAPPEARS if well else Specifier.DISAPPEARS_OTHERS
        return self._alarm(AlarmType.PLUG, place, how, bytes((place.plugged.config,)))

    def inherit(self, before: IoStation) -> None:
        """Take over modules, process and I&M of ``before``, the same station before it was switched off and on."""
        self._station_records.keep(before._station_records)
        for place, was in zip(self.slots, before.slots, strict=True):
            if place is not None and was is not None:
                place.inherit(was)
        self._report()

    # --- Device ---------------------------------------------------------------------------------------------------

    def check_prm(self, user_prm: bytes) -> str | None:
        """DPV1_Status, then an octet for each module that has parameters."""
        reason = super().check_prm(user_prm)
        octets = user_prm[DPV1_STATUS_LEN:]
        places = self._with_parameters
        if reason is None and octets and len(octets) != len(places):
            reason = f"{len(octets)} octets of module parameters, {len(places)} are expected"
        if reason is None:
            reasons = (_unknown_bits(place, octet) for place, octet in zip(places, octets, strict=False))
            reason = next((found for found in reasons if found), None)
        if reason is None:
            self._prm = octets or self._defaults
        return reason

    def enter(self, config: bytes, now: int) -> None:
        """The parameters of Set_Prm are valid from here on."""
        super().enter(config, now)
        self._parameterise()
        self._states = self._all_well
        self._entered = True

    # --- inside ---------------------------------------------------------------------------------------------------

    def _cycle(self, outputs: bytes, elapsed: int) -> bytes:
        if self._entered:  # before, no status message can be sent
            self._entered = False
            self._report()
        inputs = b""
        at = 0
        for place in self._configured:
            size = place.module.outputs
            if size:
                place.outputs = outputs[at : at + size] if place.present else bytes(size)
                at += size
            inputs += place.inputs
        return inputs

    def _slot(self, number: int) -> Slot:
        place = self.slots[number - 1] if 1 <= whole_number("slot", number, ValueError) <= len(self.slots) else None
        if place is None:
            known = ", ".join(place.text for place in self._configured)
            raise ValueError(f"there is no module in slot {number}; there are: {known}")
        return place

    def _parameterise(self) -> None:
        for place, octet in zip(self._with_parameters, self._prm, strict=True):
            place.prm = octet

    def _change_parameter(self, place: Slot, octet: int) -> str | None:
        """Change the parameters at the device or by a record; returns why that is not possible, or None."""
        reason = _unknown_bits(place, octet)
        if reason is None:
            before, place.prm = place.faults, octet
            self._diagnosed(place, before)
        return reason

    def _diagnosed(self, place: Slot, before: frozenset[int]) -> str | None:
        """Report the faults of a module that came or went since ``before``."""
        after = place.faults
        if after == before:
            return None
        self._report()
        left_out = None
        for channel in sorted(before - after):
            how = Specifier.DISAPPEARS_OTHERS if after else Specifier.DISAPPEARS
            left_out = self._alarm(AlarmType.DIAGNOSIS, place, how, bytes((channel, _LINE_BREAK)))
        for channel in sorted(after - before):
            left_out = self._alarm(AlarmType.DIAGNOSIS, place, Specifier.APPEARS, bytes((channel, _LINE_BREAK)))
        return left_out

    @property
    def states(self) -> tuple[ModuleState, ...]:
        """The states of its modules, slot 1 first."""
        return tuple(ModuleState.OK if place is None else place.state for place in self.slots)

    def _report(self) -> None:
        """Update the diagnosis, and send the module status if it has changed."""
        states = self.states
        faulty = [number for number, state in enumerate(states) if state]
        broken = [
            channel_block(place.number - 1, channel, _LINE_BREAK, size=place.module.size, input=True)
            for place in self._configured
            for channel in sorted(place.faults)
        ]
        self.diag = UserDiag.of(identifier_block(faulty, len(states)), *broken) if faulty else UserDiag()
        if states != self._states and self.alarm_server is not None:
            self._states = states
            with contextlib.suppress(AlarmError):
                self.alarm_server.status(module_status(states))

    def _alarm(self, kind: AlarmType, place: Slot, how: Specifier, data: bytes) -> str | None:
        """Raise one; why it was left out, or None."""
        if self.alarm_server is None:
            return f"{self.name}: its description has no dpv1"
        try:
            self.alarm_server.alarm(Alarm(kind, place.number, how, data=data))
        except AlarmError as error:
            return str(error)
        return None


def _described(config: bytes, name: str, parameters: int) -> SlaveDescription:
    """As its GSD file has it."""
    io_lengths(config)
    return SlaveDescription(
        ident=IDENT,
        name=name,
        configs=(config,),
        max_modules=MAX_MODULES,
        max_input_len=32,
        max_output_len=32,
        max_data_len=64,
        user_prm_len=(DPV1_STATUS_LEN + parameters, DPV1_STATUS_LEN + parameters),
        fail_safe=True,
        wd_base_1ms=True,
        dpv1=True,
        prm_blocks=False,
        alarms=ALARMS,
        alarm_sequence=SEQUENCE,
        max_diag_len=MAX_DIAG,
        ms2=CONNECTIONS,
        ms2_max_initiate=MAX_INITIATE,
    )


def _unknown_bits(place: Slot, octet: int) -> str | None:
    whole_number("parameter octet", octet, ValueError)
    if place.module.prm is None:
        return f"{place.text} has no parameters"
    if octet & ~place.module.mask:
        return f"parameters {octet:02X} of {place.text}: bits {octet & ~place.module.mask:02X} have no meaning"
    return None
