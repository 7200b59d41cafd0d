"""The master's end of record 47: a Write, then Reads until the drive has its response ready; requests one by one.

It splits any number of parameters into requests within the drive's limits and joins the results.

Source: PROFIdrive base mode as SINAMICS, ABB and LS print it; "not ready" is the negative answer 0xB5 (LS 6.2.2). A
drive of profile 4.2 answers request ids that it does not have with 0x80 (Siemens' sample of such a drive).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Final, NamedTuple

from msgspec import Struct

from dpstack.dpv1.pdu.error_codes import AGAIN, Code
from dpstack.dpv1.pdu.read_write import ReadReq, WriteReq
from dpstack.errors import PduError
from dpstack.profile.model.jobs import CommandError
from dpstack.profile.model.param_errors import NO_SERVICE, ONE_ONLY, TOO_LONG, TOO_MANY
from dpstack.profile.record47.formats import ZERO, format_of
from dpstack.profile.record47.pdu import (
    ABSENT,
    ADDRESS_LEN,
    HEADER_LEN,
    INDEX,
    UNSUPPORTED,
    VALUE_HEADER_LEN,
    Address,
    ErrorValue,
    Limits,
    Pause,
    Refused,
    Request,
    RequestId,
    Response,
    Result,
    Silent,
    Transport,
    Values,
)
from dpstack.units import NEVER, NS_PER_MS, NS_PER_S

#: octets of one value of an unknown format
_WIDTH: Final = 4
#: between two Reads for the response: short first, then twice as long each time
_FIRST_PAUSE: Final = 2 * NS_PER_MS
_LONGEST_PAUSE: Final = 50 * NS_PER_MS
#: time-out of one request if the drive does not give one (PNU 974)
PATIENCE_NS: Final = 2 * NS_PER_S

#: attempts at a Write of a read request without any answer; a change is sent once, as twice may have an effect
_ATTEMPTS: Final = 3

#: errors after which a smaller request may succeed
_ASK_LESS: Final = frozenset({TOO_LONG, TOO_MANY, ONE_ONLY})

#: references of the plugin's requests and of a program's: each recognises the responses of the other
PLUGIN: Final = range(1, 128)
PROGRAM: Final = range(128, 256)

#: called after each request: number of items that are done, number of all items
Progress = Callable[[int, int], None]


class NoRecordError(CommandError):
    """The drive has no record 47, or not in this slot."""


class Counters(Struct):
    """``requests`` of record 47; ``services`` (Read and Write) and ``octets`` of their data, both ways.

    ``busy``: negative answers that were asked again; ``strays``: responses to another request; ``garbage``: records
    that are no response; ``split``: requests that were made smaller because the drive wanted it;
    ``repeated``: services that had no answer.
    """

    requests: int = 0
    services: int = 0
    octets: int = 0
    busy: int = 0
    strays: int = 0
    garbage: int = 0
    split: int = 0
    repeated: int = 0


class ParameterClient:
    """Reads and writes parameters of the drive in ``slot`` (object ``object``), one transport at a time.

    ``limits`` may be narrowed at any time, see :func:`~dpstack.profile.record47.param_lists.read_limits`.
    ``references``: those of this client; a response with another one means that this drive has another client, too.
    """

    __slots__ = ("_reference", "_references", "counters", "limits", "object", "slot")

    def __init__(
        self, slot: int, *, object: int = 1, limits: Limits | None = None, references: range = range(1, 256)
    ) -> None:
        self.slot = slot
        self.object = object
        self.limits = Limits() if limits is None else limits
        self.counters = Counters()
        self.use_references(references)

    def use_references(self, references: range) -> None:
        """The references of the requests from now on."""
        self._references = references
        self._reference = references.start

    # -- any number of parameters -----------------------------------------------------------------------------------

    def read(
        self, items: Sequence[Address | Item], deadline: int = NEVER, progress: Progress | None = None
    ) -> Transport[list[Result]]:
        """A result for each of ``items``, in their order. ``deadline`` in ns. Raises CommandError.

        A parameter that the drive refuses has an :class:`ErrorValue` in its place.
        """
        wanted = [one if isinstance(one, Item) else Item(one) for one in items]
        return (yield from self._all(RequestId.READ, wanted, deadline, progress))

    def change(
        self, items: Sequence[tuple[Address, Values]], deadline: int = NEVER, progress: Progress | None = None
    ) -> Transport[list[Result]]:
        """Write; a result for each, Values of format Zero if the drive took it. Raises CommandError, ValueError."""
        for address, values in items:
            if address.elements and len(values.raws) != address.elements:
                raise ValueError(f"{address}: {len(values.raws)} values for {address.elements} elements")
        wanted = [Item(address, values) for address, values in items]
        return (yield from self._all(RequestId.CHANGE, wanted, deadline, progress))

    def _all(
        self, ident: RequestId, items: list[Item], deadline: int, progress: Progress | None
    ) -> Transport[list[Result]]:
        waiting = list(_pieces(items, self.limits))
        most = self.limits.parameters
        done: list[tuple[Item, Result]] = []
        while waiting:
            count = min(_batch_size(waiting, self.limits), most)
            now, waiting = waiting[:count], waiting[count:]
            results = yield from self._batch(ident, now, deadline)
            if results is None:  # too long to be written
                most = max(count // 2, 1)
                waiting = now + waiting
                continue
            again: list[Item] = []
            for piece, result in zip(now, results, strict=True):
                parts = self._smaller(piece, result, alone=count == 1)
                if parts:
                    again.extend(parts)
                    most = 1 if isinstance(result, ErrorValue) and result.number == ONE_ONLY else max(count // 2, 1)
                else:
                    done.append((piece, result))
            waiting = again + waiting
            if progress is not None:
                progress(waiting[0].of if waiting else len(items), len(items))
        try:
            return _joined(len(items), sorted(done, key=_order))
        except PduError as error:
            raise CommandError("parameter", str(error)) from None

    def _smaller(self, piece: Item, result: Result, *, alone: bool) -> tuple[Item, ...]:
        """The pieces to ask for if the response is too long (0x15), or the request has too many parameters.

        They are the piece alone, then its halves if that is too long.
        """
        if (
            not isinstance(result, ErrorValue)
            or result.number not in _ASK_LESS
            or (alone and result.number != TOO_LONG)
        ):
            return ()
        self.counters.split += 1
        return (_halves(piece) or ()) if alone else (piece,)

    def _batch(self, ident: RequestId, now: list[Item], deadline: int) -> Transport[list[Result] | None]:
        """The results of one request; None if it is too long for the drive."""
        values = tuple(one.values for one in now if one.values is not None)
        request = Request(self._next(), ident, self.object, tuple(one.address for one in now), values)
        octets = request.build()
        response = yield from self.exchange(request, octets, deadline)
        if response is None:
            if len(now) > 1:
                self.counters.split += 1
                return None
            raise CommandError("parameter", f"the drive does not take a request of {len(octets)} octets")
        return self._results(request, response)

    def _next(self) -> int:
        """The next reference: each request has another one, so that a late response is recognised."""
        reference, ours = self._reference, self._references
        self._reference = reference + 1 if reference + 1 in ours else ours.start
        return reference

    @staticmethod
    def _results(request: Request, response: Response) -> list[Result]:
        """The results, one for each address. Raises CommandError for any other answer."""
        count = len(request.addresses)
        results = response.results
        if response.id == UNSUPPORTED:
            error = next((one for one in results if isinstance(one, ErrorValue)), ErrorValue(NO_SERVICE))
            return [error] * count
        if not response.negative and request.id == RequestId.CHANGE:
            return [Values(ZERO)] * count
        if response.negative and len(results) == 1 and isinstance(results[0], ErrorValue):
            return [results[0]] * count  # one error for the request as a whole
        if len(results) != count:
            raise CommandError("parameter", f"the drive answered {len(results)} of {count} parameters")
        return list(results)

    # -- one request --------------------------------------------------------------------------------------------------

    def exchange(self, request: Request, octets: bytes, deadline: int = NEVER) -> Transport[Response | None]:
        """The response to ``request`` (built: ``octets``); None if the request is too long for the drive.

        Raises CommandError: ``timeout`` after ``deadline`` (ns) or the drive's patience, ``parameter`` for a refusal.
        """
        self.counters.requests += 1
        reads = request.id == RequestId.READ
        attempts = _ATTEMPTS if reads else 1
        now = yield from self._written(octets, deadline, attempts, several=len(request.addresses) > 1)
        if now is None:
            return None
        patience = self._patience
        until = min(deadline, now + patience)
        # after the loss of a response's telegram the drive answers "not ready" for ever
        lost_at = now + patience // 2 if reads else NEVER
        reason = f"the drive did not answer within {patience // NS_PER_MS} ms"
        reason += "" if reads else "; it may have been carried out: read it back"
        pause = _FIRST_PAUSE
        while True:
            now, data = yield from self._service(ReadReq(self.slot, INDEX, self.limits.octets))
            if isinstance(data, Refused):
                self._again(data, "the response")
                if now >= lost_at:
                    lost_at = NEVER
                    now, data = yield from self._service(WriteReq(self.slot, INDEX, octets), attempts)
                    if not isinstance(data, Refused):  # else the drive is still busy with it
                        self.counters.repeated += 1
                        until, pause = min(deadline, now + patience), _FIRST_PAUSE
            else:
                response, why = self._fitting(request, data)
                if response is not None:
                    return response
                reason = why
                if request.id == RequestId.READ and data and data[0] not in self._references:
                    yield from self._written(octets, deadline, attempts)  # the other request has replaced ours
            if now >= until:
                raise CommandError("timeout", f"{self._place}: {reason}")
            yield Pause(min(pause, until - now))
            pause = min(2 * pause, _LONGEST_PAUSE)

    @property
    def _patience(self) -> int:
        return max(2 * self.limits.latency_ns, PATIENCE_NS)

    def _written(self, octets: bytes, deadline: int, attempts: int, *, several: bool = False) -> Transport[int | None]:
        """When the drive accepted the request; None if it is too long, or has too many parameters (``several``)."""
        until: int | None = None
        pause = _FIRST_PAUSE
        while True:
            now, data = yield from self._service(WriteReq(self.slot, INDEX, octets), attempts)
            if not isinstance(data, Refused):
                return now
            if data.code == Code.WRITE_LENGTH_ERROR or (several and data.code == Code.INVALID_RANGE):
                return None
            self._again(data, "the request")
            until = min(deadline, now + self._patience) if until is None else until
            if now >= until:
                raise CommandError("timeout", f"{self._place}: the drive is still busy ({data})", data.code)
            yield Pause(min(pause, until - now))
            pause = min(2 * pause, _LONGEST_PAUSE)

    def _service(self, service: WriteReq | ReadReq, attempts: int = 1) -> Transport[tuple[int, bytes | Refused]]:
        """Time and answer. Raises CommandError after ``attempts`` without an answer."""
        while True:
            now, data = yield service
            attempts -= 1
            self.counters.services += 1
            self.counters.octets += len(service.data) if isinstance(service, WriteReq) else 0
            if not isinstance(data, Silent):
                break
            if not attempts:
                raise CommandError("timeout", data.why)
            self.counters.repeated += 1
        self.counters.octets += 0 if isinstance(data, Refused) else len(data)
        return now, data

    def _again(self, refused: Refused, what: str) -> None:
        """Count a temporary refusal; raise CommandError for any other one."""
        if refused.code not in AGAIN:
            text = f"{self._place}: the drive refuses {what}: {refused}"
            if refused.code in ABSENT:
                if refused.code:  # if none exists the text says itself what to do
                    text += (
                        "; it has no PROFIdrive parameters there; its manual says whether it has some, in which slot"
                    )
                raise NoRecordError("parameter", text, refused.code)
            raise CommandError("parameter", text, refused.code)
        self.counters.busy += 1

    @property
    def _place(self) -> str:
        return f"record {INDEX} of slot {self.slot}"

    def _fitting(self, request: Request, octets: bytes) -> tuple[Response | None, str]:
        """The response, or why ``octets`` answer no ``request``. The object is not checked: some drives answer 1."""
        try:
            response = Response.parse(octets)
        except PduError as error:
            if octets[:1] == bytes((request.reference,)):
                raise CommandError("parameter", f"{self._place}: {error}") from None
            self.counters.garbage += 1
            return None, str(error)
        if response.reference != request.reference or response.id not in (request.id, UNSUPPORTED):
            self.counters.strays += 1
            return None, f"the drive answers request {response.reference} (id {response.id}) instead of ours"
        return response, ""


def _order(answer: tuple[Item, Result]) -> tuple[int, int]:
    return answer[0].of, answer[0].address.subindex


# --- requests within the limits of the drive ---
class Item(NamedTuple):
    """A parameter to read or write. ``values``: those to write. ``width``: octets of one value to read.

    The client splits long arrays into pieces, which are items too; ``of``: place of the whole in the caller's list.
    """

    address: Address
    values: Values | None = None
    width: int = _WIDTH
    of: int = 0

    @property
    def request_octets(self) -> int:
        return ADDRESS_LEN + (0 if self.values is None else self.values.octets)

    @property
    def response_octets(self) -> int:
        """Most octets in a response; after a change that failed in part an error with its subindex."""
        if self.values is not None:
            return VALUE_HEADER_LEN + 4
        octets = max(self.address.elements, 1) * self.width
        return VALUE_HEADER_LEN + max(octets + (octets & 1), 4)


def _pieces(items: Iterable[Item], limits: Limits) -> Iterator[Item]:
    """Split the items: arrays that are too long become several pieces."""
    for of, item in enumerate(items):
        address, values = item.address, item.values
        if values is not None and format_of(values.format).string:
            yield item._replace(of=of)
            continue
        width = item.width if values is None else format_of(values.format).octets
        room = limits.octets - HEADER_LEN - VALUE_HEADER_LEN - (0 if values is None else ADDRESS_LEN)
        most = max(min((room & ~1) // max(width, 1), limits.elements), 1)
        piece = item._replace(width=width, of=of)
        if address.elements <= most:
            yield piece
            continue
        for at in range(0, address.elements, most):
            yield _part(piece, at, min(most, address.elements - at))


def _part(piece: Item, at: int, count: int) -> Item:
    """``count`` elements of a piece from its element ``at`` on."""
    address, values = piece.address, piece.values
    return piece._replace(
        address=address._replace(subindex=address.subindex + at, elements=count),
        values=None if values is None else Values(values.format, values.raws[at : at + count]),
    )


def _halves(piece: Item) -> tuple[Item, Item] | None:
    """A piece of an array in two; None if it is one value."""
    address, values = piece.address, piece.values
    if address.elements < 2 or (values is not None and len(values.raws) < 2):
        return None
    first = address.elements // 2
    return _part(piece, 0, first), _part(piece, first, address.elements - first)


def _batch_size(waiting: Sequence[Item], limits: Limits) -> int:
    """The number of items of ``waiting`` that fit into one request, at least one."""
    request = response = HEADER_LEN
    for count, piece in enumerate(waiting):
        request += piece.request_octets
        response += piece.response_octets
        if count and (count >= limits.parameters or request > limits.octets or response > limits.octets):
            return count
    return len(waiting)


def _joined(count: int, answers: Iterable[tuple[Item, Result]]) -> list[Result]:
    """The result of each of ``count`` items, joined from those of its pieces in the order of subindexes.

    An item with a piece that failed has failed. Raises PduError if the pieces of one came in different formats.
    """
    found: list[Result | None] = [None] * count
    for piece, result in answers:
        before = found[piece.of]
        if before is None or (isinstance(result, ErrorValue) and isinstance(before, Values)):
            found[piece.of] = result
        elif isinstance(before, Values) and isinstance(result, Values):
            if before.format != result.format:
                raise PduError(f"{piece.address} came in format {result.format:#x}, before it in {before.format:#x}")
            found[piece.of] = Values(result.format, before.raws + result.raws)
    return [Values(ZERO) if one is None else one for one in found]
