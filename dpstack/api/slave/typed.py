"""Process data as classes: inputs and outputs of a slave with types that a type checker knows.

::

    class Valves(dpstack.Inputs):
        limit: Bool = at(0, 3)  # bit 3 of octet 0
        count: Int = at(1, "u8")
        level: Scaled = at(2, "i16", scale=0.1, unit="bar")

    valves = bus.slave("valves").inputs_as(Valves)
    if valves.limit and valves.level > 2.5: ...
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, Final, Self, TypeAlias, TypeVar, dataclass_transform, get_type_hints

from dpstack.dp.field_map import FieldMap
from dpstack.dp.process_data import Field, field_of, with_scale
from dpstack.errors import ConfigError, UsageError
from dpstack.text import brief

Bool: TypeAlias = bool
Int: TypeAlias = int
#: a number with a scale, or a float
Scaled: TypeAlias = float
Octets: TypeAlias = bytes

K = TypeVar("K", bound="_Typed")
_AT: Final = "dpstack.at"
_NO_SCALE: Final[Mapping[str, object]] = {"scale": 1, "offset": 0, "unit": ""}
#: annotation of a field -> its name here, and the declarations that fit
_KINDS: Final[Mapping[object, tuple[str, Callable[[Field], bool]]]] = {
    bool: ("Bool", lambda found: found.is_bool),
    int: ("Int", lambda found: found.is_number and not found.is_scaled and not found.type.startswith("f")),
    float: ("Scaled", lambda found: found.is_number),
    bytes: ("Octets", lambda found: found.type == "bytes"),
}


def at(
    octet: int | None = None, what: int | str | None = None, *, scale: float = 1, offset: float = 0, unit: str = ""
) -> Any:
    """The place of a field of :class:`Inputs` or :class:`Outputs`. ``octet`` counts from 0.

    ``what``: of a Bool the bit, 0..7; of Octets their number; of Int and Scaled the type, "u8", "i16", "f32le" and so
    on as in the configuration, if ``scale``, ``offset`` and ``unit`` are explained too. Without arguments the field
    is the one of this name in the configuration.
    """
    place = None if octet is None else (octet, what, {"scale": scale, "offset": offset, "unit": unit})
    return dataclasses.field(metadata={_AT: place})


@dataclass_transform(kw_only_default=True, frozen_default=True, field_specifiers=(at,))
class _Typed:
    """A picture of process data; its classes become frozen dataclasses with keyword arguments."""

    def __init_subclass__(cls) -> None:
        dataclasses.dataclass(frozen=True, kw_only=True)(cls)

    @classmethod
    def taken(cls, octets: bytes, known: FieldMap, who: str) -> Self:
        """The values of ``octets``. ``known``: the fields of the configuration; ``who``: their slave, for messages.

        Raises UsageError if a field does not fit the configuration.
        """
        values: dict[str, Any] = {}
        for name, (found, kind) in _fields(cls, known, who, len(octets)).items():
            value = found.get(octets)
            values[name] = float(value) if kind is float else value
        return cls(**values)


class Inputs(_Typed):
    """Base of the classes of inputs, see ``Slave.inputs_as``. All attributes of an object are of one exchange."""


class Outputs(_Typed):
    """Base of the classes of outputs, see ``Slave.outputs_as`` and ``Slave.send``."""

    def put(self, octets: bytes, known: FieldMap, who: str) -> bytes:
        """``octets`` with the values of this object, all other bits as they are. Raises UsageError."""
        for name, (found, _) in _fields(type(self), known, who, len(octets)).items():
            try:
                octets = found.put(octets, getattr(self, name))
            except ValueError as error:
                raise UsageError(f"{who}: {type(self).__name__}: {error}") from None
        return octets


def typed(base: type[_Typed], kind: type[K]) -> type[K]:
    """``kind``. Raises UsageError if it is no class of ``base``, :class:`Inputs` or :class:`Outputs`."""
    if not isinstance(kind, type) or not issubclass(kind, base):
        name = base.__name__
        raise UsageError(
            f"{brief(kind)} is no class of {name.lower()}: write class Tank(dpstack.{name}): level: Int = at()"
        )
    return kind


def _fields(kind: Any, known: FieldMap, who: str, length: int) -> dict[str, tuple[Field, object]]:
    """The fields of ``kind``, a class of Inputs or Outputs, with their annotations. Raises UsageError."""
    called = f"{who}: {kind.__name__}"
    found: dict[str, tuple[Field, object]] = {}
    try:
        declared = _declared(kind, length)
    except ConfigError as error:
        raise UsageError(f"{called}: {error}") from None
    for name, (field, annotation) in declared.items():
        own = known.fields.get(name)
        if field is None:
            if own is None:
                names = ", ".join(known.fields) or "none"
                raise UsageError(f"{called}: the configuration names no {name}; it names: {names}")
            field = own
        elif own is not None and dataclasses.replace(own, dead_band=field.dead_band) != field:
            raise UsageError(
                f"{called}: {name} is {_text(field)} here and {_text(own)} in the configuration; make them equal, or "
                "leave the arguments of at() out"
            )
        label, fits = _KINDS[annotation]
        if not fits(field):
            raise UsageError(f"{called}: {name} is {_text(field)}, which is no {label}: annotate it as {_label(field)}")
        found[name] = field, annotation
    return found


@cache
def _declared(kind: Any, length: int) -> dict[str, tuple[Field | None, object]]:
    """The fields as ``kind`` declares them for an image of ``length`` octets; None: as the configuration has them.

    Raises ConfigError.
    """
    hints = get_type_hints(kind)
    found: dict[str, tuple[Field | None, object]] = {}
    for one in dataclasses.fields(kind):
        annotation = hints[one.name]
        if annotation not in _KINDS or _AT not in one.metadata:
            raise ConfigError(f"{one.name} is no field; write {one.name}: Bool = at(0, 3), or Int, Scaled, Octets")
        found[one.name] = _field(one.name, one.metadata[_AT], annotation, length), annotation
    return found


def _field(name: str, place: tuple[int, object, Mapping[str, Any]] | None, kind: object, length: int) -> Field | None:
    if place is None:
        return None
    octet, what, given = place
    if kind is bool:
        if isinstance(what, str):
            raise ConfigError(f"{name}: at({octet}, {what!r}) is no place of a Bool; give its bit: at({octet}, 3)")
        spec = f"bool@{octet}.{what}"
    elif kind is bytes:
        spec = f"bytes@{octet}:{what}"
    else:
        spec = f"{what}@{octet}"
    scaled = {key: value for key, value in given.items() if value != _NO_SCALE[key]}
    return with_scale(field_of(name, spec, length, "its process data"), scaled)


def _text(field: Field) -> str:
    scale = f", scale {field.scale:g}, offset {field.offset:g}" if field.is_scaled else ""
    return f"{field.spec}{scale}{field.unit and f', {field.unit}'}"


def _label(field: Field) -> str:
    return next(label for label, fits in _KINDS.values() if fits(field))
