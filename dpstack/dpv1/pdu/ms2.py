"""The PDUs that open, keep and end a class 2 connection (MS2): Resource_Manager, Initiate, Idle, Abort.

Layouts and reasons: docs/reference/protocol.md#ms2, docs/reference/protocol.md#initiate,
docs/reference/protocol.md#idle, docs/reference/protocol.md#abort. Times are in ns; on the wire they count 10 ms.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import Any, Final, Self

from msgspec import Struct

from dpstack.dp.pdu.layouts import MAX_RECORD, OCTET, REST, WORD, Layout, Pdu, adapted, bits, fixed, ignored
from dpstack.dpv1.pdu.read_write import Function
from dpstack.errors import PduError
from dpstack.units import NS_PER_MS, ns_to_s

#: the server SAPs that the resource manager gives out, from the highest down
SERVER_SAPS: Final = range(49)
#: one count of a send time-out on the wire
TIMEOUT_UNIT: Final = 10 * NS_PER_MS
#: Features_Supported_1 and 2: Read and Write
FEATURES: Final = 0x0100
#: the head of a service, before the data of a record
HEAD: Final = 4
#: Initiate without network addresses
LEAST_INITIATE: Final = 20
_MAX_WORD: Final = 0xFFFF
_ADDRESS: Final = 2
_NET_ADDRESS: Final = 8


class Address(Struct, frozen=True):
    """One end of a connection: Application Process Instance and Access Level; ``net``: 6 octets of network address and
    the MAC address, if the end is not on this bus (address type 1), else empty (type 0)."""

    api: int = 0
    scl: int = 0
    net: bytes = b""

    @property
    def kind(self) -> int:
        """S_Type or D_Type."""
        return int(bool(self.net))

    def build(self) -> bytes:
        """The octets, without type and length. Raises PduError if a value is no octet."""
        try:
            return bytes((self.api, self.scl)) + self.net
        except ValueError:
            raise PduError(f"Initiate: api = {self.api} and scl = {self.scl} are octets: give 0..255") from None


class ResourceManagerRes(Pdu, frozen=True):
    """The resource manager's answer to Initiate: go on at ``server_sap``, which has ``send_timeout_ns`` at least."""

    server_sap: int
    send_timeout_ns: int


def _server_sap(sap: int) -> int:
    if sap not in SERVER_SAPS:
        raise PduError(f"Resource_Manager: octet 2: {sap} is no server SAP (0..{SERVER_SAPS[-1]})")
    return sap


