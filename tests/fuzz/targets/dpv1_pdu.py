"""The PDUs of DP-V1, with I&M: an error is a PduError; PDUs that were read can be built and read again."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dpstack.dp.pdu.layouts import Pdu
from dpstack.dpv1.pdu import im, ms2
from dpstack.dpv1.pdu.error_codes import remedy
from dpstack.dpv1.pdu.read_write import (
    AlarmAck,
    DataTransport,
    Negative,
    ReadReq,
    UnacceptableError,
    WriteReq,
    parse_request,
    parse_response,
)
from dpstack.errors import PduError
from tests.fuzz.frame import Target, assert_plain, parsed


def run(octets: bytes) -> None:
    """The first octet chooses the PDU, the others are its octets."""
    if octets:
        _PDUS[octets[0] % len(_PDUS)](octets[1:])


def _request(octets: bytes) -> None:
    refused: UnacceptableError | None = None
    try:
        found = parse_request(octets)
    except UnacceptableError as error:
        refused = error
    except PduError:
        return
    if refused is not None:
        assert_plain(str(refused))
        answer = refused.negative.build()
        assert answer[:2] == bytes((octets[0] | 0x80, 0x80))
        assert Negative.parse(answer).code_1 == refused.negative.code_1
        return
    assert found.build() == octets
    assert_plain(found.title)
    if isinstance(found, (ReadReq, WriteReq)):
        positive = found.response(bytes(240))
        assert parse_response(positive.build()) == positive


def _response(octets: bytes) -> None:
    found = parsed(parse_response, octets, PduError)
    if found is None:
        return
    if isinstance(found, Negative):
        assert_plain(found.text)
        assert_plain(remedy(found.code_1))
        _same(Negative, found)
    elif found.slot <= 254 and len(octets) > 3 and octets[3] <= 240:
        assert found.build() == octets


def _transport(octets: bytes) -> None:
    found = parsed(DataTransport.parse, octets, PduError)
    if found is not None and found.slot <= 254:
        assert found.build() == octets


def _same(kind: type[Pdu], found: Pdu) -> None:
    assert kind.parse(found.build()) == found


def _of(kind: type[Pdu]) -> Callable[[bytes], None]:
    def judge(octets: bytes) -> None:
        found = parsed(kind.parse, octets, PduError)
        if found is not None:
            _same(kind, found)
            if isinstance(found, ms2.Abort):
                assert_plain(found.text)

    return judge


def _im_call(octets: bytes) -> None:
    found = parsed(im.parse_call, octets, PduError)
    if found is None:
        return
    fi_index, data = found
    assert fi_index in im.IM_FI
    assert octets.endswith(data)
    for number in range(len(im.RECORDS)):
        record = parsed(lambda octets, number=number: im.parse_answer(octets, number), octets, PduError)  # type: ignore[misc]
        if record is None:
            continue
        assert im.number_of(record) == number
        built = parsed(lambda _, record=record: record.build(), b"", PduError)  # type: ignore[misc]
        assert built is None or type(record).parse(built) == record
        assert built is None or len(built) == im.IM_LEN


_PDUS: Final[tuple[Callable[[bytes], None], ...]] = (
    _request,
    _response,
    _transport,
    _im_call,
    *(_of(kind) for kind in (AlarmAck, ms2.ResourceManagerRes, ms2.InitiateReq, ms2.InitiateRes, ms2.Abort)),
)
#: the function of each PDU, None where there are several
_FUNCTIONS: Final = (None, None, 0x51, None, 0x5C, 0x56, 0x57, 0x57, 0x58)


def repair(octets: bytes) -> bytes:
    """Give the PDU its function and the length of its data."""
    if len(octets) < 6:
        return octets
    out = bytearray(octets)
    place = out[0] % len(_PDUS)
    function = _FUNCTIONS[place]
    if function is not None:
        out[1] = function
    elif place < 2:
        out[1] = (0x5E, 0x5F, 0xDE, 0xDF)[out[1] % 4] if place else (0x5E, 0x5F)[out[1] % 2]
    if place == 3:
        out[1], out[3:5] = 8, (65000 + out[4] % 5).to_bytes(2, "big")
        out += bytes(max(0, 69 - len(out)))
    elif place < 3:
        out[4] = min(len(out) - 5, 240)
    elif place in (6, 7):  # lengths of the addresses
        head = 18 if place == 6 else 14
        room = len(out) - 1 - head
        if room >= 4:
            out[head - 3 : head + 1] = (0, 2, 1, room - 2) if room >= 10 else (0, 2, 0, 2)
            del out[head + 1 + room if room >= 10 else head + 5 :]
    return bytes(out)


TARGET = Target(run, covers=("dpstack.dpv1.pdu", "dpstack.dp.pdu.layouts"), max_len=256, repair=repair)
