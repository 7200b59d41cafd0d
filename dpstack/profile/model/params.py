"""Drive parameters declared as data: number, type, scale, unit, limits; the list of them that a dump reads."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import KW_ONLY, dataclass
from enum import StrEnum
from typing import Final

from dpstack.profile.model.param_errors import LIMITS, READ_ONLY
from dpstack.profile.model.param_types import ParamType, float_bits, float_of

_WORD: Final = 0xFFFF
_LONG: Final = 0xFFFF_FFFF
#: up to here a float of 32 bits holds every whole number
_EXACT: Final = 1 << 24
#: parts of a step by which a value may miss it: what decimal fractions lose as floats
_TOLERANCE: Final = 1e-6


def count_of(what: str, value: float, per_unit: float, unit: str = "") -> int:
    """The integer on the wire of ``value``, where 1 in ``unit`` is ``per_unit``; ``value`` must be finite.

    Raises ValueError with the step and the two nearest values if ``value`` lies between two of them: a value is
    never rounded without the caller's knowledge.
    """
    exact = value * per_unit
    raw = round(exact)
    if abs(exact - raw) <= max(_TOLERANCE, abs(exact) * 1e-15):
        return raw
    below = math.floor(exact)
    behind = f" {unit}" if unit else ""
    low, high, step = (_shown(count / per_unit) for count in (below, below + 1, 1))
    raise ValueError(
        f"{what}: {_shown(value)}{behind} lies between two values, the step is {step}{behind}: "
        f"give {low} or {high}{behind}"
    )


def check_float(what: str, value: float) -> None:
    """Raises ValueError with the two nearest values for a whole number that no float of 32 bits is equal to."""
    if value == int(value) and abs(value) > _EXACT:
        step = 1 << int(abs(value)).bit_length() - _EXACT.bit_length() + 1
        count_of(what, value, 1 / step)


def _shown(value: float) -> str:
    """A value with the digits that it needs to be accepted again."""
    short = f"{value:.12g}"
    return short if math.isclose(float(short), value, rel_tol=1e-15) else repr(value)


class Use(StrEnum):
    """The use of a parameter to the plugin. The values are those of a table's column ``use``."""

    NONE = ""
    SCALE = "scale"  # of set point and actual speed
    SOURCE = "source"  # of commands or set point
    SETTING = "setting"  # another one that the plugin relies on
    MAP = "map"  # a code of the process data maps: only ``write_map`` writes it


#: in the column ``acts``: a write counts from the drive's next power-on
POWER_ON: Final = "power-on"


