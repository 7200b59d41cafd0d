"""Parameter channel with a 16-bit index and a handshake bit (SEW MOVILINK, KEB): eight octets, both ends.

Octets: management, subindex, index high, index low, four of data, or an error as class, code and additional code (two
octets). Management: bit 7 result (1: an error), bit 6 handshake, bits 5-4 length - 1, below them the service: 1 read,
2 write, 3 write to RAM only, 0 none. A request is new when bit 6 changes, and done when the drive shows the same bit 6.
The length bits of a confirmation are not judged: those of KEB's own example differ from the request's.

Sources: SEW MOVITRAC B operating instructions p109 and p110, SEW's pages "Management byte" and "Additional code" of
manual 31960413; KEB as docs/reference/drives/keb-f5.md#administration-byte. The services and texts of a drive are
data: an :class:`IndexedDialect`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from typing import Final

from msgspec import Struct

from dpstack.profile.channel.base import (
    CycleTimes,
    FindSpec,
    ParameterChannel,
    ParamKey,
    ParamRef,
    check_write,
    outcome,
)
from dpstack.profile.channel.pkw import ARRAY_PKW, PAGED_PKW, PLAIN_PKW, RETRY_NS, VLT_PKW, PkwDialect
from dpstack.profile.channel.stored_writes import StoredWrites
from dpstack.profile.model import param_errors as errors
from dpstack.profile.model.jobs import CommandError, Steps
from dpstack.profile.model.param_types import ParamType
from dpstack.profile.model.params import ParamSpec

RESULT, HANDSHAKE, WRITE_RAM, WRITE, READ = 0x80, 0x40, 0x03, 0x02, 0x01
LENGTH: Final = 8
#: four octets of data
_FOUR: Final = 0x30
_ZEROS: Final = bytes(LENGTH)
_NAMES: Final = {READ: "read", WRITE: "write", WRITE_RAM: "write to RAM"}
#: an illegal service: class 5, code 4
BAD_SERVICE: Final = 0x0504_0000


def code_text(number: int) -> str:
    """``8/0/0012``: class, code, additional code."""
    return f"{number >> 24}/{number >> 16 & 0xFF}/{number & 0xFFFF:04X}"


class IndexedDialect(Struct, frozen=True, kw_only=True):
    """Differences between drives. Errors are numbers of their four octets, class first.

    ``refusals``: the errors of a simulated drive by PROFIdrive's number.
    """

    #: error texts by number
    errors: Mapping[int, str]
    #: errors of a drive that cannot carry out the request yet: it is repeated
    busy: frozenset[int] = frozenset()
    #: bits of the management octet that are the service
    services: int = 0x0F
    #: the drive has subindexes: users name them as index
    arrays: bool = False
    #: the drive has a service for writes to RAM only
    ram: bool = False
    refusals: Mapping[int, int] = {}

    @property
    def most(self) -> int:
        """The highest parameter number."""
        return 0xFFFF

    def error_text(self, number: int) -> str:
        """``error 8/0/0012, read only``."""
        return f"error {code_text(number)}, {self.errors.get(number, 'an error without a text in the manual')}"

    def code(self, number: int) -> str:
        """An error number for people."""
        return code_text(number)


#: SEW's MOVILINK with 8 octets, as MOVITRAC B and MOVIDRIVE have it
MOVILINK: Final = IndexedDialect(
    errors={
        0x0500_0001: "illegal service",
        0x0500_0002: "no response of the inverter",
        0x0500_000A: "illegal length",
        0x0500_000B: "illegal address",
        0x0500_0017: "access denied",
        0x0800_0010: "there is no such parameter (index)",
        0x0800_0011: "the parameter is not implemented",
        0x0800_0012: "read only",
        0x0800_0013: "the parameters are locked",
        0x0800_0014: "the factory setting is being made",
        0x0800_0015: "the value is too large",
        0x0800_0016: "the value is too small",
        0x0800_0017: "the option that the parameter needs is missing",
        0x0800_0018: "error in the software of the inverter",
        0x0800_0019: "can be accessed over RS485 only",
        0x0800_001A: "can be accessed over RS485 only",
        0x0800_001B: "the parameter is protected",
        0x0800_001C: "can be changed in controller inhibit only",
        0x0800_001D: "the value is invalid",
        0x0800_001E: "the factory setting was activated",
        0x0800_0020: "can be changed without enable (output stage off) only",
        0x0800_0023: "can be changed while IPOS is stopped only",
    },
    ram=True,
    refusals={
        errors.ILLEGAL_NUMBER: 0x0800_0010,
        errors.READ_ONLY: 0x0800_0012,
        errors.LIMITS: 0x0800_001D,
        errors.BAD_SUBINDEX: 0x0800_0010,
        errors.OPERATING_STATE: 0x0800_0020,
    },
)

#: layouts of the parameter channel by name, for drives that are declared as data
DIALECTS: Final[Mapping[str, PkwDialect | IndexedDialect]] = {
    "plain": PLAIN_PKW,
    "arrays": ARRAY_PKW,
    "vlt": VLT_PKW,
    "paged": PAGED_PKW,
    "movilink": MOVILINK,
}


class _Request(Struct, eq=False):
    """A request under way: its octets without the handshake bit, and the reply."""

    octets: bytes
    label: str
    reply: bytes | None = None
    stray: bytes | None = None


class IndexedChannel(ParameterChannel):
    """The master's end. Every access is made with 4 octets; ``resolve`` finds the parameter that a user has named.

    A request whose order was given up keeps the channel until the drive has confirmed it: its confirmation could not
    be distinguished from that of another request.
    """

    octets = _ZEROS

    def __init__(self, dialect: IndexedDialect, times: CycleTimes, resolve: Callable[[ParamKey], ParamRef]) -> None:
        self._dialect = dialect
        self._times = times
        self._resolve = resolve
        self._stored_writes = StoredWrites()
        self._queue: deque[_Request] = deque()
        self.reset()

    @property
    def busy(self) -> bool:
        """A request waits or runs."""
        return self._active is not None or bool(self._queue)

    def reset(self) -> None:
        self._queue.clear()
        self._active: _Request | None = None
        self._shown = 0  # the handshake bit of the last request
        self._synced_at: int | None = None  # from this time on the drive's handshake bit counts as it stands
        self.octets = _ZEROS

    def fields(self, octets: bytes, *, order: bool, find: FindSpec) -> dict[str, object]:
        service, subindex, index = octets[0] & self._dialect.services, octets[1], int.from_bytes(octets[2:4], "big")
        if not service:
            return {}
        what = _NAMES.get(service, f"service {service}")
        raw = int.from_bytes(octets[4:8], "big")
        name, spec = self.described(index, subindex, find)
        value = raw if spec is None else spec.to_value(spec.from_wire(raw, 32))
        found: dict[str, object] = {
            "service": what,
            "handshake": bool(octets[0] & HANDSHAKE),
            "index": f"{index:04X}h",
            "subindex": subindex,
            "value": value,
            "name": name,
        }
        text = f"{what} {name}:{subindex}"
        if not order and octets[0] & RESULT:
            found["error"] = self._dialect.error_text(raw)
            return found | {"text": f"{text}: {found['error']}"}
        carries = (service == READ) != order
        return found | {"text": f"{text} = {value}" if carries else text}

    def step(self, inputs: bytes, now: int) -> None:
        """One cycle: judge the confirmation of the request under way; without one send the next, handshake inverted."""
        shown = inputs[0] & HANDSHAKE
        active = self._active
        if active is not None and shown == self._shown:
            if inputs[1:4] == active.octets[1:4]:
                active.reply = inputs[:LENGTH]
                self._active = None
            else:
                active.stray = inputs[:LENGTH]
        if self._active is None and self._queue and self._in_step(shown, now):
            self._shown = shown ^ HANDSHAKE
            self._active = request = self._queue.popleft()
            self.octets = bytes([request.octets[0] | self._shown]) + request.octets[1:]

    def _in_step(self, shown: int, now: int) -> bool:
        """The drive's bit is that of our last request, or it has had the time to show what it starts with."""
        if shown == self._shown:
            return True
        if self._synced_at is None:
            self._synced_at = now + self._times.settle_ns
        return now >= self._synced_at

    # -- what a drive may have in another way -----------------------------------------------------------------------

    def described(self, index: int, subindex: int, find: FindSpec) -> tuple[str, ParamSpec | None]:
        """The name of a parameter, and its entry in the table if its values are scaled by it."""
        spec = find(index, subindex)
        return str(index) if spec is None else spec.name, spec

    def to_raw(self, ref: ParamRef, value: float) -> int:
        """The integer on the wire. Raises CommandError."""
        raw = check_write(ref.spec, ref.label, value)
        if raw is None:
            raw = int(value)
            if raw != value or not -(1 << 31) <= raw < 1 << 32:
                raise CommandError(
                    "usage", f"{ref.label}: its scale is unknown here, give the 32-bit integer on the wire"
                )
        return raw

    def outcome(self, ref: ParamRef, raw: int) -> dict[str, object]:
        """The outcome of a job by the 32 bits of the value; of an unknown parameter they are signed."""
        spec = ref.spec
        if spec is None:
            raw = (raw ^ 0x8000_0000) - 0x8000_0000
            return outcome(None, ref.pnu, raw, raw, ref.data_set)
        raw = spec.from_wire(raw, 32)
        self.remark(ref.label, spec.misfit(raw, real=spec.type is ParamType.F32))
        return outcome(spec, ref.pnu, spec.to_value(raw), raw, ref.data_set)

    def stored_as(self, ref: ParamRef) -> ParamSpec | None:
        """The entry that says whether a write is stored."""
        return ref.spec

    # -- orders ---------------------------------------------------------------------------------------------------

    def read(self, key: ParamKey, deadline: int) -> Steps[dict[str, object]]:
        ref = self._resolve(key)
        return self.outcome(ref, (yield from self.get(ref, deadline)))

    def write(self, key: ParamKey, value: float, deadline: int) -> Steps[dict[str, object]]:
        """Write one parameter; the integer on the wire if its scale is unknown."""
        ref = self._resolve(key)
        raw = self.to_raw(ref, value)
        yield from self.put(ref, raw, deadline, ram=key.ram)
        return self.outcome(ref, raw & 0xFFFF_FFFF)

    def get(self, ref: ParamRef, deadline: int) -> Steps[int]:
        """The 32 bits of a parameter."""
        data = yield from self._exchange(READ | _FOUR, ref, 0, deadline)
        return int.from_bytes(data, "big")

    def put(self, ref: ParamRef, raw: int, deadline: int, *, ram: bool = False) -> Steps[None]:
        """Write the low 32 bits of ``raw``."""
        if not ram:
            self._stored_writes.admit((ref.pnu, ref.ind), ref.label, self._times.now, self.stored_as(ref))
        yield from self._exchange((WRITE_RAM if ram else WRITE) | _FOUR, ref, raw, deadline)

    def _exchange(self, service: int, ref: ParamRef, raw: int, deadline: int) -> Steps[bytes]:
        octets = bytes([service, ref.ind]) + ref.pnu.to_bytes(2, "big")
        octets += (raw & 0xFFFF_FFFF).to_bytes(4, "big")
        while True:
            reply = yield from self._confirmed(_Request(octets, ref.label), deadline)
            if not reply[0] & RESULT:
                return reply[4:]
            number = int.from_bytes(reply[4:8], "big")
            again = self._times.now + RETRY_NS
            if number not in self._dialect.busy or again >= deadline:
                raise CommandError("parameter", f"{ref.label}: {self._dialect.error_text(number)}", number)
            while self._times.now < again:
                yield

    def _confirmed(self, request: _Request, deadline: int) -> Steps[bytes]:
        self._queue.append(request)
        try:
            while request.reply is None:
                if self._times.now >= deadline:
                    raise CommandError("timeout", f"{request.label}: {self._silence(request)}")
                yield
        finally:
            if request in self._queue:
                self._queue.remove(request)
        return request.reply

    def _silence(self, request: _Request) -> str:
        active = self._active
        if request.stray is not None:
            stray = request.stray
            return f"the drive answered for index {stray[2:4].hex().upper()}h subindex {stray[1]} instead"
        if active is not None and active is not request:
            return f"the drive has not yet confirmed the request before it ({active.label})"
        return "the drive did not confirm the request in its parameter channel in time"


