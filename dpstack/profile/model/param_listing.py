"""List of a drive's parameters for a dump: every index and data set, and why a parameter cannot be read."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

from dpstack.profile.model.params import ParamSpec, ParamTable


@dataclass(frozen=True, slots=True, kw_only=True)
class ListedParam:
    """One line of the list; ``name``, ``data_set`` and ``index`` are the arguments of the read.

    ``number`` and ``subindex`` are what the table declares. ``why_not``: why it cannot be read, for people.
    ``per_unit``: counts on the wire that make 1 in ``unit``, 0 where it is not known.
    """

    name: str
    number: int
    title: str
    subindex: int = 0
    data_set: int | None = None
    index: int | None = None
    unit: str = ""
    read_only: bool = False
    why_not: str | None = None
    per_unit: float = 0


def listing(
    table: ParamTable,
    *,
    data_sets: Iterable[int] = (),
    elements: Mapping[int, Iterable[int]] | None = None,
    known: Callable[[ParamSpec], bool] = lambda spec: True,
    why_not: Callable[[ParamSpec], str | None] = lambda spec: None,
) -> tuple[ListedParam, ...]:
    """The list of a table, in its order.

    ``data_sets``: those in which parameters that are ``per_set`` exist. ``elements``: indexes of arrays by number.
    ``known``: False leaves a parameter out that only the simulated drive has; ``why_not``: why the channel cannot read
    one, beside texts, which none can.
    """
    arrays = {} if elements is None else elements
    return tuple(
        ListedParam(
            name=spec.name,
            number=spec.number,
            title=spec.title,
            subindex=spec.index,
            data_set=data_set,
            index=index,
            unit=spec.unit,
            read_only=spec.read_only,
            per_unit=spec.counts,
            why_not="it is a text, which the parameter channel cannot carry" if spec.text else why_not(spec),
        )
        for spec in table
        if known(spec)
        for data_set, index in _places(spec, tuple(data_sets), arrays)
    )


def _places(
    spec: ParamSpec, data_sets: tuple[int, ...], arrays: Mapping[int, Iterable[int]]
) -> Iterator[tuple[int | None, int | None]]:
    if spec.per_set and data_sets:
        yield from ((data_set, None) for data_set in data_sets)
    elif spec.number in arrays and not spec.index:
        yield from ((None, index) for index in arrays[spec.number])
    else:
        yield None, None
