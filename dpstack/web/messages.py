"""Messages of a page: ``hello``, ``ask`` and ``order``, checked; and the texts that are sent to it.

A page is a stranger: it may send anything. :func:`parse` either returns a message whose every part has its type and its
bounds, or raises :class:`MessageError` with one line for that page.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any, Final, NoReturn

from dpstack.text import json_text, printable, shortened

#: octets of a message of a page
MOST_OCTETS: Final = 262_144
#: nested brackets in it
_MOST_LEVELS: Final = 12
#: arguments of an ask or an order, and characters of one of an order; an ask may have a whole configuration
_MOST_ARGS: Final = 64
_LONGEST_ARG: Final = 4_096
#: the largest whole number that JavaScript keeps exactly
_MOST_ID: Final = 2**53 - 1
_LONGEST_TOKEN: Final = 1_024


class MessageError(Exception):
    """A message that is not as the protocol has it. ``id``: the number of the ask or order; None where it has none."""

    def __init__(self, text: str, id: int | None = None) -> None:
        super().__init__(printable(text))
        self.id = id


@dataclass(frozen=True, slots=True)
class Hello:
    """The first message. ``token``: None where the page has none."""

    token: str | None


@dataclass(frozen=True, slots=True)
class Ask:
    """A read. ``args``: JSON values."""

    id: int
    what: str
    args: tuple[Any, ...]


@dataclass(frozen=True, slots=True)
class Order:
    """Something that changes the plant. ``confirmed``: the person at the page has confirmed it there."""

    id: int
    command: str
    args: tuple[str, ...]
    confirmed: bool

    @property
    def text(self) -> str:
        """The order on one line, for people and logs."""
        return printable(" ".join((self.command, *self.args)))


def parse(text: str) -> Hello | Ask | Order:
    """The message in ``text``. Raises MessageError."""
    try:
        size = len(text.encode())
    except UnicodeEncodeError:
        raise MessageError("the message is no valid UTF-8") from None
    if size > MOST_OCTETS:
        raise MessageError(f"the message has {size} octets, a message at most {MOST_OCTETS}")
    if _levels(text) > _MOST_LEVELS:
        raise MessageError(f"the message has more than {_MOST_LEVELS} nested brackets")
    try:
        message = json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError):
        raise MessageError('the message is no JSON; send for instance {"hello":{"token":null}}') from None
    if not isinstance(message, dict) or len(message) != 1:
        raise MessageError("a message is an object with one key: hello, ask or order")
    (kind, body), *_ = message.items()
    if kind not in _KINDS:
        raise MessageError(f"a message is hello, ask or order, not {shortened(kind)!r}")
    if not isinstance(body, dict):
        raise MessageError(f"{kind} is an object")
    return _KINDS[kind](body)


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


def _hello(body: dict[str, Any]) -> Hello:
    token = body.get("token")
    if token is not None and not (isinstance(token, str) and len(token) <= _LONGEST_TOKEN and _is_text(token)):
        raise MessageError(f"the token is null, or a text of up to {_LONGEST_TOKEN} characters")
    return Hello(token)


def _ask(body: dict[str, Any]) -> Ask:
    id = _id_of(body, "ask")
    what = body.get("what")
    if not isinstance(what, str) or not _is_text(what):
        raise MessageError('an ask has "what", for instance "why"', id)
    return Ask(id, what, _args_of(body, id, MOST_OCTETS))


def _order(body: dict[str, Any]) -> Order:
    id = _id_of(body, "order")
    command = body.get("command")
    if not isinstance(command, str) or not _is_text(command):
        raise MessageError('an order has "command", for instance "operate"', id)
    args = _args_of(body, id, _LONGEST_ARG)
    if not all(isinstance(one, str) for one in args):
        raise MessageError('the arguments of an order are texts, for instance ["valves.limit=on"]', id)
    if not isinstance(body.get("confirmed", False), bool):
        raise MessageError('"confirmed" is true or false', id)
    return Order(id, command, args, body.get("confirmed", False))


_KINDS: Final[dict[str, Callable[[dict[str, Any]], Hello | Ask | Order]]] = {
    "hello": _hello,
    "ask": _ask,
    "order": _order,
}


def _id_of(body: dict[str, Any], kind: str) -> int:
    id = body.get("id")
    if isinstance(id, bool) or not isinstance(id, int) or not 0 <= id <= _MOST_ID:
        raise MessageError(f'{kind} has no "id", a whole number from 0 to {_MOST_ID}')
    return id


def _args_of(body: dict[str, Any], id: int, longest: int) -> tuple[Any, ...]:
    args = body.get("args", [])
    if not isinstance(args, list) or len(args) > _MOST_ARGS:
        raise MessageError(f'"args" is a list of up to {_MOST_ARGS} values', id)
    left: list[object] = list(args)
    while left:
        one = left.pop()
        if isinstance(one, dict):
            left += [*one, *one.values()]
        elif isinstance(one, list):
            left += one
        elif isinstance(one, str) and not (len(one) <= longest and _is_text(one)):
            raise MessageError(f"a text among the arguments is longer than {longest} characters, or no text", id)
    return tuple(args)


def _is_text(text: str) -> bool:
    """False with a lone surrogate, which JSON can write and UTF-8 cannot."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def _levels(text: str) -> int:
    """The number of nested brackets in JSON ``text``, those in its strings left out."""
    level = most = 0
    quoted = escaped = False
    for letter in text:
        if escaped:
            escaped = False
        elif quoted:
            escaped = letter == "\\"
            quoted = letter != '"'
        elif letter == '"':
            quoted = True
        elif letter in "[{":
            level += 1
            most = max(most, level)
        elif letter in "]}":
            level -= 1
    return most


def _refuse_constant(name: str) -> NoReturn:
    """NaN and Infinity, which JSON does not have."""
    raise ValueError(name)
