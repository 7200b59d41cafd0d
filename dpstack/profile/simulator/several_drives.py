"""The simulated slave with several drives: each has its part of inputs and outputs, and its object in record 47."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from msgspec import structs

from dpstack.dp.slave.device import Leave
from dpstack.dpv1.pdu.error_codes import Code
from dpstack.dpv1.pdu.read_write import PARAMETER_INDEX, WriteReq
from dpstack.dpv1.slave.device import Device
from dpstack.dpv1.slave.record_requests import RecordRequest
from dpstack.profile.simulator.device import DriveDevice

#: octet of a request in record 47 that has the drive object
_OBJECT: Final = 2


class SimulatedPart(NamedTuple):
    """A simulated drive, the identifier octets of its slots, and its octets as
    :class:`~dpstack.profile.master.several_drives.DrivePart` has them. ``record_object`` None: that of its profile."""

    device: DriveDevice
    config: bytes
    inputs: tuple[int, int]
    outputs: tuple[int, int]
    record_object: int | None = None


class SeveralDrivesDevice(Device):
    """``parts`` by the names of the drives; ``config``: the identifier octets of the slave, ``inputs``: octets of its
    inputs. The first drive answers for the slave as a whole: ident number, user parameters, station address."""

    def __init__(self, parts: Mapping[str, SimulatedPart], config: bytes, inputs: int) -> None:
        #: the simulated drives by name
        self.drives: Mapping[str, DriveDevice] = {name: part.device for name, part in parts.items()}
        self.configs = (config,)
        self._parts = tuple(parts.values())
        self._first = first = self._parts[0].device
        self._inputs = bytes(inputs)
        self.ident, self.name, self.fail_safe = first.ident, first.name, first.fail_safe
        self._asked: DriveDevice | None = None  # the drive that took the last request of record 47
        self._objects: dict[int, DriveDevice] = {}
        for part in self._parts:
            server = part.device.record47
            if server is None:
                continue
            objects = server.rules.objects if part.record_object is None else frozenset((part.record_object,))
            server.rules = structs.replace(server.rules, objects=objects)
            self._objects |= {number: part.device for number in objects if number not in self._objects}
        if self._objects:
            self.records = self

    def ask(self, request: RecordRequest) -> None:
        """Record 47 goes to the drive with the object of the request; a Read fetches what was asked last."""
        service = request.service
        if isinstance(service, WriteReq) and service.index == PARAMETER_INDEX and len(service.data) > _OBJECT:
            self._asked = self._objects.get(service.data[_OBJECT])
        device = self._asked or next(iter(self._objects.values()))
        if device.records is None:
            request.refuse(Code.INVALID_INDEX)
        else:
            device.records.ask(request)

    # -- Device -----------------------------------------------------------------------------------------------------

    def check_prm(self, user_prm: bytes) -> str | None:
        return self._first.check_prm(user_prm)

    def enter(self, config: bytes, now: int) -> None:
        self._asked = None
        for part in self._parts:
            part.device.enter(part.config, now)

    def exchange(self, outputs: bytes, now: int) -> bytes:
        inputs = bytearray(self._inputs)
        for part in self._parts:
            inputs[slice(*part.inputs)] = part.device.exchange(outputs[slice(*part.outputs)], now)
        if inputs != self._inputs:
            self._inputs = bytes(inputs)
        return self._inputs

    def clear(self, now: int) -> None:
        for device in self.drives.values():
            device.clear(now)

    def leave(self, reason: Leave, now: int) -> None:
        for device in self.drives.values():
            device.leave(reason, now)

    # -- as a simulated drive ---------------------------------------------------------------------------------------

    def advance(self, now: int) -> None:
        """Do every scan up to ``now``."""
        for device in self.drives.values():
            device.advance(now)

    @property
    def injected(self) -> tuple[str, ...]:
        """Faults from outside, the name of the drive in front."""
        return tuple(f"{name} {text}" for name, device in self.drives.items() for text in device.injected)

    def inherit(self, before: SeveralDrivesDevice) -> None:
        """Take over the EEPROMs of the drives before power-off."""
        for name, device in self.drives.items():
            device.inherit(before.drives[name])

    def installed(self, address: int, baud: int | None) -> None:
        self._first.installed(address, baud)

    @property
    def own_address(self) -> int | None:
        """The station address of the first drive's own setting."""
        return self._first.own_address

    def switch_off(self, now: int) -> None:
        for device in self.drives.values():
            device.switch_off(now)

    def called(self, names: Sequence[str]) -> DriveDevice | None:
        """The drive that one of ``names`` means."""
        return next((self.drives[name] for name in names if name in self.drives), None)