def _counts(timeout_ns: int) -> int:
    """Rounded up: never shorter than what was meant."""
    counts = -(-timeout_ns // TIMEOUT_UNIT)
    if timeout_ns < 0 or counts > _MAX_WORD:
        longest = ns_to_s(_MAX_WORD * TIMEOUT_UNIT)
        raise PduError(f"a send time-out of {ns_to_s(timeout_ns):g} s is not possible: 0..{longest:g} s")
    return counts


_SEND_TIMEOUT: Final = "send_timeout_ns" / adapted(WORD, lambda counts: counts * TIMEOUT_UNIT, _counts) * "send_timeout"
ResourceManagerRes.LAYOUT = Layout(
    "Resource_Manager",
    ResourceManagerRes,
    "server_sap" / adapted(OCTET, _server_sap, _server_sap),
    _SEND_TIMEOUT,
    function=Function.RESOURCE_MANAGER,
)


class Initiate(Pdu, frozen=True, kw_only=True):
    """The common part of both Initiate PDUs: ``features``, ``profile_features``: two octets each."""

    #: Features_Supported, two octets
    features: int = FEATURES
    #: Profile_Features_Supported, two octets
    profile_features: int = 0
    #: Profile_Ident_Number, 0 for none
    profile_ident: int = 0
    #: address of the end that sends it
    source: Address = Address()
    #: address of the other end
    destination: Address = Address()

    def build(self) -> bytes:
        """The octets: a request has at least 20, a response 16. Raises PduError if a value does not fit."""
        source, destination = self.source.build(), self.destination.build()
        return self.LAYOUT.build(
            self,
            s_type=self.source.kind,
            s_len=len(source),
            d_type=self.destination.kind,
            d_len=len(destination),
            addresses=source + destination,
        )

    @classmethod
    def _read(cls, s_type: int, s_len: int, d_type: int, d_len: int, addresses: bytes, **fields: Any) -> Self:
        if s_len + d_len != len(addresses):
            announced = f"{s_len} and {d_len} octets of addresses are announced"
            raise PduError(f"Initiate: {announced}, {len(addresses)} came")
        source = _address("S_Addr", s_type, addresses[:s_len])
        return cls(source=source, destination=_address("D_Addr", d_type, addresses[s_len:]), **fields)


_COMMON: Final = (
    "features" / WORD,
    "profile_features" / WORD,
    "profile_ident" / WORD,
    "s_type" / OCTET,
    "s_len" / OCTET,
    "d_type" / OCTET,
    "d_len" / OCTET,
    "addresses" / REST,
)


class InitiateReq(Initiate, frozen=True):
    """Open a connection."""

    #: longest silence of either end that the master wants, in ns
    send_timeout_ns: int


class InitiateRes(Initiate, frozen=True):
    """The connection is open: ``max_len``: octets of data in one service, at most."""

    max_len: int = MAX_RECORD


InitiateReq.LAYOUT = Layout(
    "Initiate", InitiateReq._read, "reserved" / fixed(24), _SEND_TIMEOUT, *_COMMON, function=Function.INITIATE
)
InitiateRes.LAYOUT = Layout(
    "Initiate", InitiateRes._read, "max_len" / OCTET * "max_len_data_unit", *_COMMON, function=Function.INITIATE
)


def _address(name: str, kind: int, octets: bytes) -> Address:
    lengths = {0: range(_ADDRESS, _ADDRESS + 1), 1: range(_NET_ADDRESS, 256)}.get(kind)
    if lengths is None or len(octets) not in lengths:
        raise PduError(f"Initiate: {name} of type {kind} with {len(octets)} octets; type 0 has 2, type 1 at least 8")
    return Address(octets[0], octets[1], octets[_ADDRESS:])


#: Idle, request and response; the second octet is reserved and may be anything from others
IDLE: Final = bytes((Function.IDLE, 1))


class Subnet(IntEnum):
    NONE = 0
    LOCAL = 1
    REMOTE = 2


class Instance(IntEnum):
    FDL = 0
    MS2 = 1
    USER = 2


#: a reason has four bits, with every instance
MAX_REASON: Final = 15


class AbortReason(IntEnum):
    """Reasons of the instance MS2."""

    SEQUENCE = 1
    REQUEST_PDU = 2
    TIMEOUT = 3
    RESPONSE_PDU = 4
    SERVICE = 5
    SEND_TIMEOUT = 6
    ADDRESS = 7
    WAITING = 8
    RESOURCE = 15


_REASONS: Final[Mapping[int, tuple[str, str]]] = {
    AbortReason.SEQUENCE: ("ABT_SE", "a service that is not allowed in this state"),
    AbortReason.REQUEST_PDU: ("ABT_FE", "a request that cannot be read"),
    AbortReason.TIMEOUT: ("ABT_TO", "nothing was heard from the other end in time"),
    AbortReason.RESPONSE_PDU: ("ABT_RE", "a response that cannot be read"),
    AbortReason.SERVICE: ("ABT_IV", "an impossible service of its user"),
    AbortReason.SEND_TIMEOUT: ("ABT_STO", "the send time-out asked for is too short"),
    AbortReason.ADDRESS: ("ABT_IA", "an address in Initiate (API, access level, network) that it does not have"),
    AbortReason.WAITING: ("ABT_OC", "it still waits for the end of a service"),
    AbortReason.RESOURCE: ("ABT_RES", "it has no connection left"),
}
#: reasons of the instance FDL: states of the link layer (EN 50170-2)
_LINK: Final = {
    1: ("UE", "an error of the user"),
    2: ("RR", "no resource"),
    3: ("RS", "the service access point is closed"),
    9: ("NR", "no data"),
    10: ("DH", "data, high priority"),
    11: ("LR", "no resource at the own station"),
    12: ("RDL", "data, low priority, but no resource"),
    13: ("RDH", "data, high priority, but no resource"),
    14: ("DS", "not in the logical ring"),
    15: ("NA", "the other station does not answer"),
}
_SUBNETS: Final[Mapping[int, str]] = {Subnet.LOCAL: " in its own subnet", Subnet.REMOTE: " in a remote subnet"}


class Abort(Pdu, frozen=True):
    """The end of a connection, from either end, without an answer. ``instance`` gives ``reason`` 0..15 its meaning."""

    reason: int
    instance: int = Instance.MS2
    subnet: int = Subnet.NONE

    @property
    def text(self) -> str:
        where = _SUBNETS.get(self.subnet, "")
        unknown = (f"reason {self.reason}", "a reserved reason")
        match self.instance:
            case Instance.MS2:
                name, text = _REASONS.get(self.reason, unknown)
                return f"{text} ({name}{where})"
            case Instance.FDL:
                name, text = _LINK.get(self.reason, unknown)
                return f"its link layer: {text} ({name}{where})"
            case Instance.USER:
                return f"its user, reason {self.reason}{where}"
            case _:
                return f"instance {self.instance}, reason {self.reason}{where}, both reserved"


Abort.LAYOUT = Layout(
    "Abort",
    Abort,
    "subnet" / OCTET,
    "reserved" / fixed(2),
    "instance" / bits(2),
    "reason" / bits(4),
    "rest" / ignored(),  # reserved; Balluff sends some octets
    function=Function.ABORT,
)
