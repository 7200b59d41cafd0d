"""Splits any number of parameters into requests within the drive's limits and joins the results.

Source: PNU 974 (Yaskawa Sigma-7 manual p529): longest block, parameters of one request, latency.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from dpstack.errors import PduError
from dpstack.profile.record47.formats import ZERO, format_of
from dpstack.profile.record47.pdu import (
    ADDRESS_LEN,
    HEADER_LEN,
    MAX_ELEMENTS,
    MAX_OCTETS,
    MAX_PARAMETERS,
    VALUE_HEADER_LEN,
    Address,
    ErrorValue,
    Result,
    Values,
)
from dpstack.units import NS_PER_MS

#: octets of one value of an unknown format
_WIDTH: Final = 4
_LATENCY_UNIT: Final = 10 * NS_PER_MS
#: the shortest block of a drive: a request and an answer for one parameter of one double word
_LEAST_OCTETS: Final = HEADER_LEN + ADDRESS_LEN + VALUE_HEADER_LEN + _WIDTH


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of one request and its response. ``octets``: of either; ``elements`` of an array.

    ``latency_ns``: the longest time from request to response, 0: unknown.
    """

    octets: int = MAX_OCTETS
    parameters: int = MAX_PARAMETERS
    elements: int = MAX_ELEMENTS
    latency_ns: int = 0

    def of_974(self, words: Sequence[int]) -> Limits:
        """These limits narrowed by PNU 974: octets, parameters, latency in 10 ms; impossible values are ignored."""
        octets, parameters, latency = (*words, 0, 0, 0)[:3]
        return Limits(
            min(self.octets, octets) if octets >= _LEAST_OCTETS else self.octets,
            min(self.parameters, parameters) if parameters else self.parameters,
            self.elements,
            latency * _LATENCY_UNIT or self.latency_ns,
        )


class Item(NamedTuple):
    """One parameter to read or write. ``values``: those to write. ``width``: octets of one value to read."""

    address: Address
    values: Values | None = None
    width: int = _WIDTH


class Piece(NamedTuple):
    """A part of the item number ``of`` that fits into one request."""

    of: int
    address: Address
    values: Values | None
    width: int

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


def pieces(items: Iterable[Item], limits: Limits) -> Iterator[Piece]:
    """Split the items: arrays that are too long become several pieces."""
    for of, item in enumerate(items):
        address, values = item.address, item.values
        if values is not None and format_of(values.format).string:
            yield Piece(of, address, values, item.width)
            continue
        width = item.width if values is None else format_of(values.format).octets
        room = limits.octets - HEADER_LEN - VALUE_HEADER_LEN - (0 if values is None else ADDRESS_LEN)
        most = max(min((room & ~1) // max(width, 1), limits.elements), 1)
        if address.elements <= most:
            yield Piece(of, address, values, width)
            continue
        for at in range(0, address.elements, most):
            yield _part(Piece(of, address, values, width), at, min(most, address.elements - at))


def _part(piece: Piece, at: int, count: int) -> Piece:
    """``count`` elements of a piece from its element ``at`` on."""
    address, values = piece.address, piece.values
    return piece._replace(
        address=address._replace(subindex=address.subindex + at, elements=count),
        values=None if values is None else Values(values.format, values.raws[at : at + count]),
    )


def halves(piece: Piece) -> tuple[Piece, Piece] | None:
    """A piece of an array in two; None where it is one value."""
    address, values = piece.address, piece.values
    if address.elements < 2 or (values is not None and len(values.raws) < 2):
        return None
    first = address.elements // 2
    return _part(piece, 0, first), _part(piece, first, address.elements - first)


def batch(waiting: Sequence[Piece], limits: Limits) -> int:
    """How many of ``waiting`` fit into one request, at least one."""
    request = response = HEADER_LEN
    for count, piece in enumerate(waiting):
        request += piece.request_octets
        response += piece.response_octets
        if count and (count >= limits.parameters or request > limits.octets or response > limits.octets):
            return count
    return len(waiting)


def joined(count: int, answers: Iterable[tuple[Piece, Result]]) -> list[Result]:
    """One result for each of ``count`` items from those of the pieces, which are in the order of their subindexes.

    An item with a piece that failed has failed. Raises PduError where the pieces of one came in different formats.
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
