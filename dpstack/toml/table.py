"""Typed reading of configuration tables; every error is one line: file and line, problem, remedy.

A class lists the keys of a table: its annotations are types or ``Annotated[type, Key(...)]``, its docstring has a
sentence for each key. The reader, its error messages and the tables of docs/reference/configuration.md follow from the
class.
"""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import UnionType
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Final,
    Literal,
    NoReturn,
    TypeAlias,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

from msgspec import Struct, structs

from dpstack.errors import ConfigError, PduError
from dpstack.text import brief
from dpstack.toml.reading import Path as KeyPath
from dpstack.toml.reading import quoted

if TYPE_CHECKING:
    from dpstack.gsd.model import Device

#: octets as they may be given: bytes, hex digits, or numbers 0..255
Octets: TypeAlias = bytes | str | Sequence[int]


class Gsd(Struct, frozen=True):
    """The keyword of a GSD file that limits a flag: at 0 the device does not have the function; with ``required``, at 1
    the device needs it."""

    keyword: str
    says: Callable[[Device], bool]
    required: bool = False


class Key(Struct, frozen=True):
    """The values that a key allows, besides its type. ``unit``: of the limits, if the key's name has none. ``hint``:
    the remedy in the message about a value outside the limits. ``read``: the reader of a key that has a value, instead
    of the reader of its type.
    """

    low: float = -math.inf
    high: float = math.inf
    unit: str = ""
    hint: str = ""
    gsd: Gsd | None = None
    read: Callable[[Table, str, Key], object] | None = None
    #: the type of the value, the first one if it may be given in several
    kind: Any = None


#: ``int | None``, and ``Literal[...] | None`` before Python 3.14
_UNIONS: Final = (UnionType, Union)


@functools.cache
def keys_of(table: type) -> dict[str, Key]:
    """The keys by the annotations of ``table``, in their order; a plain type is a key without limits."""
    found = {}
    for name, hint in get_type_hints(table, include_extras=True).items():
        kind, key = get_args(hint) if get_origin(hint) is Annotated else (hint, Key())
        found[name] = structs.replace(key, kind=get_args(kind)[0] if get_origin(kind) in _UNIONS else kind)
    return found


class Source(Struct, frozen=True):
    """The source of a configuration: its name in messages, the line numbers of its keys (None: no text), and the
    ``file`` as an absolute path without links (None: no file) with the ``digest`` of what was read (SHA-256, hex).
    """

    name: str
    lines: Mapping[KeyPath, int] | None = None
    file: Path | None = None
    digest: str | None = None

    def error(self, path: KeyPath, what: str, todo: str) -> ConfigError:
        """The ConfigError ``file:line: what; todo``; without lines the name alone stands in front."""
        return ConfigError.at(self.name, None if self.lines is None else self.line(path), what, todo)

    def line(self, path: KeyPath) -> int:
        """The line of ``path``, or of the nearest table around it."""
        lines = self.lines or {}
        while path and path not in lines:
            path = path[:-1]
        return lines.get(path, 1)


