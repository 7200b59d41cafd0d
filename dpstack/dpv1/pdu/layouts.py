"""The octets of MS1 and MS2, declared as those of DP-V0 are (:mod:`dpstack.dp.pdu.layouts`).

Layouts: docs/protocol.md#functions-of-dp-v1, docs/protocol.md#im.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from dpstack.dp.pdu.layouts import OCTET, REST, WORD, Layout, bits, octets


class RecordOctets(NamedTuple):
    """Read and Write, requests and positive responses: four octets, and the data where there are any."""

    function: int
    slot: int
    record: int
    length: int
    data: bytes


RECORD: Final = Layout(
    "DP-V1 service",
    RecordOctets,
    "function" / OCTET,
    "slot" / OCTET,
    "record" / OCTET,
    "length" / OCTET,
    "data" / REST,
)


class NegativeOctets(NamedTuple):
    """A negative response of any service; ``rest`` should be empty."""

    function: int
    error_decode: int
    error_code_1: int
    error_code_2: int
    rest: bytes


NEGATIVE: Final = Layout(
    "DP-V1 negative response",
    NegativeOctets,
    "function" / OCTET,
    "error_decode" / OCTET,
    "error_code_1" / OCTET,
    "error_code_2" / OCTET,
    "rest" / REST,
)


class AlarmAckOctets(NamedTuple):
    """Alarm_Ack, request and positive response: what it acknowledges."""

    function: int
    slot: int
    kind: int
    specifier: int
    rest: bytes


ALARM_ACK: Final = Layout(
    "Alarm_Ack",
    AlarmAckOctets,
    "function" / OCTET,
    "slot" / OCTET,
    "kind" / OCTET,
    "specifier" / OCTET,
    "rest" / REST,
)


class ResourceManagerOctets(NamedTuple):
    """What the resource manager (SAP 49) answers to Initiate."""

    function: int
    server_sap: int
    send_timeout: int
    rest: bytes


RESOURCE_MANAGER: Final = Layout(
    "Resource_Manager",
    ResourceManagerOctets,
    "function" / OCTET,
    "server_sap" / OCTET,
    "send_timeout" / WORD,
    "rest" / REST,
)


class InitiateReqOctets(NamedTuple):
    """Initiate, request; what it has in ``common`` with the response is :class:`InitiateOctets`."""

    function: int
    reserved: bytes
    send_timeout: int
    common: bytes


INITIATE_REQ: Final = Layout(
    "Initiate request",
    InitiateReqOctets,
    "function" / OCTET,
    "reserved" / octets(3),
    "send_timeout" / WORD,
    "common" / REST,
)


class InitiateResOctets(NamedTuple):
    """Initiate, positive response; what it has in ``common`` with the request is :class:`InitiateOctets`."""

    function: int
    max_len_data_unit: int
    common: bytes


INITIATE_RES: Final = Layout(
    "Initiate response",
    InitiateResOctets,
    "function" / OCTET,
    "max_len_data_unit" / OCTET,
    "common" / REST,
)


class InitiateOctets(NamedTuple):
    """What both ends say in Initiate; ``addresses`` are both addresses, S_Len and D_Len octets."""

    features: int
    profile_features: int
    profile_ident: int
    s_type: int
    s_len: int
    d_type: int
    d_len: int
    addresses: bytes


INITIATE: Final = Layout(
    "Initiate",
    InitiateOctets,
    "features" / WORD,
    "profile_features" / WORD,
    "profile_ident" / WORD,
    "s_type" / OCTET,
    "s_len" / OCTET,
    "d_type" / OCTET,
    "d_len" / OCTET,
    "addresses" / REST,
)


class AbortOctets(NamedTuple):
    """Abort; ``rest`` are reserved octets."""

    function: int
    subnet: int
    reserved: int
    instance: int
    reason: int
    rest: bytes


ABORT: Final = Layout(
    "Abort",
    AbortOctets,
    "function" / OCTET,
    "subnet" / OCTET,
    "reserved" / bits(2),
    "instance" / bits(2),
    "reason" / bits(4),
    "rest" / REST,
)


class ImCallOctets(NamedTuple):
    """The head of I&M in a record: Extended_Function_Num, a reserved octet, FI_Index; then the data of a record."""

    function: int
    reserved: int
    fi_index: int
    data: bytes


IM_CALL: Final = Layout(
    "I&M call",
    ImCallOctets,
    "function" / OCTET,
    "reserved" / OCTET,
    "fi_index" / WORD,
    "data" / REST,
)


class Im0Octets(NamedTuple):
    """I&M0, 64 octets."""

    header: bytes
    manufacturer_id: int
    order_id: bytes
    serial_number: bytes
    hardware_revision: int
    software_kind: bytes
    software_functional: int
    software_bug_fix: int
    software_internal: int
    revision_counter: int
    profile_id: int
    profile_type: int
    version_major: int
    version_minor: int
    supported: int


IM0: Final = Layout(
    "I&M0",
    Im0Octets,
    "header" / octets(10),
    "manufacturer_id" / WORD,
    "order_id" / octets(20),
    "serial_number" / octets(16),
    "hardware_revision" / WORD,
    "software_kind" / octets(1),
    "software_functional" / OCTET,
    "software_bug_fix" / OCTET,
    "software_internal" / OCTET,
    "revision_counter" / WORD,
    "profile_id" / WORD,
    "profile_type" / WORD,
    "version_major" / OCTET,
    "version_minor" / OCTET,
    "supported" / WORD,
)


class Im1Octets(NamedTuple):
    """I&M1, 64 octets."""

    header: bytes
    tag_function: bytes
    tag_location: bytes


IM1: Final = Layout("I&M1", Im1Octets, "header" / octets(10), "tag_function" / octets(32), "tag_location" / octets(22))


class Im2Octets(NamedTuple):
    """I&M2, 64 octets."""

    header: bytes
    date: bytes
    reserved: bytes


IM2: Final = Layout("I&M2", Im2Octets, "header" / octets(10), "date" / octets(16), "reserved" / octets(38))


class ImTextOctets(NamedTuple):
    """I&M3 and I&M4, 64 octets."""

    header: bytes
    body: bytes


IM3: Final = Layout("I&M3", ImTextOctets, "header" / octets(10), "body" / octets(54))
IM4: Final = Layout("I&M4", ImTextOctets, "header" / octets(10), "body" / octets(54))