@dataclass(frozen=True, slots=True)
class ParamSpec:
    """A parameter of a ``type``. ``low``, ``high`` and ``factory`` are in ``unit``; without limits they are the type's.

    On the wire stands value x 10^decimals in the type's width and sign, or the float itself (``ParamType.F32``); its
    "integer on the wire" (raw) is then the 32 bits of the float. ``per_unit`` instead of ``decimals`` if that is no
    power of ten. ``index``: a fixed subindex that belongs to the number. ``by_name``: people know it by its name.
    ``read_only``. ``made_up``: limits or factory value are ours. ``volatile``: the drive never stores it in its
    EEPROM. ``acts``: when a write counts: at once (empty), from :data:`POWER_ON`, or with a write of the parameter of
    this name. Raises ValueError if the type cannot hold the limits.
    """

    #: number
    number: int
    #: name, unique within the table
    name: str
    #: title for people
    title: str
    #: lowest value in ``unit``
    low: float = -math.inf
    #: highest value in ``unit``
    high: float = math.inf
    #: value at delivery in ``unit``
    factory: float = 0
    _: KW_ONLY
    index: int = 0
    #: data type on the wire
    type: ParamType = ParamType.U16
    #: decimals: the wire carries value x 10^decimals
    decimals: int = 0
    #: counts on the wire that make 1 in ``unit``, if that is no power of ten
    per_unit: float = 0
    #: unit of the value; empty for a plain number
    unit: str = ""
    #: the parameter exists once in every data set
    per_set: bool = False
    #: the drive refuses writes
    read_only: bool = False
    made_up: bool = False
    by_name: bool = False
    volatile: bool = False
    #: part that the parameter has for the plugin
    use: Use = Use.NONE
    acts: str = ""

    def __post_init__(self) -> None:
        if self.type is ParamType.F32 and (self.decimals or self.per_unit):
            raise ValueError(f"parameter {self.label}: a float has neither decimals nor per_unit")
        lowest, highest = self.type_limits
        for name, given, limit in (("low", self.low, lowest), ("high", self.high, highest)):
            if math.isinf(given):
                object.__setattr__(self, name, limit)
            elif not self.text and not lowest - _TOLERANCE <= given <= highest + _TOLERANCE:
                raise ValueError(
                    f"parameter {self.label}: {name} = {given:g} does not fit its type {self.type}, which holds "
                    f"{lowest:g}..{highest:g}"
                )

    @property
    def type_limits(self) -> tuple[float, float]:
        """Lowest and highest value in ``unit`` that the type holds."""
        low, high = self.type.limits
        return (low, high) if self.counts == 1 else (low / self.counts, high / self.counts)

    @property
    def text(self) -> bool:
        """A string, which the parameter channel cannot carry."""
        return self.type is ParamType.TEXT

    def to_raw(self, value: float) -> int:
        """The integer on the wire. Raises ValueError with the limits, or with the step if it lies between two."""
        if not (math.isfinite(value) and self.low <= value <= self.high):
            unit = f" {self.unit}" if self.unit else ""
            raise ValueError(f"{self.label}: {value:g}{unit} is outside {self.low:g}..{self.high:g}{unit}")
        if self.type is ParamType.F32:
            check_float(self.label, value)
            return float_bits(value)
        return count_of(self.label, value, self.counts, self.unit)

    def nearest_raw(self, value: float) -> int:
        """The integer on the wire that is nearest to a measured ``value``, within the limits."""
        value = min(max(value, self.low), self.high)
        return float_bits(value) if self.type is ParamType.F32 else round(value * self.counts)

    @property
    def counts(self) -> float:
        """Counts on the wire that make 1 in ``unit``; 1 for a float."""
        return self.per_unit or float(10**self.decimals) * self.type.counts

    def to_value(self, raw: int) -> int | float:
        """The value in ``unit`` of an integer on the wire: an int if there are no decimals."""
        if self.type is ParamType.F32:
            return float_of(raw & _LONG)
        return raw if self.counts == 1 else raw / self.counts

    def write_error(self, raw: int) -> int | None:
        """The error number of a write of ``raw``: of a read-only parameter, or beyond the limits; None: it may be."""
        if self.read_only:
            return READ_ONLY
        return None if self.low <= self.to_value(raw) <= self.high else LIMITS

    def pwe(self, raw: int) -> int:
        """``raw`` as the 32 bits of PWE; a word stands in the low half, its high half is 0."""
        return raw & (_LONG if self.type.wide else _WORD)

    def from_pwe(self, pwe: int) -> int:
        """The integer in PWE, with the sign of the type."""
        return self.from_wire(pwe, 32 if self.type.wide else 16)

    def from_wire(self, raw: int, bits: int) -> int:
        """The low ``bits`` as the drive sent them, whatever width the type has, with the sign of the type."""
        half = 1 << bits - 1
        raw &= (half << 1) - 1
        return (raw ^ half) - half if self.type.signed else raw

    def misfit(self, raw: int, real: bool = False) -> str | None:
        """Why the type cannot be that of the drive if it answers ``raw`` (:meth:`from_wire`), for people; None if it
        can. ``real``: the drive says that it is a float.
        """
        declared, low, high = f"it is declared as {self.type}", *self.type.limits
        remedy = "declare the type that the drive's manual gives"
        if self.type is ParamType.F32:
            return None if real else f"{declared}, and the drive answers an integer: {remedy}"
        if real:
            return f"{declared}, and the drive answers a float: {remedy}, {ParamType.F32}"
        maybe = float_of(raw & _LONG)
        as_float = f" (as a float it is {maybe:g})" if _TOLERANCE < abs(maybe) < 1 / _TOLERANCE else ""
        if not low <= raw <= high:
            return f"{declared}, and the drive answers {raw}{as_float}, which that cannot hold: {remedy}"
        value = self.to_value(raw)
        if as_float and self.type.wide and not self.low <= value <= self.high and self.low <= maybe <= self.high:
            limits = f"outside {self.low:g}..{self.high:g}"
            return f"{declared}, and the drive's value {value:g} is {limits}{as_float}: {remedy}"
        return None

    @property
    def label(self) -> str:
        """Number and title for people."""
        return f"{self.name if self.index or self.by_name else self.number} ({self.title})"


class ParamTable:
    """The parameters of a drive, found by name or by number (and index). Numbers and names must be unique."""

    __slots__ = ("_by_key", "_by_name", "applies")

    def __init__(self, specs: Iterable[ParamSpec]) -> None:
        self._by_key: dict[tuple[int, int], ParamSpec] = {}
        self._by_name: dict[str, ParamSpec] = {}
        for spec in specs:
            if (spec.number, spec.index) in self._by_key or spec.name.lower() in self._by_name:
                raise ValueError(f"parameter {spec.label} is declared twice")
            self._by_key[spec.number, spec.index] = spec
            self._by_name[spec.name.lower()] = spec
        #: names of the parameters whose write makes others count
        self.applies: frozenset[str] = frozenset(spec.acts for spec in self._by_key.values()) - {"", POWER_ON}

    def __iter__(self) -> Iterator[ParamSpec]:
        return iter(self._by_key.values())

    def __repr__(self) -> str:
        return f"<ParamTable of {len(self._by_key)} parameters>"

    def get(self, number: int, index: int = 0) -> ParamSpec | None:
        """By number and fixed index."""
        return self._by_key.get((number, index))

    def named(self, name: str) -> ParamSpec | None:
        """By name (any case), or by the number as text."""
        found = self._by_name.get(name.strip().lower())
        if found is None and name.isascii() and name.strip().isdecimal():
            found = self.get(int(name))
        return found

    def hint(self, name: str) -> str:
        """The names that a user may have meant, for the end of a message; empty if none is near."""
        import difflib  # here, as most names are right

        near = " or ".join(difflib.get_close_matches(name.lower(), self._by_name, n=3))
        return f"; did you mean {near}?" if near else ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ListedParam:
    """An entry of the parameter list; ``name``, ``data_set`` and ``index`` are the arguments of the read.

    ``number`` and ``subindex`` are what the table declares. ``why_not``: why it cannot be read, for people.
    ``per_unit``: counts on the wire that make 1 in ``unit``, 0 if it is not known.
    """

    #: name for the read
    name: str
    #: number in the table of the plugin
    number: int
    #: title for people
    title: str
    #: subindex in the table of the plugin; 0 for none
    subindex: int = 0
    #: data set for the read; None if the drive has none
    data_set: int | None = None
    #: index for the read; None for a plain parameter
    index: int | None = None
    #: unit of the value; empty for a plain number
    unit: str = ""
    #: the drive refuses writes
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
            per_unit=0 if spec.type is ParamType.F32 else spec.counts,
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
