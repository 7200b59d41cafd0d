"""The PDUs that MS2 has beside Read and Write: Resource_Manager, Initiate, Data_Transport, Idle, Abort.

Layouts and reasons: docs/protocol.md#ms2, docs/protocol.md#initiate, docs/protocol.md#idle, docs/protocol.md#abort.
Times are in ns; on the wire they count 10 ms.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final

from dpstack.dp.pdu.layouts import MAX_RECORD, MAX_SLOT
from dpstack.dpv1.pdu.layouts import (
    ABORT,
    INITIATE,
    INITIATE_REQ,
    INITIATE_RES,
    RECORD,
    RESOURCE_MANAGER,
    AbortOctets,
    InitiateOctets,
    InitiateReqOctets,
    InitiateResOctets,
    RecordOctets,
    ResourceManagerOctets,
)
from dpstack.dpv1.pdu.read_write import Function, RecordReq, WriteReq
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


@dataclass(frozen=True, slots=True)
class Address:
    """One end of a connection: Application Process Instance and Access Level; ``net``: 6 octets of network address and
    the MAC address, where the end is not on this bus (address type 1), else empty (type 0)."""

    api: int = 0
    scl: int = 0
    net: bytes = b""

    @property
    def kind(self) -> int:
        """S_Type or D_Type."""
        return int(bool(self.net))

    def build(self) -> bytes:
        """The octets, without type and length."""
        return bytes((self.api, self.scl)) + self.net


@dataclass(frozen=True, slots=True)
class ResourceManagerRes:
    """The resource manager's answer to Initiate: go on at ``server_sap``, which has ``send_timeout_ns`` at least."""

    server_sap: int
    send_timeout_ns: int

    def build(self) -> bytes:
        """The octets. Raises PduError where a value does not fit."""
        if self.server_sap not in SERVER_SAPS:
            raise PduError(f"{self.server_sap} is no server SAP: 0..{SERVER_SAPS[-1]}")
        octets = ResourceManagerOctets(Function.RESOURCE_MANAGER, self.server_sap, _counts(self.send_timeout_ns), b"")
        return RESOURCE_MANAGER.build(octets)

    @classmethod
    def parse(cls, octets: bytes) -> ResourceManagerRes:
        """Raises PduError naming the octet."""
        raw = RESOURCE_MANAGER.parse(octets)
        _is(Function.RESOURCE_MANAGER, raw.function)
        _ends(octets, raw.rest, "Resource_Manager")
        if raw.server_sap not in SERVER_SAPS:
            raise PduError(f"Resource_Manager: octet 2: {raw.server_sap} is no server SAP (0..{SERVER_SAPS[-1]})")
        return cls(raw.server_sap, raw.send_timeout * TIMEOUT_UNIT)


@dataclass(frozen=True, slots=True, kw_only=True)
class Initiate:
    """What both ends say in Initiate: ``features``, ``profile_features``: two octets each; ``profile_ident``: 0 for
    none; ``source``: the end that says it."""

    features: int = FEATURES
    profile_features: int = 0
    profile_ident: int = 0
    source: Address = Address()
    destination: Address = Address()

    def common(self) -> bytes:
        """The octets behind those that request and response have each of their own. Raises PduError where a value does
        not fit."""
        source, destination = self.source.build(), self.destination.build()
        raw = InitiateOctets(
            features=self.features,
            profile_features=self.profile_features,
            profile_ident=self.profile_ident,
            s_type=self.source.kind,
            s_len=len(source),
            d_type=self.destination.kind,
            d_len=len(destination),
            addresses=source + destination,
        )
        return INITIATE.build(raw)


@dataclass(frozen=True, slots=True)
class InitiateReq(Initiate):
    """Open a connection."""

    send_timeout_ns: int

    def build(self) -> bytes:
        """The octets, at least 20. Raises PduError where a value does not fit."""
        send_timeout = _counts(self.send_timeout_ns)
        return INITIATE_REQ.build(InitiateReqOctets(Function.INITIATE, bytes(3), send_timeout, self.common()))

    @classmethod
    def parse(cls, octets: bytes) -> InitiateReq:
        """Raises PduError naming the octet; reserved octets may be anything."""
        raw = INITIATE_REQ.parse(octets)
        _is(Function.INITIATE, raw.function)
        return cls(raw.send_timeout * TIMEOUT_UNIT, **_common(octets, raw.common))


@dataclass(frozen=True, slots=True)
class InitiateRes(Initiate):
    """The connection is open: ``max_len``: octets of data in one service, at most."""

    max_len: int = MAX_RECORD

    def build(self) -> bytes:
        """The octets, at least 16. Raises PduError where a value does not fit."""
        return INITIATE_RES.build(InitiateResOctets(Function.INITIATE, self.max_len, self.common()))

    @classmethod
    def parse(cls, octets: bytes) -> InitiateRes:
        """Raises PduError naming the octet."""
        raw = INITIATE_RES.parse(octets)
        _is(Function.INITIATE, raw.function)
        return cls(raw.max_len_data_unit, **_common(octets, raw.common))


