"""Orders of ``dpstack fdl``, one FDL service by hand: words, parser, execution, answers in JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from msgspec import Struct

from dpstack.api.fdl.fdl import Fdl
from dpstack.errors import UsageError
from dpstack.params import BROADCAST
from dpstack.text import decimal, octets_text, shortened

#: services that carry data
SENDING: Final = ("sda", "sdn", "srd", "msrd")
SERVICES: Final = (*SENDING, "status", "ident", "lsap")
LAST_SAP: Final = 63
#: the address of all stations
ALL: Final = BROADCAST
_HIGH: Final = "high=on"
_LISTED: Final = ("SDA", "SDN", "SRD", "CSRD")


class FdlOrder(Struct, frozen=True):
    """One service: ``address`` 0..127 (127: all), ``dsap`` and ``ssap`` 0..63 or None for the default SAP.

    Raises UsageError if they do not fit the service.
    """

    service: str
    address: int
    data: bytes = b""
    dsap: int | None = None
    ssap: int | None = None
    high: bool = False

    def __post_init__(self) -> None:
        sends = self.service in SENDING
        if self.data and not sends:
            raise UsageError(f"{self.service} sends no data: leave {self.data.hex()} out")
        if self.service == "lsap" and self.dsap is None:
            raise UsageError("lsap asks for one SAP of the station: give it with --dsap")
        if not sends and (self.ssap is not None or (self.dsap is not None and self.service != "lsap")):
            raise UsageError(f"{self.service} goes to no SAP: leave --dsap and --ssap out")

    @property
    def words(self) -> tuple[str, ...]:
        """The order for the control socket."""
        found = [self.service, str(self.address), *([self.data.hex()] if self.data else ())]
        found += [f"{name}={sap}" for name, sap in (("dsap", self.dsap), ("ssap", self.ssap)) if sap is not None]
        return (*found, *([_HIGH] if self.high else ()))

    def as_dict(self) -> dict[str, object]:
        """The request as the JSON line has it."""
        return {"service": self.service, "address": self.address, "dsap": self.dsap, "ssap": self.ssap}


def parse_fdl_order(words: Sequence[str]) -> FdlOrder:
    """The order in :attr:`FdlOrder.words`. Raises UsageError."""
    service, address, *more = words
    if service not in SERVICES:
        raise UsageError(f"{shortened(service)!r} is no service; there are: {', '.join(SERVICES)}")
    station = _number(address, ALL, "station address: 0..126, or 127 for all")
    data, saps, high = b"", dict[str, int](), False
    for word in more:
        name, equals, value = word.partition("=")
        if not equals:
            data = _octets(word)
        elif name in ("dsap", "ssap"):
            saps[name] = _number(value, LAST_SAP, f"SAP: 0..{LAST_SAP}")
        elif word == _HIGH:
            high = True
        else:
            raise UsageError(f"{shortened(word)!r}: write dsap=20, ssap=20 or {_HIGH}")
    return FdlOrder(service, station, data, saps.get("dsap"), saps.get("ssap"), high)


def _number(text: str, last: int, what: str) -> int:
    number = decimal(text)
    if number is None or number > last:
        raise UsageError(f"{shortened(text)!r} is no {what}")
    return number


def _octets(text: str) -> bytes:
    try:
        return bytes.fromhex(text)
    except ValueError:
        raise UsageError(f"{shortened(text)!r} is no hex: write 01FF") from None


async def carry_out(fdl: Fdl, order: FdlOrder) -> dict[str, object]:
    """The outcome for JSON, with its line for people as ``text``. Raises FdlError unless it is positive."""
    to = "all stations" if order.address == ALL else f"station {order.address}"
    name = order.service.upper()
    at = to if order.dsap is None else f"{to}, SAP {order.dsap}"
    match order.service:
        case "sda":
            await fdl.sda(order.address, order.data, dsap=order.dsap, ssap=order.ssap, high=order.high)
            return {"status": "OK", "text": f"{name} to {at}: OK, {octets_text(len(order.data))} taken"}
        case "sdn":
            await fdl.sdn(order.address, order.data, dsap=order.dsap, ssap=order.ssap, high=order.high)
            text = f"{name} to {at}: {octets_text(len(order.data))} sent, without acknowledgement"
            return {"status": "OK", "text": text}
        case "srd" | "msrd":
            if order.service == "srd":
                answer = await fdl.srd(order.address, order.data, dsap=order.dsap, ssap=order.ssap, high=order.high)
            else:
                answer = await fdl.msrd(order.address, order.data, dsap=order.dsap, ssap=order.ssap)
            octets = f": {answer.data.hex(' ').upper()}" if answer.data else ""
            text = f"{name} to {at}: {answer.status.value}, {answer.status.text}{octets}"
            return {"status": answer.status.value, "data": answer.data.hex(), "text": text}
        case "status":
            kind = await fdl.fdl_status(order.address)
            return {"status": "OK", "type": kind.name.lower(), "text": f"{to}: {kind.text}"}
        case "ident":
            ident = await fdl.ident(order.address)
            texts = {
                "vendor": ident.vendor,
                "controller": ident.controller,
                "hardware": ident.hardware,
                "software": ident.software,
            }
            return {"status": "OK", **texts, "text": f"{to}: {ident.text}"}
        case _:
            found = await fdl.lsap_status(order.address, order.dsap)
            roles = ", ".join(f"{service} {role}" for service, role in zip(_LISTED, found.services, strict=False))
            access = "all stations" if found.access is None else f"station {found.access} only"
            what = f"{roles}; access by {access}" if roles else "a status of unknown layout"
            octets = found.octets.hex(" ").upper()
            return {"status": "OK", "data": found.octets.hex(), "text": f"{name} of {at}: {what} ({octets})"}
