"""FDL services for programs: own SAPs under any requests, the answers of Ident and LSAP status, orders in words.

The first octet chooses. Judged at the SAPs: an answer is a readable telegram from this station to the requester, with
its SAPs crosswise; SDN has none; a repetition gets the same octets and no second indication; a SAP that is not open,
or not for this station, answers RS; no more indications wait than the queue has room for; texts are printable.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from dpstack.api.fdl.orders import SERVICES, FdlOrder, parse_fdl_order
from dpstack.errors import PduError, UsageError
from dpstack.fdl.codec import decode
from dpstack.fdl.services.confirmations import FdlService
from dpstack.fdl.services.identity import MAX_IDENT, Ident, SapStatus
from dpstack.fdl.services.orders import CloseSap, FdlIndicated, OpenSap, TakenIndications, UpdateReply
from dpstack.fdl.services.saps import SapTable
from dpstack.fdl.telegram import COUNTED, FC_FCB, FC_FCV, FC_FUNCTION, Kind, Resp, Telegram
from dpstack.params import BROADCAST
from tests.fuzz.frame import Cutter, Target, assert_plain, parsed

OWN: Final = 2
SAPS: Final = (None, 0, 20, 47, 62)
SOURCES: Final = (1, 7, 126)
_SERVICES: Final = (FdlService.SDA, FdlService.SDN, FdlService.SRD)
#: SDA, SDN, SRD low and high, MSRD, Ident, LSAP status, and a function that does not exist
_FUNCTIONS: Final = (3, 5, 4, 6, 12, 13, 7, 14, 15, 1)


def run(octets: bytes) -> None:
    """The first octet chooses the part."""
    if octets:
        _PARTS[octets[0] % len(_PARTS)](octets[1:])


def _ident(octets: bytes) -> None:
    found = parsed(Ident.parse, octets, PduError)
    if found is not None:
        assert_plain(found.text)
        if 4 + sum(octets[:4]) <= MAX_IDENT:
            assert Ident.parse(found.build()) == found
    status = SapStatus.parse(octets)
    assert status.octets == octets
    assert len(status.services) in (0, 4)


def _words(octets: bytes) -> None:
    script = Cutter(octets)
    service, address = SERVICES[script.octet() % len(SERVICES)], script.octet() & 127
    dsap, ssap = (None if (sap := script.octet()) & 0x80 else sap & 63 for _ in range(2))
    high, data = bool(script.octet() & 1), script.take(script.octet())
    try:
        order = FdlOrder(service, address, data, dsap, ssap, high)
    except UsageError as error:
        assert_plain(str(error))
    else:
        assert parse_fdl_order(order.words) == order
    text = script.rest().decode("latin-1")
    parsed(lambda _: parse_fdl_order([service, str(address), *text.split(" ")]), b"", UsageError)


class Course:
    """The SAPs of station 2, and what the others and the program do."""

    def __init__(self, octets: bytes) -> None:
        self.script = Cutter(octets)
        self.events: list[Any] = []
        self.table = SapTable(OWN, self.events, Ident("a", "b"))
        self.open: dict[int | None, OpenSap] = {}
        self.waiting: dict[int | None, int] = {}
        #: the last request that counts, and its answer
        self.last: tuple[Telegram, bytes | None] | None = None

    def program(self) -> None:
        script = self.script
        head = script.octet()
        number = SAPS[(head >> 4) % len(SAPS)]
        order: OpenSap | CloseSap | UpdateReply | TakenIndications
        match head & 3:
            case 0:
                more = script.octet()
                services = tuple(one for bit, one in enumerate(_SERVICES) if more >> bit & 1) or _SERVICES
                access = SOURCES[more >> 3 & 1] if more & 0x80 else None
                order = OpenSap(number, services, access, 20 if more & 0x40 else None, 1 + (more >> 4 & 3))
            case 1:
                order = CloseSap(number)
            case 2:
                size = script.octet()
                data = None if size > 250 else script.take(size).ljust(size, b"\0")
                order = UpdateReply(number, data, bool(head & 4), bool(head & 8))
            case _:
                order = TakenIndications(number, script.octet() & 3)
        try:
            self.table.command(order)
        except UsageError as error:
            assert_plain(str(error))
            return
        match order:
            case OpenSap():
                self.open[number], self.waiting[number] = order, 0
            case CloseSap():
                self.open.pop(number, None)
            case TakenIndications() if number in self.open:
                self.waiting[number] = max(0, self.waiting[number] - order.count)

    def request(self) -> None:
        script = self.script
        head = script.octet()
        function = _FUNCTIONS[head % len(_FUNCTIONS)]
        source, more = SOURCES[(head >> 4) % 3], script.octet()
        dsap, ssap = SAPS[more % len(SAPS)], (None, 20, 8, None)[more >> 4 & 3]
        dsap = 63 if more == 255 and function in (4, 6) else dsap
        data = script.take(script.octet() % 32)
        fcb = (0, 0x10, 0x30, 0x20)[script.octet() & 3]
        da = BROADCAST if function in (4, 6) and head & 0x80 else OWN
        kind = Kind.SD2 if data or dsap is not None or ssap is not None else Kind.SD1
        self.ask(Telegram(kind, da, source, 0x40 | fcb | function, dsap, ssap, data))

    def ask(self, request: Telegram) -> None:
        function = request.fc & FC_FUNCTION
        before = len(self.events)
        if function in (4, 6):
            self.table.indicate(request, 1)
            if request.da == OWN:
                self.last = None
            self.told(before)
            return
        octets = self.table.answer(request, 1)
        if self.last is not None:
            first, answer = self.last
            is_counted = function in set(map(int, COUNTED))
            if request.sa == first.sa and is_counted and request.fc & FC_FCV and not (request.fc ^ first.fc) & FC_FCB:
                assert octets == answer
                assert len(self.events) == before, "a second indication of a repetition"
                return
        self.last = None
        if request.fc & (FC_FCB | FC_FCV) and function in set(map(int, COUNTED)):
            self.last = request, octets
        self.judge(request, octets)
        self.told(before)

    def judge(self, request: Telegram, octets: bytes | None) -> None:
        """The answer to a request that is no repetition."""
        assert octets is not None
        answer = decode(octets)
        assert answer is not None, octets.hex()
        function = request.fc & FC_FUNCTION
        sap = self.open.get(request.dsap)
        if answer.kind is Kind.SC:
            assert function in (3, 5)
        else:
            assert (answer.da, answer.sa) == (request.sa, OWN)
            if answer.kind is Kind.SD2 and function != 14:
                assert (answer.dsap, answer.ssap) == (request.ssap, request.dsap)
        service = {3: 0, 5: 0, 12: 2, 13: 2}.get(function)
        admits = (
            service is not None
            and sap is not None
            and _SERVICES[service] in sap.services
            and sap.access in (None, request.sa)
            and sap.access_sap in (None, request.ssap)
        )
        refused = answer.kind is not Kind.SC and answer.fc & FC_FUNCTION == Resp.RS
        assert refused is (not admits and function != 14), (request, octets.hex())

    def told(self, before: int) -> None:
        """Indications are for open SAPs, and no more wait than fit."""
        for event in self.events[before:]:
            assert isinstance(event, FdlIndicated)
            assert_plain(event.text)
            self.waiting[event.sap] += 1
            assert self.waiting[event.sap] <= self.open[event.sap].queue
        del self.events[:]

    def run(self) -> None:
        while self.script.at < len(self.script.octets):
            if self.script.octet() & 3:
                self.request()
            else:
                self.program()


_PARTS: Final[tuple[Callable[[bytes], None], ...]] = (
    _ident,
    _words,
    lambda octets: Course(octets).run(),
    lambda octets: Course(octets).run(),
)


def repair(octets: bytes) -> bytes:
    """Give the answer of Ident lengths that fit."""
    if len(octets) < 6 or octets[0] % len(_PARTS):
        return octets
    left, out = len(octets) - 5, bytearray(octets)
    for at in range(1, 5):
        out[at] = min(out[at], left)
        left -= out[at]
    return bytes(out)


TARGET = Target(
    run, covers=("dpstack.fdl.services", "dpstack.api.fdl.orders"), executions=200_000, max_len=260, repair=repair
)
