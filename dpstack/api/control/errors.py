"""What failed in a program, over its control socket: the error there is the same error of its client.

An answer has ``kind``, the name of a class of :mod:`dpstack.errors`, and what its constructor takes beside the text:
each of these is an attribute of the same name, too.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Final

from dpstack import errors
from dpstack.errors import BusError, ConfigError, DpError, UsageError

#: the text is the answer's ``error``
_TEXT: Final = "message"


def _subclasses(kind: type[DpError]) -> list[type[DpError]]:
    return [kind, *(deeper for below in kind.__subclasses__() for deeper in _subclasses(below))]


#: those of the tree that users know, by name: what a peer names is nothing else
KINDS: Final = {kind.__name__: kind for kind in _subclasses(DpError) if kind.__module__ == errors.__name__}


def told(error: Exception) -> dict[str, object]:
    """What an answer tells beside the text. ``usage``: the request is wrong, not the world.

    A plain UsageError, or ValueError of an argument, is no more than that.
    """
    wrong: dict[str, object] = {"usage": True} if isinstance(error, (UsageError, ConfigError)) else {}
    kind = next((kind for kind in type(error).__mro__ if KINDS.get(kind.__name__) is kind), None)
    if kind is None or kind is UsageError:
        return {"usage": True}
    return {**wrong, "kind": kind.__name__, **{name: getattr(error, name) for name in _attributes(kind)}}


def failure(answer: Mapping[str, object]) -> DpError:
    """The error that an answer tells of. One of no kind, or of one that is not known here, is a BusError."""
    text = str(answer.get("error", "refused"))
    kind = KINDS.get(str(answer.get("kind")))
    if kind is not None:
        given = {name: _plain(answer[name]) for name in _attributes(kind) if name in answer}
        if _TEXT in _parameters(kind):
            given[_TEXT] = text
        try:
            return kind(**given) if given else kind(text)
        except (TypeError, ValueError):  # attributes of another version
            pass
    return UsageError(text) if answer.get("usage") else BusError(text)


def _parameters(kind: type[DpError]) -> tuple[str, ...]:
    """Of its constructor; none where it is that of any exception."""
    return tuple(inspect.signature(kind).parameters) if inspect.isfunction(kind.__init__) else ()


def _attributes(kind: type[DpError]) -> tuple[str, ...]:
    return tuple(name for name in _parameters(kind) if name != _TEXT)


def _plain(value: object) -> object:
    return tuple(value) if isinstance(value, list) else value
