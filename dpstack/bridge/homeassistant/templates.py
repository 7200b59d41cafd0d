"""Templates of Jinja by which Home Assistant reads values of plain JSON and writes orders.

A name in a template is a literal in which every character is an escape but ASCII letters and digits, space, ``_`` and
``-``: so no name can end the literal, or begin a statement.
"""

from __future__ import annotations

import string
from typing import Final

_PLAIN: Final = frozenset(string.ascii_letters + string.digits + " _-")
#: the time of the sender, without which an order is refused
_TIME: Final = '"time": {{ now().timestamp() }}'
#: an order without an argument, and one with the value that Home Assistant puts into it
PRESS: Final = "{" + _TIME + "}"
COMMAND: Final = '{"value": {{ value }}, ' + _TIME + "}"
#: of the set point of a drive, which is in percent for people
COMMAND_PERCENT: Final = '{"value": {{ value / 100 }}, ' + _TIME + "}"
#: the last order and its result; why it was refused
_RESULT: Final = "{% set v = value_json | default({}) %}"
RESULT: Final = _RESULT + "{{ (v.get('order') ~ ': ' ~ v.get('result'))[:255] }}"
RESULT_ATTRIBUTES: Final = _RESULT + "{{ {'reason': v.get('reason'), 'order_time': v.get('order_time')} | tojson }}"
#: words for true and false, in states and orders
TRUE: Final = "true"
FALSE: Final = "false"


def literal(text: str) -> str:
    """``text`` as a literal of Jinja, in ASCII."""
    return "'" + "".join(letter if letter in _PLAIN else _escape(ord(letter)) for letter in text) + "'"


def _escape(code: int) -> str:
    return f"\\u{code:04x}" if code <= 0xFFFF else f"\\U{code:08x}"


def _member(name: str) -> str:
    """The statement that makes ``v`` of the member ``name``; an empty object if it is not there."""
    return "{% set v = (value_json | default({})).get(" + literal(name) + ") | default({}, true) %}"


def quality(name: str) -> str:
    """``true`` while the value ``name`` is one of this moment."""
    return _member(name) + "{{ 'true' if v.get('quality') in ['good', 'uncertain'] else 'false' }}"


def attributes(name: str) -> str:
    """Quality and reason of the value ``name``. Not its time: each change of an attribute is a row in a database."""
    return _member(name) + "{{ {'quality': v.get('quality'), 'reason': v.get('reason')} | tojson }}"


def flag(name: str) -> str:
    return _member(name) + "{{ {true: 'true', false: 'false'}.get(v.get('value')) }}"


def number(name: str) -> str:
    return _member(name) + "{{ v.get('value') }}"


def percent(name: str) -> str:
    return _member(name) + "{{ none if v.get('value') is none else (v.value * 100) | round(1) }}"


def text(name: str) -> str:
    """Home Assistant takes no state of more than 255 characters, and shows an empty one as nothing at all."""
    return _member(name) + "{{ (v.get('value') | string)[:255] or 'none' }}"