class RefusedAccess(Exception):  # noqa: N818 -- an answer, not a failure of the program
    """A request that ends with an error; ``number``: its four octets."""

    def __init__(self, number: int) -> None:
        super().__init__(code_text(number))
        self.number = number


class IndexedServer:
    """The drive's end. ``handler(index, subindex, raw, octets)``: raw None for a read -> the value and its octets.

    ``raw`` and the value are unsigned 32 bits; of a shorter write only its octets, ``octets`` says how many.
    Readings: a read answers with 4 octets when the request's length is 4, otherwise with the parameter's own; the
    confirmation's length bits are 0 as in KEB's example.
    """

    __slots__ = ("_dialect", "_handler", "_reply", "_shown", "requests")

    def __init__(
        self, dialect: IndexedDialect, handler: Callable[[int, int, int | None, int], tuple[int, int]]
    ) -> None:
        self._dialect = dialect
        self._handler = handler
        self._shown = 0
        self._reply = _ZEROS
        #: requests begun, for whoever watches the bus
        self.requests = 0

    def reset(self) -> None:
        """Data exchange begins: the handshake starts at 0."""
        self._shown = 0
        self._reply = _ZEROS

    def step(self, octets: bytes) -> bytes:
        """The confirmation to the eight octets of the request."""
        shown = octets[0] & HANDSHAKE
        if shown != self._shown:
            self._shown = shown
            self._reply = self._answer(octets)
        return self._reply

    def _answer(self, octets: bytes) -> bytes:
        service = octets[0] & self._dialect.services
        head = bytes([octets[0] & HANDSHAKE | service]) + octets[1:4]
        if not service:
            return head + bytes(4)
        self.requests += 1
        length = (octets[0] >> 4 & 3) + 1
        index = int.from_bytes(octets[2:4], "big")
        try:
            if service == WRITE or (service == WRITE_RAM and self._dialect.ram):
                self._handler(index, octets[1], int.from_bytes(octets[4 : 4 + length], "big"), length)
                return head + octets[4:]
            if service != READ:
                raise RefusedAccess(BAD_SERVICE)
            raw, own = self._handler(index, octets[1], None, length)
        except RefusedAccess as refused:
            return bytes([head[0] | RESULT]) + head[1:] + refused.number.to_bytes(4, "big")
        size = 4 if length == 4 else own
        return head + (raw & (1 << 8 * size) - 1).to_bytes(size, "big") + bytes(4 - size)
