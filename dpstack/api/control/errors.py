"""Errors over the control socket: an error in the program raises the same error in its client.

Beside the text an answer has ``kind``, the name of a class of :mod:`dpstack.errors`, and the arguments of its
constructor, which are attributes of the error under the same names.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from dpstack import errors
from dpstack.errors import BusError, ConfigError, DpError, UsageError

#: the parameter for the text, which is ``error`` in an answer
_TEXT: Final = "message"
_OCTETS: Final = "octets"


def _subclasses(kind: type[DpError]) -> list[type[DpError]]:
    return [kind, *(deeper for below in kind.__subclasses__() for deeper in _subclasses(below))]


#: the public error classes by name, the only ones that a peer can raise here
KINDS: Final = {kind.__name__: kind for kind in _subclasses(DpError) if kind.__module__ == errors.__name__}


def error_fields(error: Exception) -> dict[str, object]:
    """The fields of an answer beside the text. ``usage``: the request itself is wrong.

    A plain UsageError, or ValueError of an argument, has only that field.
    """
    wrong: dict[str, object] = {"usage": True} if isinstance(error, (UsageError, ConfigError)) else {}
    kind = next((kind for kind in type(error).__mro__ if KINDS.get(kind.__name__) is kind), None)
    if kind is None or kind is UsageError:
        return {"usage": True}
    return {**wrong, "kind": kind.__name__, **{name: _json(getattr(error, name)) for name in _attributes(kind)}}


def failure(answer: Mapping[str, object]) -> DpError:
    """The error of an answer. Without a known kind it is a BusError."""
    text = str(answer.get("error", "refused"))
    kind = KINDS.get(str(answer.get("kind")))
    if kind is not None:
        try:
            given = {name: _plain(answer[name]) for name in _attributes(kind) if name in answer}
            if _TEXT in _parameters(kind):
                given[_TEXT] = text
            return kind(**given) if given else kind(text)
        except (TypeError, ValueError):  # attributes of another version
            pass
    return UsageError(text) if answer.get("usage") else BusError(text)


def _parameters(kind: type[DpError]) -> tuple[str, ...]:
    """The parameters of its constructor; none if it inherits that of Exception."""
    import inspect  # here, as most commands do not fail

    return tuple(inspect.signature(kind).parameters) if inspect.isfunction(kind.__init__) else ()


def _attributes(kind: type[DpError]) -> tuple[str, ...]:
    return tuple(name for name in _parameters(kind) if name != _TEXT)


def _json(value: object) -> object:
    """``value`` for JSON: octets in hex, in an object that names them."""
    return {_OCTETS: value.hex()} if isinstance(value, bytes) else value


def _plain(value: object) -> object:
    """What :func:`_json` was given. Raises ValueError for octets of another version."""
    if isinstance(value, dict) and isinstance(octets := value.get(_OCTETS), str):
        return bytes.fromhex(octets)
    return tuple(value) if isinstance(value, list) else value
