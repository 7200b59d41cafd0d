"""The fields of answers over the control socket, by which a client checks them."""

from __future__ import annotations

from typing import Any, NotRequired, TypedDict


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