@dataclass(frozen=True, slots=True)
class DataTransport:
    """Data_Transport, request and positive response: ``data`` to and from ``slot`` and ``index``."""

    slot: int
    index: int
    data: bytes

    def build(self) -> bytes:
        """The octets. Raises PduError where a value does not fit."""
        if not 0 <= self.slot <= MAX_SLOT:
            raise PduError(f"slot {self.slot} does not exist: 0..{MAX_SLOT}")
        if len(self.data) > MAX_RECORD:
            raise PduError(f"{len(self.data)} octets of data, {MAX_RECORD} are possible in one service")
        return RECORD.build(RecordOctets(Function.DATA_TRANSPORT, self.slot, self.index, len(self.data), self.data))

    @classmethod
    def parse(cls, octets: bytes) -> DataTransport:
        """Raises PduError naming the octet."""
        raw = RECORD.parse(octets)
        _is(Function.DATA_TRANSPORT, raw.function)
        if raw.length != len(raw.data) or raw.length > MAX_RECORD:
            raise PduError(f"Data_Transport: octet 4 says {raw.length} octets of data, {len(raw.data)} came")
        return cls(raw.slot, raw.record, raw.data)


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


#: reasons are four bits, whatever the instance
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


_REASONS: Final = {
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
_SUBNETS: Final = {Subnet.NONE: "", Subnet.LOCAL: " in its own subnet", Subnet.REMOTE: " in a remote subnet"}


@dataclass(frozen=True, slots=True)
class Abort:
    """The end of a connection, from either end, without an answer. ``reason`` 0..15 means what ``instance`` says."""

    reason: int
    instance: int = Instance.MS2
    subnet: int = Subnet.NONE

    @property
    def text(self) -> str:
        where = _SUBNETS.get(Subnet(self.subnet), "") if self.subnet in Subnet.__members__.values() else ""
        match self.instance:
            case Instance.MS2:
                known = AbortReason(self.reason) if self.reason in AbortReason.__members__.values() else None
                name, text = _REASONS[known] if known else (f"reason {self.reason}", "a reserved reason")
                return f"{text} ({name}{where})"
            case Instance.FDL:
                name, text = _LINK.get(self.reason, (f"reason {self.reason}", "a reserved reason"))
                return f"its link layer: {text} ({name}{where})"
            case Instance.USER:
                return f"its user, reason {self.reason}{where}"
            case _:
                return f"instance {self.instance}, reason {self.reason}{where}, both reserved"

    def build(self) -> bytes:
        """The octets. Raises PduError where a value does not fit."""
        return ABORT.build(AbortOctets(Function.ABORT, self.subnet, 0, self.instance, self.reason, b""))

    @classmethod
    def parse(cls, octets: bytes) -> Abort:
        """What follows is reserved and may be anything (Balluff appends it). Raises PduError naming the octet."""
        raw = ABORT.parse(octets)
        _is(Function.ABORT, raw.function)
        return cls(raw.reason, raw.instance, raw.subnet)


def _counts(timeout_ns: int) -> int:
    """Rounded up: never shorter than what was meant."""
    counts = -(-timeout_ns // TIMEOUT_UNIT)
    if timeout_ns < 0 or counts > _MAX_WORD:
        longest = ns_to_s(_MAX_WORD * TIMEOUT_UNIT)
        raise PduError(f"a send time-out of {ns_to_s(timeout_ns):g} s is not possible: 0..{longest:g} s")
    return counts


def _common(octets: bytes, common: bytes) -> dict[str, Any]:
    """The fields of :class:`Initiate` in the last part of ``octets``."""
    raw = INITIATE.parse(common, len(octets) - len(common))
    if raw.s_len + raw.d_len != len(raw.addresses):
        announced = f"{raw.s_len} and {raw.d_len} octets of addresses are announced"
        raise PduError(f"Initiate: {announced}, {len(raw.addresses)} came")
    return {
        "features": raw.features,
        "profile_features": raw.profile_features,
        "profile_ident": raw.profile_ident,
        "source": _address("S_Addr", raw.s_type, raw.addresses[: raw.s_len]),
        "destination": _address("D_Addr", raw.d_type, raw.addresses[raw.s_len :]),
    }


def _address(name: str, kind: int, octets: bytes) -> Address:
    lengths = {0: range(_ADDRESS, _ADDRESS + 1), 1: range(_NET_ADDRESS, 256)}.get(kind)
    if lengths is None or len(octets) not in lengths:
        raise PduError(f"Initiate: {name} of type {kind} with {len(octets)} octets; type 0 has 2, type 1 at least 8")
    return Address(octets[0], octets[1], octets[_ADDRESS:])


def _is(function: Function, found: int) -> None:
    if found != function:
        raise PduError(f"octet 1 is 0x{found:02X}, {function.title} is 0x{function:02X}")


def _ends(octets: bytes, rest: bytes, name: str) -> None:
    if rest:
        raise PduError(f"{name} has {len(octets)} octets, octet {len(octets) - len(rest)} is the last one")


Service = RecordReq | DataTransport


def function_of(service: Service) -> Function:
    match service:
        case DataTransport():
            return Function.DATA_TRANSPORT
        case WriteReq():
            return Function.WRITE
        case _:
            return Function.READ


def title_of(service: Service) -> str:
    """With slot and index: they are what a reader looks for."""
    return f"{function_of(service).title} of slot {service.slot}, index {service.index}"
