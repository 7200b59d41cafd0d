"""Kit for record 47: a drive of literal octets, and a bus that knows only octets between both ends."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from dpstack.dpv1.master.plugin_queue import Outcome, ServiceFailure
from dpstack.dpv1.pdu.read_write import ReadReq, WriteReq
from dpstack.profile.record47.parameter_server import ParameterServer
from dpstack.profile.record47.pdu import Answer, Pause, Refused, Service, Silent, Transport

T = TypeVar("T")
MS = 1_000_000
BUSY = Refused(0xB5)
#: the manual's request for parameter 965, written to record 47, and its response
READ_965 = "5F 01 2F 0A 01 01 01 01 10 00 03 C5 00 00"
IS_965 = "01 01 01 01 06 01 03 28"


def octets(text: str) -> bytes:
    return bytes.fromhex(text)


def outcome(answer: str | Refused | ServiceFailure) -> Outcome:
    """The outcome of a service: octets, a negative answer, or no answer (with the failure's name as text)."""
    match answer:
        case str():
            return Outcome(data=octets(answer))
        case Refused(code, why):
            codes = (0x80, code, 0) if code else None
            return Outcome(ServiceFailure.NEGATIVE if code else ServiceFailure.REFUSED, why, codes=codes)
        case failure:
            return Outcome(failure, f"slave 6 {failure.value}")


class Script:
    """A drive that answers the services in order as the test says; ``said``: the requests."""

    def __init__(self, *answers: str | Refused | Silent) -> None:
        self._answers = list(answers)
        self.said: list[str] = []
        self.now = 0
        self.service_ns = MS

    def __call__(self, service: Service) -> Answer:
        if isinstance(service, Pause):
            self.said.append(f"pause {service.ns // MS} ms")
            self.now += service.ns
            return Answer(self.now)
        self.now += self.service_ns
        if isinstance(service, WriteReq):
            self.said.append(f"5F {service.slot:02X} {service.index:02X} {len(service.data):02X} " + _hex(service.data))
        else:
            self.said.append(f"5E {service.slot:02X} {service.index:02X} {service.length:02X}")
        if not self._answers:
            raise AssertionError(f"nobody expects {self.said[-1]}")
        answer = self._answers.pop(0)
        return Answer(self.now, octets(answer) if isinstance(answer, str) else answer)


class Wire:
    """Both ends joined: ``server`` answers; ``service_ns`` a service. ``seen`` are the services in octets."""

    def __init__(self, server: ParameterServer, service_ns: int = MS) -> None:
        self.server = server
        self.now = 0
        self.service_ns = service_ns
        self.longest = 0

    def __call__(self, service: Service) -> Answer:
        if isinstance(service, Pause):
            self.now += service.ns
            return Answer(self.now)
        self.now += self.service_ns
        if isinstance(service, WriteReq):
            self.longest = max(self.longest, len(service.data))
            refused = self.server.write_record(service.slot, service.index, service.data, self.now)
            return Answer(self.now, b"" if refused is None else refused)
        data = self.server.read_record(service.slot, service.index, service.length, self.now)
        if isinstance(data, bytes):
            self.longest = max(self.longest, len(data))
        return Answer(self.now, data)


def talk(talk: Transport[T], far_end: Callable[[Service], Answer]) -> T:
    """Have a talk to its end."""
    try:
        service = next(talk)
        while True:
            service = talk.send(far_end(service))
    except StopIteration as end:
        result: T = end.value
        return result


def _hex(data: bytes) -> str:
    return data.hex(" ").upper()


def hexes(parts: Sequence[bytes]) -> list[str]:
    return [_hex(part) for part in parts]


__all__ = ["BUSY", "IS_965", "MS", "READ_965", "ReadReq", "Script", "Wire", "hexes", "octets", "outcome", "talk"]
