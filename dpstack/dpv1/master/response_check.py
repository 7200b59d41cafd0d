"""What an answer to Read, Write or Data_Transport comes to, for a master of either class
(docs/protocol.md#read-and-write)."""

from __future__ import annotations

from dpstack.dp.acyclic.job import Outcome, ServiceFailure
from dpstack.dpv1.pdu.error_codes import Decode, remedy
from dpstack.dpv1.pdu.read_write import (
    DataTransport,
    Function,
    Negative,
    ReadReq,
    ReadRes,
    Service,
    WriteReq,
    parse_response,
)
from dpstack.errors import PduError


def service_outcome(address: int, service: Service, octets: bytes) -> Outcome | None:
    """The end of ``service`` of the slave at ``address`` that ``octets`` are; None where they answer another one."""
    who = f"slave {address}"
    title = service.title
    try:
        transports = isinstance(service, DataTransport) and octets[:1] == bytes((Function.DATA_TRANSPORT,))
        response = DataTransport.parse(octets) if transports else parse_response(octets)
    except PduError as error:
        return Outcome(failure=ServiceFailure.LENGTH, text=f"{who} answers {title} with what cannot be read: {error}")
    if isinstance(response, Negative):
        return negative_outcome(who, title, response) if response.function == service.function else None
    if (response.slot, response.index) != (service.slot, service.index):
        return None
    match service, response:
        case ReadReq(length=asked), ReadRes(data=data):
            if len(data) > asked:
                text = f"{who} answers {title} with {len(data)} octets, {asked} were asked for"
                return Outcome(failure=ServiceFailure.LENGTH, text=text)
            return Outcome(data)
        case DataTransport(), DataTransport(data=data):
            return Outcome(data)
        case WriteReq(data=given), taken if not isinstance(taken, (ReadRes, DataTransport)):
            if taken.length != len(given):
                text = f"{who} says it took {taken.length} octets by {title}, {len(given)} were given"
                return Outcome(failure=ServiceFailure.LENGTH, text=text)
            return Outcome()
    return None


def negative_outcome(who: str, title: str, response: Negative) -> Outcome:
    """The end of the service ``title`` by a negative response of ``who``."""
    codes = (response.decode, response.code_1, response.code_2)
    todo = remedy(response.code_1) if response.decode == Decode.DPV1 else ""
    text = f"{who} refuses {title}: {response.text}" + (f"; {todo}" if todo else "")
    return Outcome(failure=ServiceFailure.NEGATIVE, text=text, codes=codes)
