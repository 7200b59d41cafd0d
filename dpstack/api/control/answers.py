"""Answers of the control socket: the fields that every program's answers have, and the check of fields.

The program at the other end may be another version of dpstack, or something else. Unknown fields pass unchanged, so
that a newer program may have more of them.
"""

from __future__ import annotations

from typing import Any, NotRequired, TypedDict, TypeVar

from dpstack.errors import PortError

T = TypeVar("T")


class Command(TypedDict):
    """A command in :class:`Help`."""

    command: str
    args: str
    text: str


class Help(TypedDict):
    """``help``: what the program is."""

    kind: str
    port: str
    pid: int
    commands: list[Command]
    name: NotRequired[str]
    config: NotRequired[str | None]


class Item(TypedDict, total=False):
    """An item before the result of a long command: its progress, a part of a long list."""

    progress: tuple[str, int, int]
    parameters: list[Any]


def checked(value: object, kind: type[T], port: str, command: str) -> T:
    """The fields of ``kind`` in ``value``, which the program on ``port`` answered to ``command``. Raises PortError."""
    import msgspec  # most answers of `dpstack ctl` are not checked

    try:
        return msgspec.convert(value, kind)
    except (msgspec.ValidationError, UnicodeError) as error:  # a lone surrogate in a key, for instance
        raise PortError(
            f"{port}: the answer to {command!r} is not as dpstack writes it ({error}): is it another version?"
        ) from None
