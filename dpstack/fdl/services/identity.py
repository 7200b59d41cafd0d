"""The answers of Request Ident and Request LSAP Status: octets and values.

Layouts and what is not confirmed about them: docs/reference/fdl-services.md#ident and #lsap-status.
"""

from __future__ import annotations

from typing import Final

from msgspec import Struct, structs

from dpstack.errors import PduError, UsageError
from dpstack.text import printable

_LENGTHS: Final = 4
#: octets of the four lengths and of the four texts: a data unit of 246, less the two SAPs that it does not have
MAX_IDENT: Final = 200


class Ident(Struct, frozen=True):
    """Identity of a station (Ident_List): four texts, as the station sends them (Latin-1)."""

    #: name of the vendor
    vendor: str = ""
    #: type of the PROFIBUS interface
    controller: str = ""
    #: version of the hardware
    hardware: str = ""
    #: version of the software
    software: str = ""

    @property
    def text(self) -> str:
        """The four texts in one line, printable."""
        vendor, controller, hardware, software = map(printable, structs.astuple(self))
        return f"vendor '{vendor}', controller '{controller}', hardware '{hardware}', software '{software}'"

    @classmethod
    def parse(cls, octets: bytes) -> Ident:
        """The four texts of the answer: four lengths, then the texts one after the other.

        Octets behind the last text are ignored. Raises PduError if the lengths do not fit.
        """
        if len(octets) < _LENGTHS:
            raise PduError(f"Ident: {len(octets)} octets; the four lengths alone take {_LENGTHS}")
        lengths = octets[:_LENGTHS]
        if _LENGTHS + sum(lengths) > len(octets):
            named = ", ".join(map(str, lengths))
            raise PduError(f"Ident: octets 1 to 4 say lengths {named}, and {len(octets) - _LENGTHS} octets follow")
        at, texts = _LENGTHS, []
        for length in lengths:
            texts.append(octets[at : at + length].decode("latin-1"))
            at += length
        return cls(*texts)

    def build(self) -> bytes:
        """The octets of the answer. Raises UsageError for characters beyond Latin-1 and for more than 200 octets."""
        try:
            texts = [text.encode("latin-1") for text in (self.vendor, self.controller, self.hardware, self.software)]
        except UnicodeEncodeError as error:
            raise UsageError(f"ident: {error.object[error.start : error.end]!r} is no Latin-1 character") from None
        octets = bytes(min(len(text), 255) for text in texts) + b"".join(texts)
        if len(octets) > MAX_IDENT:
            raise UsageError(f"ident: the four texts take {len(octets) - _LENGTHS} octets, {MAX_IDENT - _LENGTHS} fit")
        return octets


class SapStatus(Struct, frozen=True):
    """The configuration of a SAP as a station reports it. ``octets``: the whole answer.

    ``access``: the only station that may use it; None: all stations. ``services``: the role of the SAP for SDA, SDN,
    SRD and CSRD in this order, "initiator", "responder", "both" or "none"; empty if the answer cannot be read.
    """

    octets: bytes
    access: int | None = None
    services: tuple[str, ...] = ()

    @classmethod
    def parse(cls, octets: bytes) -> SapStatus:
        """The status of the answer: Access, Addr_extension, then a role and a service in each of up to four octets.

        The coding is not confirmed by a page that was read, so anything unknown leaves ``services`` empty.
        """
        if not 3 <= len(octets) <= 6:
            return cls(octets)
        roles: dict[int, str] = {}
        for octet in octets[2:]:
            role = _ROLES.get(octet >> 4)
            if role is None:
                return cls(octets)
            roles[octet & 0x0F] = role
        named = tuple(roles.get(service, "none") for service in _SAP_SERVICES)
        access = octets[0] & 0x7F
        return cls(octets, None if access == 0x7F else access, named)


_ROLES: Final = {0: "initiator", 1: "responder", 2: "both", 3: "none"}
_SAP_SERVICES: Final = (0, 1, 3, 5)
