"""Messages of a page: ``hello``, ``ask`` and ``order``, decoded by type; and the texts that are sent to it.

A page is a stranger: it may send anything. :func:`parse` either returns a message whose every part has its type and its
bounds, or raises :class:`MessageError` with one line for that page.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from typing import Annotated, Any, Final, TypeVar

import msgspec
from msgspec import UNSET, Meta, Raw, Struct, UnsetType

from dpstack.text import json_text, printable, shortened

_T = TypeVar("_T")
#: octets of a message of a page
MOST_OCTETS: Final = 262_144
#: nested lists and objects in the arguments of an ask
_MOST_LEVELS: Final = 8
#: characters of the reason in an error, which may name a key of the page
_MOST_OF_A_REASON: Final = 120

#: the number of an ask or order: up to the largest whole number that JavaScript keeps exactly
Id = Annotated[int, Meta(ge=0, le=2**53 - 1)]
_Token = Annotated[str, Meta(max_length=1_024)]
_Args = Annotated[tuple[Any, ...], Meta(max_length=64)]
_Text = Annotated[str, Meta(max_length=4_096)]
_Texts = Annotated[tuple[_Text, ...], Meta(max_length=64)]


class MessageError(Exception):
    """A message that is not as the protocol has it. ``id``: the number of the ask or order; None if it has none."""

    def __init__(self, text: str, id: int | None = None) -> None:
        super().__init__(printable(text))
        self.id = id


class Hello(Struct, frozen=True):
    """The first message. ``token``: None if the page has none."""

    token: _Token | None = None


class Ask(Struct, frozen=True):
    """A read. ``args``: JSON values; a whole configuration may be among them."""

    id: Id
    what: str
    args: _Args = ()


class PageOrder(Struct, frozen=True):
    """Something that changes the plant. ``confirmed``: the person at the page has confirmed it there."""

    id: Id
    command: str
    args: _Texts = ()
    confirmed: bool = False

    @property
    def text(self) -> str:
        """The order on one line, for people and logs."""
        return printable(" ".join((self.command, *self.args)))


class _Envelope(Struct, forbid_unknown_fields=True):
    """A message before the body is decoded: an error of an ask or order goes to its ``id``."""

    hello: Raw | UnsetType = UNSET
    ask: Raw | UnsetType = UNSET
    order: Raw | UnsetType = UNSET


class _Numbered(Struct):
    id: Id


#: type of the body of each message, and an example
_KINDS: Final[dict[str, tuple[type[Hello | Ask | PageOrder], str]]] = {
    "hello": (Hello, '{"hello":{"token":null}}'),
    "ask": (Ask, '{"ask":{"id":1,"what":"why","args":["valves"]}}'),
    "order": (PageOrder, '{"order":{"id":1,"command":"set","args":["valves.limit=on"],"confirmed":true}}'),
}


def parse(text: str) -> Hello | Ask | PageOrder:
    """The message in ``text``. Raises MessageError."""
    try:
        octets = text.encode()
    except UnicodeEncodeError:
        raise MessageError("the message is no valid UTF-8") from None
    if len(octets) > MOST_OCTETS:
        raise MessageError(f"the message has {len(octets)} octets, a message at most {MOST_OCTETS}")
    envelope = _decoded(octets, _Envelope, "message", _KINDS["hello"][1])
    bodies = {kind: getattr(envelope, kind) for kind in _KINDS if getattr(envelope, kind) is not UNSET}
    if len(bodies) != 1:
        raise MessageError("a message is an object with one key: hello, ask or order")
    ((kind, body),) = bodies.items()
    type_, example = _KINDS[kind]
    message = _decoded(body, type_, kind, example)
    if isinstance(message, Ask) and not _is_flat(message.args, _MOST_LEVELS):
        raise MessageError(f"ask: more than {_MOST_LEVELS} nested lists and objects among the arguments", message.id)
    return message


def _decoded(octets: bytes | Raw, type_: type[_T], what: str, example: str) -> _T:
    """``octets``, the JSON of ``what``, as a ``type_``. Raises MessageError."""
    try:
        return msgspec.json.decode(octets, type=type_)
    except RecursionError:
        reason = "it has too many nested brackets"
    except msgspec.ValidationError as error:
        reason = shortened(str(error), _MOST_OF_A_REASON)
    except msgspec.DecodeError:  # half of a surrogate pair, too
        reason = "it is no JSON"
    try:
        id = msgspec.json.decode(octets, type=_Numbered).id
    except (msgspec.DecodeError, RecursionError):
        id = None
    raise MessageError(f"{what}: {reason}; send for instance {example}", id)


def _is_flat(value: object, levels: int) -> bool:
    """Whether ``value`` has at most ``levels`` lists and objects within one another."""
    if not isinstance(value, (list, tuple, dict)):
        return True
    inner = value.values() if isinstance(value, dict) else value
    return levels > 0 and all(_is_flat(one, levels - 1) for one in inner)


def answer(id: int | None, result: object = None, *, error: str | None = None) -> str:
    """The answer to the ask or order ``id``: ``result``, or ``error``."""
    body: dict[str, object] = {"id": id, "ok": error is None}
    body |= {"result": result} if error is None else {"error": error}
    return encode({"answer": body})


def encode(message: Mapping[str, object]) -> str:
    """A message to a page as JSON. Values that JSON does not have become texts, infinite and undefined numbers null."""
    try:
        return json_text(message, default=str, allow_nan=False)
    except ValueError:
        return json_text(_finite(message), default=str)


def _finite(value: object) -> object:
    """``value`` without numbers that a browser's JSON does not have: it would refuse the whole message."""
    match value:
        case Mapping():
            return {key: _finite(one) for key, one in value.items()}
        case list() | tuple():
            return [_finite(one) for one in value]
        case float() if not isfinite(value):
            return None
    return value
