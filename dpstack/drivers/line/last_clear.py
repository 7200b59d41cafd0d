"""Clear without the protocol machine, sent by a driver whose machine cannot; and whether this master is alone."""

from __future__ import annotations

import select
import time
from time import monotonic_ns
from typing import Final

from msgspec import structs

from dpstack.dp.master.commands import Mode
from dpstack.dp.master.events import MasterStopped, ModeChanged
from dpstack.dp.pdu.requests import GlobalControl
from dpstack.drivers.runtime import last_bits_ns
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.codec import request_octets
from dpstack.fdl.decoder import Decoder
from dpstack.fdl.telegram import FC_REQUEST, SAP_GLOBAL_CONTROL, SSAP_MS0, Kind, Req
from dpstack.params import BROADCAST
from dpstack.ports import Port
from dpstack.trace import Event
from dpstack.units import NS_PER_MS, NS_PER_S

#: Number of listening periods on a line with octets of others.
_LISTENS: Final = 3
#: A slave that misses the first one gets the second one.
_TIMES: Final = 2


class LastClear:
    """Sends Clear twice for ``station``: its machine has failed, or has lost its token although it is alone.

    Its octets exist from the beginning: the machine may have failed because there is no memory.
    """

    def __init__(self, station: ActiveStation) -> None:
        self._station = station
        self._operated = False  # slaves have live outputs
        data = GlobalControl(clear=True).build()
        fc = Req.SDN_HIGH | FC_REQUEST
        self._octets = request_octets(BROADCAST, station.address, fc, data, SAP_GLOBAL_CONTROL, SSAP_MS0)
        #: both telegrams were sent
        self.was_sent = False
        #: why they could not be sent, or need not
        self.why_not = "no slave has live outputs"

    def completed(self, event: Event, port: Port) -> Event:
        """``event`` of the machine. A master that stopped without Clear has sent it afterwards, if ``port`` can."""
        match event:
            case ModeChanged(mode=mode) if mode is not Mode.OFFLINE:
                self._operated = mode is Mode.OPERATE
            case MasterStopped(cleared=False):
                self.send(port)
                return structs.replace(event, cleared=self.was_sent)
        return event

    def send(self, port: Port) -> None:
        """Send on the open ``port``. Blocks for T_TO and the time of two telegrams."""
        if not self._operated:
            return
        self.why_not = why_not_alone(port, self._station)
        if self.why_not:
            return
        for _ in range(_TIMES):
            if not port.write(self._octets):
                self.why_not = "the line takes no more octets"
                return
            time.sleep(last_bits_ns(self._station.params) / NS_PER_S)
        self.was_sent = True


def why_not_alone(port: Port, station: ActiveStation) -> str:
    """Why ``station`` may not send without asking for the token; empty if it is alone in the ring and nobody else
    sends. Listens for T_TO."""
    others = sorted(station.las - {station.address})
    if not station.in_ring:
        return "this master is not in the token ring"
    if others:
        masters = f"master{'s' if len(others) > 1 else ''} {', '.join(map(str, others))}"
        return f"{masters} may hold the token by now, and without the token nothing may be sent"
    if port.fd is None:
        return "a port of this kind needs the event loop"
    if not _nobody_else_sends(port, station):
        return "somebody else sends on the bus, and without the token nothing may be sent"
    return ""


def _nobody_else_sends(port: Port, station: ActiveStation) -> bool:
    """Whether in a time of T_TO only answers to this station, or its own telegrams, are on the line."""
    assert port.fd is not None
    decoder = Decoder(stall_ns=NS_PER_S)
    patience_ns = station.params.ns(station.params.t_to)
    line = select.poll()
    line.register(port.fd, select.POLLIN)
    for _ in range(_LISTENS):
        end = monotonic_ns() + patience_ns
        octets = b""
        while (left := end - monotonic_ns()) > 0 and not octets:
            line.poll(left / NS_PER_MS)  # up to the next millisecond
            octets = port.read_now()
        if not octets:
            return True
        for telegram in decoder.feed(octets, monotonic_ns()):
            own = telegram.sa == station.address
            if not own and (telegram.kind == Kind.SD4 or telegram.is_request):
                return False
    return False
