"""Asks of a page: reads, none of which changes the plant. The table of those that there are.

Each handler gets the source and the arguments, and returns a JSON value. It raises DpError or ValueError with one line
for the page. Further asks: add a line to :data:`HANDLERS`.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from typing import Any, Final

from dpstack.errors import UsageError
from dpstack.text import shortened
from dpstack.web.messages import Ask
from dpstack.web.source import Source

#: answers an ask: source, arguments
Handler = Callable[[Source, Sequence[Any]], Awaitable[object]]

#: asks of all pages together that are under way at the run
_MOST_AT_THE_RUN: Final = 4


def _texts(what: str, args: Sequence[Any], usage: str) -> tuple[str, ...]:
    """``args`` as texts for the control socket: ``usage`` names them. Raises UsageError."""
    if len(args) != len(usage.split()) or not all(isinstance(one, (str, int)) for one in args):
        raise UsageError(f"{what} takes {usage}")
    return tuple(map(str, args))


async def _why(source: Source, args: Sequence[Any]) -> object:
    return await source.call("why", *_texts("why", args, "SLAVE"))


async def _diag(source: Source, args: Sequence[Any]) -> object:
    return await source.call("diag", *_texts("diag", args, "ADDRESS"))


async def _records(source: Source, args: Sequence[Any]) -> object:
    slave, slot, index = _texts("records", args, "SLAVE SLOT INDEX")
    return await source.call("acyclic", slave, "read", slot, index)


async def _im(source: Source, args: Sequence[Any]) -> object:
    return await source.call("acyclic", *_texts("im", args, "SLAVE"), "im")


#: by ``what`` of the ask
HANDLERS: Final[dict[str, Handler]] = {"why": _why, "diag": _diag, "records": _records, "im": _im}


class Asks:
    """The asks of all pages of ``source``."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._places = asyncio.Semaphore(_MOST_AT_THE_RUN)

    async def answer(self, ask: Ask) -> object:
        """Raises DpError, ValueError."""
        handler = HANDLERS.get(ask.what)
        if handler is None:
            raise UsageError(f"there is no ask {shortened(ask.what)!r}; there are {', '.join(HANDLERS)}")
        async with self._places:
            return await handler(self._source, ask.args)
