"""The records of the I/O station: parameters and state of a module, I&M of every slot.

| slot | index | |
|---|---|---|
| 0 (the head) | 2 | the state of every slot, an octet each: 0 ok, 1 channel fault, 2 wrong module, 3 no module |
| 1 .. | 1 | the parameter octet of the module; written, it counts until the next Set_Prm |
| 1 .. | 2 | its state, the identifier octet configured, the one that is plugged (0: none), a bit for each broken wire |
| all | 255 | I&M0; at the head also I&M1 to 4, which can be written |

Masters of both classes can read them: MS1 in data exchange, class 2 connections at any time. Data_Transport, of class 2
only, is a loop back at slot 0, index 0: the octets sent come back.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from dpstack.dpv1.pdu.error_codes import Code
from dpstack.dpv1.pdu.im import IM_INDEX, Im0, Im1, Im2, Im3, Im4
from dpstack.dpv1.pdu.read_write import WriteReq
from dpstack.dpv1.slave.record_requests import RecordRequest
from dpstack.dpv1.slave.record_table import ImRecords
from dpstack.sim.io_station.modules import EMPTY, Slot

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


def _read_only(request: RecordRequest, octets: bytes) -> None:
    if isinstance(request.service, WriteReq):
        request.refuse(Code.ACCESS_DENIED)
    else:
        request.answer(octets)