class Table:
    """One table. ``title`` names it in messages (``[bus]``, ``[[slave]] hoist``)."""

    def __init__(self, source: Source, path: KeyPath, data: object, title: str) -> None:
        self._source = source
        self._path = path
        self.title = title
        if not isinstance(data, Mapping):
            todo = f"write {title} on a line of its own"
            if source.lines is None:  # of a program
                todo = "give a mapping of its keys, {'name': 'fan', 'address': 4, ...} for instance"
            raise source.error(path, f"{title} must be a table", todo)
        self._data: dict[str, object] = {
            str(key): list(value) if type(value) is tuple else value for key, value in data.items()
        }

    def extended(self, more: Mapping[str, object]) -> Table:
        """The same table with the keys ``more``, which go before its own."""
        return Table(self._source, self._path, self._data | dict(more), self.title)

    def fail(self, key: str | None, what: str, todo: str) -> NoReturn:
        """Raises ConfigError at ``key``, or at the table."""
        raise self.error(key, what, todo)

    def error(self, key: str | None, what: str, todo: str) -> ConfigError:
        """The ConfigError itself, for `raise ... from`."""
        path = self._path if key is None or key not in self._data else (*self._path, key)
        return self._source.error(path, f"{self.title}: {what}", todo)

    @contextlib.contextmanager
    def blaming(self, key: str | None = None, prefix: str = "") -> Iterator[None]:
        """Turn a ConfigError or PduError raised inside into an error at ``key``, unless it names a place already."""
        try:
            yield
        except (ConfigError, PduError) as error:
            if isinstance(error, ConfigError) and error.what:
                raise
            what, _, todo = str(error).partition("; ")
            raise self.error(key, prefix + what, todo or "correct it") from None

    def check_against_gsd(self, keys: Mapping[str, Key], given: Mapping[str, object], device: Device | None) -> None:
        """Raises ConfigError for a flag ``given`` that the GSD file of ``device`` does not allow."""
        for name, key in keys.items():
            gsd = key.gsd
            if device is None or gsd is None or name not in given:
                continue
            if gsd.says(device) is gsd.required is not given[name]:
                what = f"{name} = {str(given[name]).lower()}, but its GSD file says {gsd.keyword} = {int(gsd.required)}"
                self.fail(name, what, f"leave {name} out")

    def read(self, keys: Mapping[str, Key]) -> dict[str, Any]:
        """The values of ``keys`` in the table; None counts as left out. Raises ConfigError for the first unknown key,
        with the nearest known one.
        """
        names = list(keys)
        for name in self._data:
            if name not in names:
                import difflib  # here, as most keys are right

                near = difflib.get_close_matches(name.lower(), names, n=1, cutoff=0.5)
                todo = f"did you mean {near[0]!r}?" if near else f"known keys: {', '.join(names)}"
                self.fail(name, f"unknown key {name!r}", todo)
        return {name: self._value(name, key) for name, key in keys.items() if self.raw(name) is not None}

    def _value(self, name: str, key: Key) -> object:
        kind = get_origin(key.kind) or key.kind
        if key.read is not None:
            return key.read(self, name, key)
        if kind is Literal:
            return self._choice(name, get_args(key.kind))
        if kind is int:
            return self.integer(name, key.low, key.high, key.hint)
        if kind is float:
            return self.number(name, key.low, key.high)
        if kind in (tuple, Sequence):
            return self._integers(name, key.low, key.high)
        return _READERS[kind](self, name)

    @property
    def folder(self) -> Path:
        """The folder of its file, where relative paths begin."""
        return Path(self._source.name).parent

    def __contains__(self, key: str) -> bool:
        return key in self._data

    def __iter__(self) -> Iterator[str]:
        return iter(self._data)

    def raw(self, key: str) -> object:
        """The value as it stands, None when absent."""
        return self._data.get(key)

    # readers of a key that has a value

    def _typed(self, key: str, kinds: type | tuple[type, ...], wanted: str) -> Any:
        """The value if it is one of ``kinds``; ``wanted``: what it must be, for people. A bool is no number."""
        value = self._data.get(key)
        if not isinstance(value, kinds) or (isinstance(value, bool) and kinds is not bool):
            self._wrong(key, wanted)
        return value

    def _wrong(self, key: str, wanted: str) -> NoReturn:
        value = self._data.get(key)
        kind = _KINDS.get(type(value), type(value).__name__)
        self.fail(key, f"{key} = {brief(value)} is {kind}", f"it must be {wanted}")

    def text(self, key: str) -> str:
        """A text that is not empty and has no line ends or other control characters."""
        value: str = self._typed(key, str, "a text in quotes")
        if not value.strip():
            self.fail(key, f"{key} is empty", "give it a value or leave it out")
        if not value.isprintable():
            self.fail(key, f"{key} = {brief(value)} holds a control character", "take it out")
        return value

    def _flag(self, key: str) -> bool:
        return bool(self._typed(key, bool, "true or false"))

    def integer(self, key: str, low: float = -math.inf, high: float = math.inf, hint: str = "") -> int:
        """An integer within limits (both included)."""
        value: int = self._typed(key, int, "an integer")
        if not low <= value <= high:
            self.fail(key, f"{key} = {value} is outside {low}..{high}", hint or _CORRECT)
        return value

    def number(self, key: str, low: float, high: float) -> float:
        """An integer or a float within limits (both included)."""
        value = self._typed(key, (int, float), "a number")
        if not (math.isfinite(value) and low <= value <= high):
            self.fail(key, f"{key} = {value:g} is outside {low:g}..{high:g}", _CORRECT)
        return float(value)

    def _choice(self, key: str, known: Sequence[str]) -> str:
        value = self.text(key)
        if value not in known:
            *others, last = map(quoted, known)
            self.fail(key, f"unknown {key} {brief(value)}", f"it must be {', '.join(others)} or {last}")
        return value

    def _integers(self, key: str, low: float, high: float) -> tuple[int, ...]:
        """A list of integers within limits, each once."""
        wanted = "a list of integers, for instance [1, 2]"
        value = self._typed(key, (list, tuple), wanted)
        if not all(map(is_integer, value)):
            self._wrong(key, wanted)
        for member in value:
            if not low <= member <= high:
                self.fail(key, f"{key} holds {member}, outside {low}..{high}", _CORRECT)
        return tuple(sorted(set(value)))

    def table(self, key: str, wanted: str = "a table, for instance { name = value }") -> Table:
        """A table inside this one, inline or with a header of its own; ``wanted``: what it must be, for people."""
        value = self._typed(key, Mapping, wanted)
        return Table(self._source, (*self._path, key), value, f"{self.title}: {key}")

    def _inside(self, key: str) -> dict[str, object]:
        inside = self.table(key)
        return {name: inside.raw(name) for name in inside}

    def inner(self, key: str, number: int, value: object) -> Table:
        """The table ``value`` that stands at place ``number``, from 1, of the list ``key``."""
        return Table(self._source, (*self._path, key), value, f"{self.title}: {key} {number}")

    def numbered(self, key: str) -> Table:
        """The members of the list ``key`` as a table: ``key_0``, ``key_1`` ..."""
        members = self._data[key]
        assert isinstance(members, list)
        if not members:
            self.fail(key, f"{key} is an empty list", 'give it places, for instance ["bool@0.0", "bool@0.1"]')
        numbered = {f"{key}_{number}": member for number, member in enumerate(members)}
        return Table(self._source, (*self._path, key), numbered, self.title)

    def octets(self, key: str) -> bytes:
        """Octets as a text of hex digits, or as a list of integers 0..255."""
        value = self._data.get(key)
        if isinstance(value, (bytes, bytearray)):
            return bytes(value)
        if isinstance(value, list) and all(map(is_integer, value)):
            for member in value:
                if not 0 <= member <= 255:
                    self.fail(key, f"{key} holds {member}, which is no octet", "octets are 0..255")
            return bytes(value)
        text = self._typed(key, str, 'octets in hex, for instance "20 10"')
        try:
            return parse_hex(text)
        except ValueError as error:
            raise self.error(key, f"{key} = {brief(text)} is no hex ({error})", 'write octets like "20 10"') from None


def is_integer(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def as_given(table: Table, name: str, _: Key) -> object:
    """Reader of a key whose value is checked later."""
    return table.raw(name)


_CORRECT: Final = "correct it or leave it out"
_READERS: Final[dict[type, Callable[[Table, str], object]]] = {
    str: Table.text,
    bool: Table._flag,
    bytes: Table.octets,
    Mapping: Table._inside,
}
_KINDS: Final[dict[type, str]] = {
    bool: "true/false",
    int: "an integer",
    float: "a decimal number",
    str: "a text",
    list: "a list",
    dict: "a table",
}


def parse_hex(text: str) -> bytes:
    """Octets from hex digits; blanks, commas, colons and ``0x`` between them are allowed.

    Raises ValueError that names what is wrong.
    """
    digits = "".join(part.removeprefix("0x").removeprefix("0X") for part in text.replace(",", " ").split())
    digits = digits.replace(":", "").replace("_", "")
    wrong = next((c for c in digits if c not in "0123456789abcdefABCDEF"), None)
    if wrong is not None:
        raise ValueError(f"{wrong!r} is no hex digit")
    if len(digits) % 2:
        raise ValueError("an odd number of digits")
    return bytes.fromhex(digits)
