"""Limits (PNU 974), parameter list (980 to 989), descriptions and texts of a drive, read over record 47.

Sources: PNU 974, Yaskawa Sigma-7 manual p529; the elements of a description, VACON OPT-EA manual p118 and Siemens
SIDOOR manual p316. That 0 ends a list and that 981 to 989 among its elements are its continuation is a reading.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Final, NamedTuple

from msgspec import structs

from dpstack.errors import PduError
from dpstack.profile.model.jobs import CommandError
from dpstack.profile.model.param_errors import BAD_ADDRESS, BAD_SUBINDEX, ILLEGAL_NUMBER, NO_ARRAY, TOO_LONG, error_text
from dpstack.profile.record47 import formats
from dpstack.profile.record47.client import Item, ParameterClient, Progress
from dpstack.profile.record47.formats import FORMATS, UNSIGNED16, Format, Value, format_of
from dpstack.profile.record47.pdu import Address, Attribute, ErrorValue, Limits, Result, Transport, Values
from dpstack.units import NEVER, NS_PER_S

PNU_LIMITS: Final = 974
FIRST_LIST, LAST_LIST = 980, 989
TEXT_LEN: Final = 16
#: time-out for the question of the drive's latency
_UNKNOWN_LATENCY: Final = 5 * NS_PER_S
#: elements of one list in a request: as many words as fit into a response
_AT_ONCE: Final = 116
#: subindexes: an array of a drive that always has one more element ends here
_SUBINDEXES: Final = 1 << 16
#: errors of a drive for an element behind the last one
_END: Final = frozenset({BAD_SUBINDEX, BAD_ADDRESS})
#: a description: ID, elements, factor, attribute, reserved, name, low, high, reserved, ID extension, two of the scale
_DESCRIPTION: Final = struct.Struct(">HHfH4x16s4s4s2xHHH")
DESCRIPTION_LEN: Final = _DESCRIPTION.size
#: the elements of a description by subindex, 1 to 12: format and octets (Danfoss VLT manual MG.33.C4 p51, VACON p118)
_ELEMENTS: Final = (
    (UNSIGNED16, 2),  # identifier
    (UNSIGNED16, 2),  # number of array elements
    (formats.FLOAT, 4),  # standardisation factor
    (formats.OCTET_STRING, 2),  # variable attribute
    (formats.OCTET_STRING, 4),
    (formats.VISIBLE_STRING, TEXT_LEN),  # name
    (formats.OCTET_STRING, 4),  # low limit
    (formats.OCTET_STRING, 4),  # high limit
    (formats.OCTET_STRING, 2),
    (UNSIGNED16, 2),  # ID extension
    (UNSIGNED16, 2),  # reference parameter of the normalisation
    (UNSIGNED16, 2),  # its bit
)
#: substitute formats, which do not define the meaning of a value
_PLAIN: Final = frozenset({formats.BYTE, formats.WORD, formats.DOUBLE_WORD})

READ_ONLY_BIT, TEXT_BIT, ARRAY_BIT = 9, 10, 14


class Description(NamedTuple):
    """The drive's description of a parameter. ``format``: its data type; ``elements``: 1 for one that is no array.

    ``factor`` and ``attribute`` (quantity and conversion) as on the wire; ``low`` and ``high``: four octets each.
    """

    format: int
    elements: int
    name: str
    read_only: bool
    array: bool
    text: bool
    factor: float
    attribute: int
    low: bytes
    high: bytes

    @classmethod
    def parse(cls, octets: bytes) -> Description:
        """Read a whole description, 46 octets. Raises PduError."""
        if len(octets) < DESCRIPTION_LEN:
            raise PduError(f"a description has {DESCRIPTION_LEN} octets, there are {len(octets)}")
        ident, elements, factor, attribute, name, low, high, *_ = _DESCRIPTION.unpack_from(octets)
        return cls(
            ident & 0xFF,
            max(elements, 1),
            name.decode("latin-1").rstrip("\0 "),
            bool(ident >> READ_ONLY_BIT & 1),
            bool(ident >> ARRAY_BIT & 1),
            bool(ident >> TEXT_BIT & 1),
            factor,
            attribute,
            low,
            high,
        )

    def element(self, subindex: int) -> Values | None:
        """Element 1 to 12 of the description; None for another number."""
        if not 1 <= subindex <= len(_ELEMENTS):
            return None
        number, size = _ELEMENTS[subindex - 1]
        at = sum(octets for _, octets in _ELEMENTS[: subindex - 1])
        return Values(number, FORMATS[number].unpack(self.build()[at : at + size]))

    def build(self) -> bytes:
        ident = self.format | self.read_only << READ_ONLY_BIT | self.array << ARRAY_BIT | self.text << TEXT_BIT
        name = self.name.encode("latin-1", "replace")[:16].ljust(16)
        return _DESCRIPTION.pack(ident, self.elements, self.factor, self.attribute, name, self.low, self.high, 0, 0, 0)


class ReadParameter(NamedTuple):
    """A parameter of the drive's own list: its description if it has one, its values or the error."""

    pnu: int
    description: Description | None
    result: Result

    @property
    def format(self) -> Format | None:
        """The format of its values; None if it was refused.

        It is the described one if the answer has plain bytes, words or double words, else the answer's.
        """
        if isinstance(self.result, ErrorValue):
            return None
        answered = format_of(self.result.format)
        described = None if self.description is None else FORMATS.get(self.description.format)
        as_described = answered.number in _PLAIN and described is not None and described.octets == answered.octets
        return described if as_described else answered

    @property
    def values(self) -> tuple[Value, ...]:
        """The values for people; none if it was refused."""
        form = self.format
        if form is None or isinstance(self.result, ErrorValue):
            return ()
        octets = format_of(self.result.format).repack(self.result.raws)
        return tuple(form.value(raw) for raw in form.unpack(octets)) if octets else ()

    @property
    def why_not(self) -> str | None:
        return error_text(*self.result) if isinstance(self.result, ErrorValue) else None


