"""Argument checks of the public API: a wrong type or an unknown attribute raises UsageError at once."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Mapping, Set
from numbers import Real
from typing import TYPE_CHECKING, Any, ClassVar, Final

from dpstack.errors import UnknownAttribute, UsageError
from dpstack.text import brief, did_you_mean, nearest


def whole_number(what: str, value: Any, error: type[Exception] = UsageError) -> int:
    """``value`` if it is a whole number; the caller checks ranges. Raises ``error``."""
    if isinstance(value, bool) or not isinstance(value, int):
        raise error(f"{what} = {brief(value)} is no whole number: give one, 47 or 0x2F for instance")
    return value


def octets(what: str, value: Any, error: type[Exception] = UsageError) -> bytes:
    """``value`` as octets: bytes, bytearray, memoryview, or an ordered sequence of numbers 0..255. Raises ``error``."""
    if not isinstance(value, (str, int, Mapping, Set)) and isinstance(value, (bytes, bytearray, memoryview, Iterable)):
        try:
            return bytes(value)
        except (TypeError, ValueError):
            pass
    raise error(
        f"{what} = {brief(value)} is no octets: give bytes, b'\\x01\\x02' or bytes.fromhex('01 02') for instance"
    )


def functions(who: str, error: type[Exception] = UsageError, /, **functions: object) -> None:
    """Raises ``error`` for an argument that is neither None nor callable; the first one must not be None."""
    for at, (name, value) in enumerate(functions.items()):
        if not callable(value) and (value is not None or not at):
            raise error(f"{who}: {name} = {brief(value)} is no function")


def plain_function(what: str, value: object, example: str, error: type[Exception] = UsageError) -> None:
    """Raises ``error`` unless ``value`` is callable, and no coroutine function: nobody would await its result.

    ``example``: a call with such a function.
    """
    if not callable(value):
        raise error(f"{what} = {brief(value)} is no function: give one, {example} for instance")
    if inspect.iscoroutinefunction(value):
        raise error(f"{what} is an async function, whose result nobody awaits: give a plain one (def, lambda)")


def instance(what: str, value: object, kind: type, example: str, error: type[Exception] = UsageError) -> None:
    """Raises ``error`` unless ``value`` is a ``kind``. ``example``: one, or a call that takes one."""
    if not isinstance(value, kind):
        raise error(f"{what} = {brief(value)} is no {kind.__name__}: give one, {example} for instance")


def is_number(value: object) -> bool:
    """Whether ``value`` is a number of any library; True and False are no numbers."""
    return isinstance(value, Real) and not isinstance(value, bool)


def seconds(what: str, value: object) -> None:
    """Raises UsageError unless ``value`` is a number of seconds, or None."""
    if value is not None and not is_number(value):
        raise UsageError(f"{what} = {brief(value)} is no time: give a number of seconds, 2.5 for instance")


_set_plainly: Final = object.__setattr__


class Sealed:
    """Base of classes of the public API: after :meth:`_seal` the assignment to an unknown attribute raises
    :class:`~dpstack.errors.UnknownAttribute`. A misspelt set point would otherwise have no effect without any error.

    Private names are free, and so are all names in a class that a user derives. For the hint each read of an attribute
    costs ten times as much as elsewhere (until Python 3.12): what runs in every cycle reads few.
    """

    _sealed: bool = False
    #: the public properties of the class that can be assigned to
    _assignable: ClassVar[tuple[str, ...]] = ()

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        cls._assignable = tuple(name for name, value in _properties(cls).items() if value.fset is not None)

    def _seal(self, kind: type) -> None:
        """Call it at the end of ``kind.__init__``; instances of derived classes stay open."""
        self._sealed = type(self) is kind

    def __setattr__(self, name: str, value: object) -> None:
        if name not in type(self)._assignable and self._sealed and not name.startswith("_") and name not in vars(self):
            kind = type(self)
            found = getattr(kind, name, None)
            if isinstance(found, property):
                if found.fset is None:
                    raise UnknownAttribute(f"{self._sealed_name()}: {name} can only be read")
            elif callable(found) or not hasattr(kind, name):
                raise UnknownAttribute(self._no_attribute(name, method=callable(found)))
        _set_plainly(self, name, value)

    if not TYPE_CHECKING:  # a type checker names the attributes that there are

        def __getattr__(self, name: str) -> object:
            text = f"{type(self).__name__!r} object has no attribute {name!r}"
            hint = "" if name.startswith("_") else self._read_hint(name)
            if hint:
                raise AttributeError(text + hint)
            raise AttributeError(text, name=name, obj=self)

    def _read_hint(self, name: str) -> str:
        """The end of the message about the unknown attribute ``name``; empty if nothing comes near."""
        known = [key for key in dir(type(self)) if not key.startswith("_")]
        near = nearest(name, known, 0.7)
        return f"; did you mean {near}?" if near else ""

    def _sealed_name(self) -> str:
        return type(self).__name__.lower()

    def _no_attribute(self, name: str, *, method: bool) -> str:
        """The message about the assignment to ``name``."""
        if method:
            return f"{self._sealed_name()}: {name} is a method: call it instead of assigning to it"
        settable = self._assignable
        hint = did_you_mean(name, settable, f"these can be assigned: {', '.join(settable) or 'none'}")
        return f"{self._sealed_name()} has no attribute {name!r}; {hint}"


def _properties(kind: type) -> dict[str, property]:
    found = {key: value for base in kind.__mro__ for key, value in vars(base).items() if isinstance(value, property)}
    return {key: value for key, value in found.items() if not key.startswith("_")}
