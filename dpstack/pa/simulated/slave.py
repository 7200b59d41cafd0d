"""The simulated process device as a DP slave: MS1, MS2, cyclic data, DIAGNOSIS in its Slave_Diag.

Options that the sources leave open: docs/reference/decisions/pa.md#simulated-devices.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple, cast

from dpstack.dp.pdu.alarm_blocks import PHYSICAL_BLOCK, Specifier, Status
from dpstack.dp.pdu.diag_blocks import NO_DIAG, UserDiag
from dpstack.dp.pdu.dpv1_status import PRM_STRUCTURE
from dpstack.dp.pdu.prm_blocks import parse_blocks
from dpstack.dp.slave.device import Leave
from dpstack.dpv1.pdu.error_codes import Code
from dpstack.dpv1.pdu.im import Im0
from dpstack.dpv1.pdu.read_write import ReadReq, WriteReq
from dpstack.dpv1.slave.device import Device
from dpstack.dpv1.slave.record_requests import RecordRequest
from dpstack.dpv1.slave.record_table import ImRecords
from dpstack.errors import PduError, RecordRefused
from dpstack.pa.datatypes import datatype
from dpstack.pa.simulated import faults
from dpstack.pa.simulated.block import AUTO, OUT_OF_SERVICE, Block
from dpstack.pa.simulated.device import MAINTENANCE, ProcessDevice
from dpstack.pa.simulated.physical import WARM_START
from dpstack.params import DPV1_STATUS_LEN
from dpstack.units import NEVER, NS_PER_MS, NS_PER_S

#: structured parameter of Set_Prm: the coding of status and diagnosis; its first octet has bit 0 PRM_COND
PRM_PA: Final = 65
_PRM_COND: Final = 0x01
#: the device computes its blocks so often at most, as one of a PA segment does
CYCLE_NS: Final = 20 * NS_PER_MS
#: time that it takes for a block at least
_BLOCK_NS: Final = NS_PER_MS
#: connections of class 2
CONNECTIONS: Final = 4
#: DIAGNOSIS that sets Ext_Diag: the classic failures, the condensed maintenance alarm
_FAULTS: Final = bytes((0xFF, 0x07, 0x01, 0))
#: the address of a device that nobody has given one
_DEFAULT_ADDRESS: Final = 126


class CyclicPart(NamedTuple):
    """A part of the cyclic data: a parameter of a block, or ``octets`` that no block has (both names are empty)."""

    block: str
    parameter: str
    octets: int


class Cyclic(NamedTuple):
    """What a configuration carries in Data_Exchange, in the order of the octets."""

    inputs: Sequence[CyclicPart]
    outputs: Sequence[CyclicPart]


class ProcessSlave(Device):
    """A :class:`~dpstack.pa.simulated.device.ProcessDevice` on the bus.

    ``cyclic``: by the identifier octets of a configuration; the first is the default. Its faults are methods; what
    stands is in :attr:`injected`. Its parameters survive a power cycle (:meth:`inherit`).
    """

    def __init__(
        self,
        model: ProcessDevice,
        cyclic: Mapping[bytes, Cyclic],
        *,
        ident: int,
        name: str,
        profile_ident: int | None = None,
    ) -> None:
        self.model = model
        self.name, self.ident = name, ident
        self.configs = tuple(cyclic)
        self._by_config = cyclic
        #: the cyclic data of the configuration in use
        self.cyclic = cyclic[self.configs[0]]
        self.ms2 = CONNECTIONS
        self._idents = (ident if profile_ident is None else profile_ident, ident)
        #: seconds that each answer to a Read or Write takes
        self.delay = 0.0
        self._waiting: list[tuple[int, RecordRequest]] = []
        self._ordered: bool | None = None
        self._inputs = b""
        self._outputs = b""
        self._next = 0
        self._is_cyclic = False
        self._shown = b""
        self._user_diag = NO_DIAG
        self._put: set[str] = set()
        self.records = ImRecords([self._im0()], self)

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name}>"

    def _im0(self) -> Im0:
        pb = self.model.physical
        texts = (str(pb.get(name)) for name in ("device_id", "device_ser_num"))
        order, serial = ("".join(c if c.isascii() and c.isprintable() else "?" for c in text) for text in texts)
        return Im0(manufacturer_id=pb.whole("device_man_id"), order_id=order, serial_number=serial, profile_id=0x9700)

    # -- from outside --------------------------------------------------------------------------------------------------

    def set_process(self, value: float, name: str = "") -> None:
        """Set a value of the process, the first one unless ``name`` says another. Raises ValueError."""
        known = self.model.process
        name = name or next(iter(known))
        if name not in known:
            raise ValueError(f"{name!r} is no process value of this device; it has {', '.join(known)}")
        if not math.isfinite(value):
            raise ValueError(f"{value} is no number that a process can have")
        known[name] = float(value)
        self._changed()

    def order_fail_safe(self, on: bool) -> None:
        """Order the fail-safe of the device: its inputs act by FSAFE_TYPE, a valve goes where it is without supply."""
        self.model.fails_safe = on
        self._changed()

    def simulate(self, value: float | None, status: int | None = None, block: str = "") -> None:
        """Switch SIMULATE of a block on with ``value`` and ``status`` (None: simulated), or off (None).

        ``block``: the first one that has it unless named. Raises ValueError.
        """
        able = [one for one in self.model.functions if "simulate" in one.parameters]
        found = next((one for one in able if block.upper() in ("", one.name)), None)
        if found is None:
            raise ValueError(
                f"{block or 'it'} has no SIMULATE; there are: {', '.join(one.name for one in able) or 'none'}"
            )
        if value is not None and not math.isfinite(value):
            raise ValueError(f"{value} is no number that a block can have")
        is_discrete = found.parameters["simulate"].kind == "simulate_d"
        if is_discrete and value is not None and value not in range(256):
            raise ValueError(f"{found.name} is discrete: give a whole number of 0..255")
        wanted = faults.SIMULATED[self.model.condensed] if status is None else status
        number = int(value or 0) if is_discrete else float(value or 0)
        found.put("simulate", {"status": wanted, "value": number, "enabled": int(value is not None)})
        found.revise()
        self._changed()

    def maintenance(self, degree: str) -> None:
        """``required``, ``demanded`` or ``alarm``; ``off`` ends it. Raises ValueError."""
        if degree not in (*MAINTENANCE, "off"):
            raise ValueError(f"maintenance is {', '.join(MAINTENANCE)} or off, not {degree!r}")
        self.model.active -= set(MAINTENANCE.values())
        if degree != "off":
            self.model.active.add(MAINTENANCE[degree])
        self._changed()

    def sensor_failure(self, on: bool) -> None:
        """Break the sensor, or make it whole."""
        self._switch(faults.SENSOR, on)

    def function_check(self, on: bool) -> None:
        """Somebody works at the device."""
        self._switch(faults.CHECK, on)

    def out_of_service(self, on: bool) -> None:
        """Put the function blocks out of service, or into AUTO."""
        for block in self.model.functions:
            block.put("target_mode", OUT_OF_SERVICE if on else AUTO)
        self._mark("out-of-service on", on)

    def local_operation(self, on: bool) -> None:
        """Somebody operates the device on site: a valve stays where it is."""
        self.model.is_local = on
        self._mark("local-operation on", on)

    def block_valve(self, on: bool) -> None:
        """Jam the valve. Raises ValueError for a device without one."""
        valves = [one for one in self.model.transducers if hasattr(one, "blocked")]
        if not valves:
            raise ValueError("it has no valve")
        for valve in valves:
            valve.blocked = on
        self._mark("jam on", on)

    def write_protect(self, on: bool) -> None:
        """Set the switch for write protection at the device."""
        self.model.physical.put("hw_write_protection", 2 if on else 0)
        self._mark("write-protect on", on)

    def answer_after(self, seconds: float) -> None:
        """Answer each Read and Write so much later, in seconds of 0..60. Raises ValueError."""
        if not 0 <= seconds <= 60:
            raise ValueError(f"{seconds} s is outside 0..60 s")
        self.delay = seconds

    def _switch(self, key: str, on: bool) -> None:
        (self.model.active.add if on else self.model.active.discard)(key)
        self._changed()

    def _mark(self, text: str, on: bool) -> None:
        (self._put.add if on else self._put.discard)(text)
        self._changed()

    def _changed(self) -> None:
        self.model.settle()
        self._next = 0

    @property
    def injected(self) -> tuple[str, ...]:
        """Faults and conditions from outside, written as the commands of ``dpstack ctl``."""
        model, found = self.model, sorted(self._put)
        degrees = {key: f"maintenance {word}" for word, key in MAINTENANCE.items()}
        found += sorted(degrees.get(key, f"{key} on") for key in model.active)
        if model.fails_safe:
            found.append("fail-safe on")
        for block in model.functions:
            if block.is_simulated:
                found.append(f"simulate {block.part('simulate', 'value'):g} ({block.name})")
        return (*found, f"slow {self.delay:g}") if self.delay else tuple(found)

    def inherit(self, before: ProcessSlave) -> None:
        """Take over blocks and process of the same device before it was switched off and on."""
        self.model, self._put, self.delay = before.model, before._put, before.delay
        self.model.physical.show_start(WARM_START)
        self._changed()

    # -- Device --------------------------------------------------------------------------------------------------------

    def check_prm(self, user_prm: bytes) -> str | None:
        """Keep what PRM_COND orders; a damaged structure is refused."""
        self._ordered = None
        if len(user_prm) < DPV1_STATUS_LEN or not user_prm[2] & PRM_STRUCTURE:
            return None
        try:
            blocks = parse_blocks(user_prm[DPV1_STATUS_LEN:], 11)
        except PduError as error:
            return str(error)
        for block in blocks:
            if block.type == PRM_PA and block.data:
                self._ordered = bool(block.data[0] & _PRM_COND)
        return None

    def cyclic_of(self, config: bytes) -> Cyclic:
        """The cyclic data of a configuration that was accepted."""
        return self._by_config[config]

    def enter(self, config: bytes, now: int) -> None:
        self.model.advance(now)
        self.cyclic = self.cyclic_of(config)
        self.model.order_coding(self._ordered)
        self._is_cyclic = True
        self._outputs, self._next = b"", 0
        self._judge_ident()

    def exchange(self, outputs: bytes, now: int) -> bytes:
        model = self.model
        if outputs != self._outputs:
            model.advance(now)
            self._outputs = outputs
            self._take(outputs)
            model.settle()
            self._next = 0
        if now >= self._next:
            model.advance(now)
            self._inputs = self._give()
            self._next = now + max(CYCLE_NS, len(model.blocks) * _BLOCK_NS)
        return self._inputs

    def clear(self, now: int) -> None:
        self._void(now)

    def leave(self, reason: Leave, now: int) -> None:
        self._is_cyclic = False
        self._void(now)
        self._judge_ident()

    def user_diag(self) -> UserDiag:
        """DIAGNOSIS as a status of the physical block; once nothing stands any more, that it disappeared."""
        data = self.model.physical.diagnosis
        if data != self._shown:
            is_new = any(new & ~old for new, old in zip(data, self._shown.ljust(len(data), b"\0"), strict=False))
            self._shown = data
            self._user_diag = self._status(data, Specifier.APPEARS if is_new else Specifier.DISAPPEARS)
        return self._user_diag

    def tick(self, now: int) -> int | None:
        self.due_at = NEVER
        due = [request for at, request in self._waiting if at <= now]
        self._waiting = [(at, request) for at, request in self._waiting if at > now and request.open]
        for request in due:
            self._answer(request, now)
        self.due_at = min((at for at, _ in self._waiting), default=self.due_at)
        if not self.model.address_reset:
            return None
        self.model.address_reset = False
        return _DEFAULT_ADDRESS

    # -- records -------------------------------------------------------------------------------------------------------

    def ask(self, request: RecordRequest) -> None:
        """Answer a Read or Write, at once or after :attr:`delay`."""
        if not self.delay:
            self._answer(request, request.at)
            return
        at = request.at + round(self.delay * NS_PER_S)
        self._waiting.append((at, request))
        self.due_at = min(self.due_at, at)

    def _answer(self, request: RecordRequest, now: int) -> None:
        service = request.service
        try:
            if isinstance(service, ReadReq):
                request.answer(self.model.read(service.slot, service.index, now))
            elif isinstance(service, WriteReq):
                self.model.write(service.slot, service.index, service.data, now)
                request.answer()
                self._written(now)
            else:
                request.refuse(Code.FEATURE_NOT_SUPPORTED)
        except RecordRefused as refused:
            request.fail(refused)

    def _written(self, now: int) -> None:
        self._next = 0
        self._judge_ident()
        if self.model.address_reset:
            self.due_at = now

    def _judge_ident(self) -> None:
        """The ident number that IDENT_NUMBER_SELECTOR wants comes into force outside data exchange."""
        wanted = {0: self._idents[0], 1: self._idents[1]}.get(self.model.physical.whole("ident_number_selector"))
        if wanted is not None and not self._is_cyclic:
            self.ident = wanted
        self.model.physical.has_other_ident = wanted is not None and wanted != self.ident
        self.model.settle()

    # -- cyclic data ---------------------------------------------------------------------------------------------------

    def _give(self) -> bytes:
        """The inputs: the octets of the parameters."""
        return b"".join(
            self.model.block(part.block).octets_of(part.parameter) if part.block else self.foreign_input(place, part)
            for place, part in enumerate(self.cyclic.inputs)
        )

    def foreign_input(self, place: int, part: CyclicPart) -> bytes:
        """The octets of an input that no block has; ``place``: its place among the inputs."""
        return bytes(part.octets)

    def _take(self, outputs: bytes) -> None:
        at = 0
        for part in self.cyclic.outputs:
            if part.block:
                _take_one(self.model.block(part.block), part.parameter, outputs[at : at + part.octets])
            at += part.octets

    def _void(self, now: int) -> None:
        """No set point is valid any more."""
        self.model.advance(now)
        self._outputs, self._next = b"", 0
        for part in self.cyclic.outputs:
            block = self.model.block(part.block) if part.block else None
            if block is not None and block.parameters[part.parameter].kind in ("value", "value_d"):
                value = cast("Mapping[str, float]", block.get(part.parameter))
                block.put(part.parameter, {**value, "status": 0})
        self.model.settle()

    def _status(self, data: bytes, specifier: Specifier) -> UserDiag:
        octets = data or bytes(4)
        fault = any(one & mask for one, mask in zip(octets, _FAULTS, strict=False))
        built = Status(PHYSICAL_BLOCK, self.model.physical.slot, specifier, octets).build()
        return UserDiag(built, fault)


def _take_one(block: Block, name: str, octets: bytes) -> None:
    """Take an output; a set point that is no number is one with a bad status, a control octet without a meaning is
    nothing."""
    if len(octets) < datatype(block.parameters[name].kind).length:
        return
    kind = block.parameters[name].kind
    if kind in ("value", "value_d"):
        before = block.octets_of(name)
        block.put_octets(name, octets)
        if kind == "value" and not math.isfinite(block.part(name, "value")):
            block.put_octets(name, before[:4] + b"\0")
        return
    try:
        block.check(name, octets[0])
    except RecordRefused:
        return
    block.put_octets(name, octets)