def read_limits(client: ParameterClient, deadline: int = NEVER) -> Transport[Limits]:
    """Read PNU 974 and set the client's limits; a drive without it keeps the limits. Raises CommandError."""
    limits = client.limits
    # the drive may take as long for this request
    client.limits = structs.replace(limits, latency_ns=max(limits.latency_ns, _UNKNOWN_LATENCY))
    try:
        (found,) = yield from client.read([Item(Address(PNU_LIMITS, 0, 3), width=2)], deadline)
    finally:
        client.limits = limits
    if isinstance(found, Values):
        client.limits = limits.of_974([one for one in found.raws if isinstance(one, int)])
    return client.limits


def defined(client: ParameterClient, deadline: int = NEVER) -> Transport[list[int]]:
    """The numbers in 980 to 989 without these themselves, each once, in the drive's order.

    Raises CommandError if it has no such list.
    """
    pending, seen = [FIRST_LIST], {FIRST_LIST}
    found: dict[int, None] = {}
    while pending:
        listing = pending.pop(0)
        for pnu in (yield from _list(client, listing, deadline)):
            if not FIRST_LIST <= pnu <= LAST_LIST:
                found[pnu] = None
            elif pnu not in seen:
                seen.add(pnu)
                pending.append(pnu)
    return list(found)


def _list(client: ParameterClient, pnu: int, deadline: int) -> Transport[list[int]]:
    """Read a list up to its 0, or to its end if it has none."""
    found: list[int] = []
    (listing,) = yield from describe(client, [pnu], deadline)
    length = listing.elements if listing is not None and listing.array else None
    count = _AT_ONCE
    while count:
        if length is not None:
            count = min(_AT_ONCE, length - len(found))
        count = min(count, _SUBINDEXES - len(found))
        if count <= 0:
            break
        (part,) = yield from client.read([Item(Address(pnu, len(found), count), width=2)], deadline)
        if isinstance(part, ErrorValue):
            if (not found and part.number in (ILLEGAL_NUMBER, NO_ARRAY)) or part.number not in _END:
                missing = pnu == FIRST_LIST and part.number in (ILLEGAL_NUMBER, NO_ARRAY)
                todo = "; it has no list of its parameters: read them by number" if missing else ""
                raise CommandError("parameter", f"parameter {pnu}: {error_text(*part)}{todo}", part.number)
            length = None
            count //= 2  # more elements than the list has: the last ones by halves
            continue
        numbers = [one for one in part.raws if isinstance(one, int)]
        if 0 in numbers:
            return found + numbers[: numbers.index(0)]
        found += numbers
        if len(numbers) < count:
            break
    return found


def describe(
    client: ParameterClient, pnus: Sequence[int], deadline: int = NEVER, progress: Progress | None = None
) -> Transport[list[Description | None]]:
    """The descriptions, None if the drive has none. Raises CommandError."""
    items = [Item(Address(pnu, 0, 1, Attribute.DESCRIPTION), width=DESCRIPTION_LEN) for pnu in pnus]
    found = yield from client.read(items, deadline, progress)
    described: list[Description | None] = []
    for pnu, one in zip(pnus, found, strict=True):
        too_long = isinstance(one, ErrorValue) and one.number == TOO_LONG
        described.append((yield from _by_elements(client, pnu, deadline)) if too_long else _description(one))
    return described


