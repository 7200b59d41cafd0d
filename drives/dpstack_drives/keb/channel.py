"""The parameter channel of the F5 operator, both ends: docs/reference/drives/keb-f5.md#administration-byte.

Octets (Coding of the user data): administration byte, subindex, index high, index low, four data octets; a value
stands left-justified by its length, or an error as class, code and additional code. Administration byte: bit 7 result,
bit 6 handshake, bits 5-4 length - 1, bits 1-0 service (1 read, 2 write, 0 none). A request is new when bit 6 changes,
and done when the drive shows the same bit 6. The confirmation's length bits differ from the request's in the manual's
own example, so they are not judged.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final

from msgspec import Struct

from dpstack.profile import (
    CHANNEL_LEN,
    RETRY_NS,
    CommandError,
    CycleTimes,
    FindSpec,
    ParameterChannel,
    ParamKey,
    Steps,
    StoredWrites,
    count_of,
)
from dpstack_drives.keb import table as t

RESULT, HANDSHAKE, WRITE, READ = 0x80, 0x40, 0x02, 0x01
_FOUR: Final = 0x30
_ZEROS: Final = bytes(CHANNEL_LEN)


class Target(Struct, frozen=True):
    """A parameter as it stands in the channel, and what to call it."""

    index: int
    subindex: int
    label: str
    data_set: int | None = None

    @property
    def scale(self) -> tuple[int, str]:
        """Counts per unit, and the unit, if the manual shows them."""
        return t.SCALES.get(self.index, (1, ""))


def _count(label: str, value: float, scale: float, unit: str) -> int:
    """The integer on the wire. Raises CommandError if the value lies between two."""
    try:
        return count_of(label, value, scale, unit)
    except ValueError as error:
        raise CommandError("usage", str(error)) from None


def find(key: ParamKey) -> Target:
    """The parameter a user named. Raises CommandError of kind usage.

    ``data_set`` 0..7 becomes its bit of the subindex; ``index`` is the subindex itself (0 = indirect, several bits =
    several sets). Neither: set 0, of the operator's own parameters subindex 0.
    """
    if key.ram:
        raise CommandError("usage", "keb-f5 has no writes to RAM only (F5-C: ud.05 says when it stores)")
    index = _index(key.name)
    if not t.INVERTER.start <= index <= 0xFFFF:
        raise CommandError(
            "usage", f"index {index:04X}h: inverter parameters begin at 2000h (2000h + the address in its manual)"
        )
    spec = t.PARAMETERS.get(index) if t.index_of(str(key.name)) is not None else None
    label = t.name_of(index) + (f" {spec.title}" if spec is not None else "")
    if key.data_set is not None and key.index is not None:
        raise CommandError("usage", f"{label}: give data_set or index (the subindex), not both")
    if key.index is not None:
        if key.index > 0xFF:
            raise CommandError("usage", f"{label}: subindexes are 0..255")
        return Target(index, key.index, label)
    if index not in t.INVERTER:
        if key.data_set is not None:
            raise CommandError("usage", f"{label} has no sets; give the subindex as index")
        return Target(index, 0, label)
    data_set = key.data_set or 0
    if data_set >= t.SETS:
        raise CommandError("usage", f"{label}: sets are 0..{t.SETS - 1}")
    return Target(index, 1 << data_set, label, data_set)


def _index(name: str | int) -> int:
    if isinstance(name, int):
        return name
    found = t.index_of(name)
    if found is not None:
        return found
    if t.looks_like_name(name):
        raise CommandError(
            "usage",
            f"{name!r}: the address of its group is not in the manual (of {', '.join(t.GROUPS)} it is): give the "
            "index, 0x2000 + the address in the application manual",
        )
    try:
        return int(name.removesuffix("h"), 16)
    except ValueError:
        raise CommandError("usage", f"{name!r} is neither a parameter such as oP.3 nor an index in hex") from None


class _Request(Struct, eq=False):
    """A request under way: its octets without the handshake bit, and the reply."""

    octets: bytes
    label: str
    reply: bytes | None = None
    stray: bytes | None = None


class KebChannel(ParameterChannel):
    """The master's end. Every access is made with 4 octets.

    A request whose order was given up keeps the channel until the drive has confirmed it: its confirmation could not
    be distinguished from that of another request.
    """

    octets = _ZEROS

    def __init__(self, times: CycleTimes) -> None:
        self._times = times
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
        service, subindex, index = octets[0] & (READ | WRITE), octets[1], int.from_bytes(octets[2:4], "big")
        if not service:
            return {}
        what = {READ: "read", WRITE: "write"}.get(service, f"service {service}")
        value = int.from_bytes(octets[4:8], "big")
        found: dict[str, object] = {
            "service": what,
            "handshake": bool(octets[0] & HANDSHAKE),
            "index": f"{index:04X}h",
            "subindex": subindex,
            "value": value,
            "name": t.name_of(index),
        }
        text = f"{what} {t.name_of(index)}:{subindex}"
        if not order and octets[0] & RESULT:
            code = t.Code(octets[4], octets[5], int.from_bytes(octets[6:8], "big"))
            found["error"] = f"error {code}, {t.ERRORS.get(code, 'an error without a text in the manual')}"
            return found | {"text": f"{text}: {found['error']}"}
        carries = service == (WRITE if order else READ)
        return found | {"text": f"{text} = {value}" if carries else text}

    def step(self, inputs: bytes, now: int) -> None:
        """One cycle: judge the confirmation of the request under way; without one send the next, handshake inverted."""
        shown = inputs[0] & HANDSHAKE
        active = self._active
        if active is not None and shown == self._shown:
            if inputs[1:4] == active.octets[1:4]:
                active.reply = inputs[:CHANNEL_LEN]
                self._active = None
            else:
                active.stray = inputs[:CHANNEL_LEN]
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

    # -- orders ---------------------------------------------------------------------------------------------------

    def read(self, key: ParamKey, deadline: int) -> Steps[dict[str, object]]:
        target = find(key)
        return _outcome(target, (yield from self.get(target, deadline)))

    def write(self, key: ParamKey, value: float, deadline: int) -> Steps[dict[str, object]]:
        """Write one parameter; the integer on the wire if the manual shows no scale."""
        target = find(key)
        scale, unit = target.scale
        raw = int(value) if scale == 1 else _count(target.label, value, scale, unit)
        if (scale == 1 and raw != value) or not -(1 << 31) <= raw < 1 << 32:
            hint = (
                f"a number in {unit}" if unit else "the integer on the wire (32 bits): its scale is not in the manual"
            )
            raise CommandError("usage", f"{target.label}: give {hint}")
        yield from self.put(target, raw, deadline)
        return _outcome(target, raw & 0xFFFF_FFFF)

    def get(self, target: Target, deadline: int) -> Steps[int]:
        """The 32 bits of a parameter."""
        data = yield from self._exchange(READ | _FOUR, target, 0, deadline)
        return int.from_bytes(data, "big")

    def put(self, target: Target, raw: int, deadline: int) -> Steps[None]:
        """Write the low 32 bits of ``raw``."""
        spec = t.PARAMETERS.get(target.index)
        self._stored_writes.admit((target.index, target.subindex), target.label, self._times.now, spec)
        yield from self._exchange(WRITE | _FOUR, target, raw, deadline)

    def _exchange(self, service: int, target: Target, raw: int, deadline: int) -> Steps[bytes]:
        octets = bytes([service, target.subindex]) + target.index.to_bytes(2, "big")
        octets += (raw & 0xFFFF_FFFF).to_bytes(4, "big")
        while True:
            reply = yield from self._confirmed(_Request(octets, target.label), deadline)
            if not reply[0] & RESULT:
                return reply[4:]
            code = t.Code(reply[4], reply[5], int.from_bytes(reply[6:8], "big"))
            again = self._times.now + RETRY_NS
            if code != t.BUSY or again >= deadline:
                text = t.ERRORS.get(code, "an error without a text in the manual")
                raise CommandError("parameter", f"{target.label}: error {code}, {text}", code.number)
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


def _outcome(target: Target, raw: int) -> dict[str, object]:
    """Values are signed 32 bits."""
    scale, unit = target.scale
    signed = (raw ^ 0x8000_0000) - 0x8000_0000
    return {
        "value": signed if scale == 1 else signed / scale,
        "raw": signed,
        "number": target.index,
        "name": t.name_of(target.index),
        "unit": unit,
        "data_set": target.data_set,
    }


class RefusedError(Exception):
    """A request that ends with an error."""

    def __init__(self, code: t.Code) -> None:
        super().__init__(str(code))
        self.code = code


class KebServer:
    """The drive's end. ``handler(write, index, subindex, raw)``: raw None for a read -> the value and its octets.

    ``raw`` and the value are unsigned 32 bits; of a shorter write only its octets, ``octets`` says how many.
    Readings: a read answers with 4 octets when the request's length is 4, otherwise with the parameter's own; the
    confirmation's length bits are 0 as in the manual's example.
    """

    __slots__ = ("_handler", "_reply", "_shown", "requests")

    def __init__(self, handler: Callable[[int, int, int | None, int], tuple[int, int]]) -> None:
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
        service = octets[0] & (READ | WRITE)
        head = bytes([octets[0] & (HANDSHAKE | READ | WRITE)]) + octets[1:4]
        if not service:
            return head + bytes(4)
        self.requests += 1
        length = (octets[0] >> 4 & 3) + 1
        index = int.from_bytes(octets[2:4], "big")
        try:
            if service == READ | WRITE:
                raise RefusedError(t.READ_AND_WRITE)
            if service == WRITE:
                self._handler(index, octets[1], int.from_bytes(octets[4 : 4 + length], "big"), length)
                return head + octets[4:]
            raw, own = self._handler(index, octets[1], None, length)
        except RefusedError as refused:
            code = refused.code
            return bytes([head[0] | RESULT]) + head[1:] + bytes([code.kind, code.code]) + code.more.to_bytes(2, "big")
        size = 4 if length == 4 else own
        return head + (raw & (1 << 8 * size) - 1).to_bytes(size, "big") + bytes(4 - size)
