"""A drive's parameters over its :class:`~dpstack.profile.model.param_store.ParamStore` as record 47 shows them.

Parameters stand at their number; data sets, and subindexes that the table fixes, are elements. Beside them the drive's
limits (974) and the lists of its parameters (980 to 989: 300 elements each, the last one names the next list, 0 ends).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Final, NamedTuple

from dpstack.profile.model.param_errors import (
    BAD_ADDRESS,
    BAD_SUBINDEX,
    BAD_TYPE,
    ILLEGAL_NUMBER,
    LIMITS,
    NO_ARRAY,
    NO_DESCRIPTION,
    NO_TEXT,
    OPERATING_STATE,
    READ_ONLY,
)
from dpstack.profile.model.param_store import ParamStore
from dpstack.profile.model.params import ParamSpec
from dpstack.profile.record47.formats import (
    DOUBLE_WORD,
    INTEGER16,
    INTEGER32,
    OCTET_STRING,
    UNSIGNED16,
    UNSIGNED32,
    VISIBLE_STRING,
    WORD,
    Raw,
    format_of,
)
from dpstack.profile.record47.param_lists import FIRST_LIST, LAST_LIST, PNU_LIMITS, Description
from dpstack.profile.record47.pdu import Address, ErrorValue, Result, Values
from dpstack.profile.record47.split import Limits
from dpstack.units import NS_PER_MS

_LIST_LEN: Final = 300
#: substitutes for a format of the same size (Siemens SINAMICS manual p97)
_SUBSTITUTES: Final = {INTEGER16: WORD, UNSIGNED16: WORD, INTEGER32: DOUBLE_WORD, UNSIGNED32: DOUBLE_WORD}


class _Place(NamedTuple):
    spec: ParamSpec
    data_set: int


def format_number(spec: ParamSpec) -> int:
    """The format of a parameter: 16 or 32 bits, signed where it can be negative."""
    if spec.long:
        return INTEGER32 if spec.low < 0 else UNSIGNED32
    return INTEGER16 if spec.low < 0 else UNSIGNED16


class StoreParameters:
    """A :class:`~dpstack.profile.record47.server.ParameterModel`.

    ``live``: the actual integer where it is not stored; ``locked``: error 11 hex now; ``changed``: told after a write;
    ``texts``: what the values of a parameter are called, by its number, from 0 on.
    """

    def __init__(
        self,
        store: ParamStore,
        *,
        limits: Limits | None = None,
        live: Callable[[ParamSpec], int | None] = lambda spec: None,
        locked: Callable[[ParamSpec], bool] = lambda spec: False,
        changed: Callable[[ParamSpec], None] = lambda spec: None,
        texts: Mapping[int, Sequence[str]] | None = None,
    ) -> None:
        self._texts = {} if texts is None else dict(texts)
        self._store = store
        self._live = live
        self._locked = locked
        self._changed = changed
        self._places: dict[int, dict[int, _Place]] = {}
        for spec in store.table:
            if spec.text:
                continue
            places = self._places.setdefault(spec.number, {})
            if spec.per_set and store.sets > 1:
                places.update((at, _Place(spec, at + 1)) for at in range(store.sets))
            else:
                places[spec.index] = _Place(spec, 1)
        limits = Limits() if limits is None else limits
        self._own: dict[int, tuple[int, ...]] = {
            PNU_LIMITS: (limits.octets, limits.parameters, -(-limits.latency_ns // (10 * NS_PER_MS))),
            **_lists(sorted(self._places)),
        }

    def read(self, address: Address) -> Result:
        own = self._own.get(address.pnu)
        if own is not None:
            end = address.subindex + max(address.elements, 1)
            if end > len(own):
                return ErrorValue(BAD_SUBINDEX, max(address.subindex, len(own)))
            return Values(UNSIGNED16, own[address.subindex : end])
        places = self._wanted(address)
        if isinstance(places, ErrorValue):
            return places
        return Values(format_number(places[0].spec), tuple(map(self._raw, places)))

    def change(self, address: Address, values: Values) -> ErrorValue | None:
        if address.pnu in self._own:
            return ErrorValue(READ_ONLY, address.subindex)
        places = self._wanted(address)
        if isinstance(places, ErrorValue):
            return places
        raws: list[int] = []
        for at, (place, raw) in enumerate(zip(places, values.raws, strict=True), address.subindex):
            checked = self._checked(place.spec, values.format, raw, at)
            if isinstance(checked, ErrorValue):
                return checked
            raws.append(checked)
        for place, checked in zip(places, raws, strict=True):
            self._store.write(place.spec, checked, place.data_set)
            self._changed(place.spec)
        return None

    def _checked(self, spec: ParamSpec, number: int, raw: Raw, subindex: int) -> int | ErrorValue:
        form = format_number(spec)
        if number not in (form, _SUBSTITUTES[form]) or not isinstance(raw, int):
            return ErrorValue(BAD_TYPE)
        if spec.read_only:
            return ErrorValue(READ_ONLY, subindex)
        checked = spec.from_pwe(raw)
        if not spec.low <= spec.to_value(checked) <= spec.high:
            return ErrorValue(LIMITS, subindex)
        return ErrorValue(OPERATING_STATE) if self._locked(spec) else checked

    def describe(self, address: Address) -> Result:
        """The whole description (subindex 0), or one element of it."""
        places = self._places.get(address.pnu)
        if places is None and address.pnu not in self._own:
            return ErrorValue(ILLEGAL_NUMBER)
        if address.elements > 1:
            return ErrorValue(BAD_ADDRESS)
        described = self._description(address.pnu)
        if not address.subindex:
            return Values(OCTET_STRING, (described.build(),))
        return described.element(address.subindex) or ErrorValue(NO_DESCRIPTION)

    def _description(self, pnu: int) -> Description:
        if pnu in self._own:
            own = self._own[pnu]
            return Description(UNSIGNED16, len(own), "", True, True, False, 1.0, 0, bytes(4), b"\0\0\xff\xff")
        places = self._places[pnu]
        spec = next(iter(places.values())).spec
        form = format_number(spec)
        array = _is_array(places)
        low, high = (
            format_of(INTEGER32 if spec.low < 0 else UNSIGNED32).pack((_scaled(spec, limit),))
            for limit in (spec.low, spec.high)
        )
        factor = 1 / (spec.per_unit or 10**spec.decimals)
        text = pnu in self._texts
        return Description(
            form, max(places) + 1 if array else 1, spec.title, spec.read_only, array, text, factor, 0, low, high
        )

    def text(self, address: Address) -> Result:
        """Texts of 16 characters, from ``address.subindex`` on."""
        found = self._texts.get(address.pnu)
        if found is None:
            known = address.pnu in self._places or address.pnu in self._own
            return ErrorValue(NO_TEXT if known else ILLEGAL_NUMBER)
        end = address.subindex + max(address.elements, 1)
        if end > len(found):
            return ErrorValue(BAD_SUBINDEX, max(address.subindex, len(found)))
        octets = "".join(f"{one:16.16}" for one in found[address.subindex : end]).encode("latin-1", "replace")
        return Values(VISIBLE_STRING, (octets,))

    def _raw(self, place: _Place) -> int:
        live = self._live(place.spec)
        raw = self._store.raw(place.spec, place.data_set) if live is None else live
        return place.spec.from_pwe(place.spec.pwe(raw))

    def _wanted(self, address: Address) -> list[_Place] | ErrorValue:
        places = self._places.get(address.pnu)
        if places is None:
            return ErrorValue(ILLEGAL_NUMBER)
        if not _is_array(places):
            if address.elements > 1:
                return ErrorValue(BAD_ADDRESS)
            if address.subindex:
                return ErrorValue(NO_ARRAY)
        wanted: list[_Place] = []
        for at in range(address.subindex, address.subindex + max(address.elements, 1)):
            if at not in places:
                return ErrorValue(BAD_SUBINDEX, at)
            wanted.append(places[at])
        return wanted


def _is_array(places: dict[int, _Place]) -> bool:
    return len(places) > 1 or 0 not in places


def _scaled(spec: ParamSpec, limit: float) -> int:
    """A limit as it stands on the wire, as near as four octets hold it."""
    raw = round(limit * (spec.per_unit or 10**spec.decimals))
    form = format_of(INTEGER32 if spec.low < 0 else UNSIGNED32)
    return min(max(raw, form.low), form.high)


def _lists(numbers: Sequence[int]) -> dict[int, tuple[int, ...]]:
    """980 and following: as many lists as it takes."""
    found: dict[int, tuple[int, ...]] = {}
    for pnu in range(FIRST_LIST, LAST_LIST + 1):
        here, numbers = numbers[: _LIST_LEN - 1], numbers[_LIST_LEN - 1 :]
        following = pnu + 1 if numbers and pnu < LAST_LIST else 0
        found[pnu] = (*here, *(0,) * (_LIST_LEN - 1 - len(here)), following)
        if not following:
            break
    return found