def _by_elements(client: ParameterClient, pnu: int, deadline: int) -> Transport[Description | None]:
    """A description that is longer than the drive's blocks, element by element; those it does not have are zeros."""
    items = [
        Item(Address(pnu, subindex, 1, Attribute.DESCRIPTION), width=size)
        for subindex, (_, size) in enumerate(_ELEMENTS, 1)
    ]
    found = yield from client.read(items, deadline)
    octets = b""
    for one, (_, size) in zip(found, _ELEMENTS, strict=True):
        part = b"" if isinstance(one, ErrorValue) else format_of(one.format).repack(one.raws)
        octets += part if len(part) == size else bytes(size)
    return None if isinstance(found[0], ErrorValue) else Description.parse(octets)


def _description(result: Result) -> Description | None:
    if isinstance(result, ErrorValue):
        return None
    try:
        return Description.parse(FORMATS[result.format].repack(result.raws))
    except PduError:
        return None


def texts(
    client: ParameterClient, pnu: int, count: int, deadline: int = NEVER, *, first: int = 0
) -> Transport[list[str]]:
    """``count`` texts of 16 characters from ``first`` on, without trailing spaces. Raises CommandError.

    A drive may give only one text for an address (Siemens' sample of a profile 4.2 drive): one address for each then.
    """
    whole = Address(pnu, first, count, Attribute.TEXT)
    found = yield from client.read([Item(whole, width=TEXT_LEN)], deadline)
    if count > 1 and _is_short(found[0], count):
        singly = [Item(whole._replace(subindex=at, elements=1), width=TEXT_LEN) for at in range(first, first + count)]
        found = yield from client.read(singly, deadline)
    octets = b""
    for one in found:
        if isinstance(one, ErrorValue):
            raise CommandError("parameter", f"texts of parameter {pnu}: {error_text(*one)}", one.number)
        octets += format_of(one.format).repack(one.raws)
    return [octets[at : at + TEXT_LEN].decode("latin-1").rstrip("\0 ") for at in range(0, count * TEXT_LEN, TEXT_LEN)]


def _is_short(result: Result, count: int) -> bool:
    if isinstance(result, ErrorValue):
        return result.number == BAD_ADDRESS
    return len(format_of(result.format).repack(result.raws)) < count * TEXT_LEN


def read_out(
    client: ParameterClient,
    deadline: int = NEVER,
    progress: Progress | None = None,
    *,
    described: bool = True,
    describing: Progress | None = None,
) -> Transport[list[ReadParameter]]:
    """Every parameter of the drive's list with its values, arrays whole (also if nothing is described).

    Raises CommandError.

    ``progress`` counts values, ``describing`` the descriptions before them. ``described`` False: no descriptions, so
    of arrays only the first element.
    """
    pnus = yield from defined(client, deadline)
    descriptions: list[Description | None] = [None] * len(pnus)
    if described:
        descriptions = yield from describe(client, pnus, deadline, describing)
    items = [item_of(pnu, one) for pnu, one in zip(pnus, descriptions, strict=True)]
    results = yield from client.read(items, deadline, progress)
    found = [ReadParameter(*one) for one in zip(pnus, descriptions, results, strict=True)]
    if described:
        yield from _find_arrays(client, found, deadline)
    return found


def _find_arrays(client: ParameterClient, found: list[ReadParameter], deadline: int) -> Transport[None]:
    """Read arrays without a description: those with a second element, but without the highest subindex."""
    missing = [at for at, one in enumerate(found) if one.description is None and _is_number(one.result)]
    probes = [Address(found[at].pnu, subindex, 1) for at in missing for subindex in (1, 0xFFFF)]
    answers = yield from client.read(probes, deadline)
    for at, second, last in zip(missing, answers[::2], answers[1::2], strict=True):
        if isinstance(second, Values) and isinstance(last, ErrorValue):
            found[at] = found[at]._replace(result=(yield from _array(client, found[at], deadline)))


def _is_number(result: Result) -> bool:
    return isinstance(result, Values) and bool(result.raws) and not format_of(result.format).string


def _array(client: ParameterClient, first: ReadParameter, deadline: int) -> Transport[Result]:
    """All elements, up to the drive's error for the next one."""
    assert isinstance(first.result, Values)
    form, raws, count = first.result.format, first.result.raws, _AT_ONCE
    while (count := min(count, _SUBINDEXES - len(raws))) > 0:
        item = Item(Address(first.pnu, len(raws), count), width=format_of(form).octets)
        (part,) = yield from client.read([item], deadline)
        if not isinstance(part, Values) or part.format != form:
            count //= 2
            continue
        raws += part.raws
        if len(part.raws) < count:
            break
    return Values(form, raws)


def item_of(pnu: int, description: Description | None) -> Item:
    """What to read of a parameter: an array or a string whole, if its description is known."""
    if description is None:
        return Item(Address(pnu))
    form = FORMATS.get(description.format)
    elements = description.elements if description.array or (form is not None and form.string) else 0
    return Item(Address(pnu, 0, elements), width=4 if form is None else max(form.octets, 1))
