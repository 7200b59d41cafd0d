"""Record 47 of PROFIdrive at both ends: PDUs, the drive with any request, the master with any drive."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any, Final

from dpstack.dpv1.pdu.read_write import ReadReq, WriteReq
from dpstack.errors import PduError
from dpstack.profile.model.jobs import CommandError
from dpstack.profile.model.param_store import ParamStore
from dpstack.profile.model.param_types import ParamType
from dpstack.profile.model.params import ParamSpec, ParamTable
from dpstack.profile.record47.client import Item, ParameterClient
from dpstack.profile.record47.param_lists import ReadParameter, read_limits, read_out, texts
from dpstack.profile.record47.parameter_server import ParameterServer, Rules, StoreParameters
from dpstack.profile.record47.pdu import (
    INDEX,
    Address,
    Answer,
    Attribute,
    Limits,
    Pause,
    Refused,
    Request,
    Response,
    Silent,
    Values,
)
from tests.fuzz.frame import Cutter, Target, assert_plain, parsed

_TABLE: Final = ParamTable(
    [
        *(ParamSpec(number=n, name=f"p{n}", title=f"Parameter {n}", factory=n) for n in range(1, 5)),
        ParamSpec(
            number=20, name="sets", title="Sets", type=ParamType.I16, low=-100, high=100, factory=-3, per_set=True
        ),
        ParamSpec(number=21, name="long", title="Long", type=ParamType.U32, high=1e6, factory=70000, read_only=True),
    ]
)
#: services that one job of the master may take: it ends by its patience
_MOST_SERVICES: Final = 20_000
_MS: Final = 1_000_000


def run(octets: bytes) -> None:
    """The first octet chooses the end, the others are requests or the script of the drive."""
    if octets:
        _ENDS[octets[0] % len(_ENDS)](octets[1:])


def _requests(octets: bytes) -> None:
    found = parsed(Request.parse, octets, PduError)
    if found is not None:
        made = parsed(lambda _: found.build(), b"", ValueError)  # a float that is no number is never sent
        assert made is None or Request.parse(made).build() == made


def _responses(octets: bytes) -> None:
    found = parsed(Response.parse, octets, PduError)
    if found is not None:
        made = parsed(lambda _: found.build(), b"", ValueError)
        assert made is None or Response.parse(made).build() == made


def _server() -> ParameterServer:
    store = ParamStore(_TABLE, {}, sets=2)
    model = StoreParameters(store, texts={1: ("one", "two", "three")})
    return ParameterServer(model, Rules(slots=frozenset({1}), limits=Limits(octets=100)))


def _drive(octets: bytes) -> None:
    """A drive that gets requests one after the other: it answers each, within its limits."""
    server = _server()
    for request in Cutter(octets).pieces():
        if isinstance(server.write_record(1, INDEX, request, 0), Refused):
            continue
        answer = server.read_record(1, INDEX, 240, 0)
        assert isinstance(answer, bytes)
        response = Response.parse(answer)
        assert response.reference == request[0]
        assert len(answer) <= 100 or response.id == 2, (len(answer), response)


def _master(octets: bytes) -> None:
    """A master whose drive answers after the script: honestly, damaged, with anything, with a refusal, not at all."""
    script = Cutter(octets)
    client = ParameterClient(1, limits=Limits(octets=60))
    jobs: tuple[Callable[[], Generator[Any, Answer, Any]], ...] = (
        lambda: read_out(client),
        lambda: read_limits(client),
        lambda: texts(client, 1, 3),
        lambda: client.read([Item(Address(20, 0, 40), width=2), Item(Address(3))]),
        lambda: client.change([(Address(2), Values(6, (7,))), (Address(20, 0, 2), Values(3, (1, 2)))]),
        lambda: client.read([Address(1, 0, 1, Attribute.DESCRIPTION), Address(4)]),
    )
    job = jobs[script.octet() % len(jobs)]()
    try:
        found = _talk(job, script)
    except CommandError as error:
        assert_plain(str(error))
    else:
        for one in found if isinstance(found, list) else ():
            if isinstance(one, ReadParameter):
                assert one.why_not is not None or one.values is not None


def _talk(job: Generator[Any, Answer, Any], script: Cutter) -> Any:
    server, now = _server(), 0
    answer: Answer | None = None
    for _ in range(_MOST_SERVICES):
        try:
            service = job.send(answer)  # type: ignore[arg-type]
        except StopIteration as end:
            return end.value
        now += service.ns if isinstance(service, Pause) else 2 * _MS
        answer = Answer(now, _answer(service, server, script, now))
    raise AssertionError(f"not over after {_MOST_SERVICES} services")


def _answer(service: Any, server: ParameterServer, script: Cutter, now: int) -> bytes | Refused | Silent:
    how = script.octet()
    match service:
        case WriteReq():
            found = server.write_record(1, INDEX, service.data, now)
            honest: bytes | Refused = b"" if found is None else found
            reference = service.data[0]
            _last[0] = reference
        case ReadReq():
            honest = server.read_record(1, INDEX, service.length, now)
        case _:
            return b""
    match how % 8:
        case 1:
            return Silent("nobody answers")
        case 2:
            return Refused(script.octet())
        case 3 | 4 if isinstance(service, ReadReq) and isinstance(honest, bytes):
            damaged = bytearray(honest)
            for _ in range(how >> 5):
                damaged[script.octet() % len(damaged)] = script.octet()
            return bytes(damaged)
        case 5 if isinstance(service, ReadReq) and isinstance(honest, bytes):
            return honest[: script.octet()]
        case 6 | 7 if isinstance(service, ReadReq):
            return bytes((_last[0],)) + script.take(script.octet())
    return honest


#: the reference of the last request
_last: Final = [0]
_ENDS: Final[tuple[Callable[[bytes], None], ...]] = (_requests, _responses, _drive, _master, _master)


def repair(octets: bytes) -> bytes:
    """Give a request and a response a number of parameters that fits, and a request of the drive its length."""
    if len(octets) < 12:
        return octets
    out = bytearray(octets)
    match out[0] % len(_ENDS):
        case 0:
            out[2] = 1 + out[2] % 2
            out[4] = out[4] % 3 + 1
        case 1:
            out[4] = out[4] % 4
        case 2:
            at = 1
            while at + 12 <= len(out):
                size = 10 if out[at] & 1 else min(22, len(out) - at - 1)
                out[at] = size
                out[at + 1] |= 1
                out[at + 2] = 1 + out[at + 2] % 2
                out[at + 3] &= 1
                out[at + 4] = (size - 4) // 6 if out[at + 2] == 1 else 1
                at += 1 + size
    return bytes(out)


TARGET = Target(
    run,
    covers=("dpstack.profile.record47",),
    max_len=120,
    repair=repair,
    words=(
        b"\x01\x01\x00\x01\x10\x00\x00\x01\x00\x00",
        b"\x01\x02\x00\x01\x10\x02\x00\x14\x00\x00\x03\x02\x00\x01\x00\x02",
        b"\x01\x01\x01\x01\x42\x01\x00\x05",
        b"\x01\x81\x01\x01\x44\x01\x00\x15",
        b"\x08\x01\x7f\xc0\x00\x00",
        b"\x03\xd4",
        b"\x03\xce",
    ),
)
