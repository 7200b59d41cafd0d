"""The octets of the DP-V1 services, declared as those of DP-V0 are (:mod:`dpstack.dp.wire`).

Layouts: protocol facts C2 (VPC3+ header; ABB FPBA-01 manual p103) and C5 (ABB FPBA-01 manual p128).
"""

from __future__ import annotations

from typing import Final, NamedTuple

from dpstack.dp.wire import OCTET, REST, WORD, Layout, octets


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
