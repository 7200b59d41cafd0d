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
from dpstack.dpv1.slave.record_requests import RecordRequest, TransportRequest
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

    def ask(self, ticket: RecordRequest) -> None:
        request = ticket.request
        slot = self._slots[request.slot - 1] if 0 < request.slot <= len(self._slots) else None
        if request.slot == 0 and request.index == STATE:
            _read_only(ticket, bytes(0 if slot is None else slot.state for slot in self._slots))
        elif request.slot == 0:
            self._head.ask(ticket)
        elif slot is None:
            ticket.refuse(Code.INVALID_SLOT)
        elif request.index == STATE:  # the head answers for a missing module
            _read_only(ticket, _state(slot))
        elif not slot.present:
            ticket.refuse(Code.MODULE_FAILURE)
        elif request.index == IM_INDEX:
            self._modules[slot.number].ask(ticket)
        elif request.index == PARAMETERS and slot.module.prm is not None:
            self._parameters(ticket, slot)
        else:
            ticket.refuse(Code.INVALID_INDEX)

    def keep(self, before: StationRecords) -> None:
        """Take over the I&M data that a master wrote before the station was switched off and on."""
        self._head = before._head

    def _parameters(self, ticket: RecordRequest, slot: Slot) -> None:
        request = ticket.request
        if not isinstance(request, WriteReq):
            ticket.answer(bytes((slot.prm,)))
        elif len(request.data) != 1:
            ticket.refuse(Code.WRITE_LENGTH_ERROR)
        elif self._set_prm(slot, request.data[0]) is not None:
            ticket.refuse(Code.INVALID_RANGE)
        else:
            ticket.answer()


def loop_back(ticket: TransportRequest) -> None:
    """Data_Transport: a test of the connection; at once."""
    request = ticket.request
    if (request.slot, request.index) == _LOOP:
        ticket.answer(request.data)
    else:
        ticket.refuse(Code.INVALID_INDEX if request.slot == _LOOP[0] else Code.INVALID_SLOT)


def _im0(order_id: str, number: int) -> Im0:
    return Im0(order_id=order_id, serial_number=f"{number:04}", hardware_revision=1, software_revision="V1.0.0")


def _state(slot: Slot) -> bytes:
    plugged = EMPTY if slot.plugged is None else slot.plugged.config
    return bytes((slot.state, slot.module.config, plugged, sum(1 << channel for channel in slot.faults)))


def _read_only(ticket: RecordRequest, octets: bytes) -> None:
    if isinstance(ticket.request, WriteReq):
        ticket.refuse(Code.ACCESS_DENIED)
    else:
        ticket.answer(octets)
