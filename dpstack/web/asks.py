"""Asks of a page: reads, none of which changes the plant. The table of those that there are.

Each handler gets the source and the arguments, and returns a JSON value. It raises DpError or ValueError with one line
for the page. Further asks: add a line to :data:`HANDLERS`.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from datetime import datetime
from typing import Any, Final

from msgspec import structs

from dpstack import __version__
from dpstack.api.commissioning.commissioning import Commissioning
from dpstack.api.commissioning.sheet import blocks_of, title_of
from dpstack.api.commissioning.sheet_page import sheets_page
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
        raise UsageError(f"{what} takes {usage or 'no arguments'}")
    return tuple(map(str, args))


async def _why(source: Source, args: Sequence[Any]) -> object:
    return await source.call("why", *_texts("why", args, "SLAVE"))


async def _diag(source: Source, args: Sequence[Any]) -> object:
    return await source.call("diag", *_texts("diag", args, "ADDRESS"))


async def _records(source: Source, args: Sequence[Any]) -> object:
    slave, slot, index = _texts("records", args, "SLAVE SLOT INDEX")
    return await _read(source, slave, "read", slot, index)


async def _parameter(source: Source, args: Sequence[Any]) -> object:
    drive, parameter = _texts("parameter", args, "DRIVE PARAMETER")
    return await source.call("drive", drive, "read", parameter)


async def _rounds(source: Source, args: Sequence[Any]) -> object:
    return await source.call("rounds", *_texts("rounds", args, "AFTER" + " VALUE" * max(1, len(args) - 1)))


async def _scan(source: Source, args: Sequence[Any]) -> object:
    return await source.call("scan", *_texts("scan", args, ""))


async def _im(source: Source, args: Sequence[Any]) -> object:
    return await _read(source, *_texts("im", args, "SLAVE"), "im")


async def _stamps(source: Source, args: Sequence[Any]) -> object:
    """The time-stamped events of a record."""
    slave, index = _texts("stamps", args, "SLAVE INDEX")
    return await _read(source, slave, "stamps", index)


async def _pa(source: Source, args: Sequence[Any]) -> object:
    """A process device; with a second argument the parameter or block of this name."""
    texts = _texts("pa", args, "SLAVE NAME" if len(args) > 1 else "SLAVE")
    return await _read(source, texts[0], "pa", *(("read", *texts[1:]) if texts[1:] else ()))


async def _read(source: Source, *args: str) -> object:
    """Read as the master of class 1; of a slave without DP-V1 in its parameters over a class 2 connection."""
    try:
        return await source.call("acyclic", *args)
    except UsageError as refused:
        try:
            return await source.call("class2", *args)
        except UsageError:
            raise refused from None


async def _recording(source: Source, args: Sequence[Any]) -> object:
    _texts("recording", args, "")
    return await source.recording()


#: by ``what`` of the ask
HANDLERS: Final[dict[str, Handler]] = {
    "why": _why,
    "diag": _diag,
    "records": _records,
    "im": _im,
    "stamps": _stamps,
    "pa": _pa,
    "parameter": _parameter,
    "rounds": _rounds,
    "scan": _scan,
    "recording": _recording,
}


def _sheet(commissioning: Commissioning, slave: object) -> object:
    """The commissioning sheet of a slave in its parts, and as the file that ``dpstack sheet --html`` writes."""
    found = commissioning.typed_sheet(slave)
    return {
        "name": found.name,
        "address": found.address,
        "title": title_of(found),
        "blocks": [structs.asdict(block) for block in blocks_of(found)],
        "html": sheets_page([found], commissioning.name, __version__, datetime.now()),
    }


#: by ``what``: a function of the :class:`~dpstack.api.commissioning.commissioning.Commissioning`, most are its methods,
#: and its least and most arguments
COMMISSIONING: Final[dict[str, tuple[Callable[..., object], int, int]]] = {
    "files": (Commissioning.files, 0, 0),
    "match": (Commissioning.match, 1, 1),
    "modules": (Commissioning.modules, 1, 2),
    "table": (Commissioning.table, 1, 1),
    "check": (Commissioning.check, 1, 1),
    "toml": (Commissioning.toml, 1, 1),
    "sheet": (_sheet, 1, 1),
}


class Asks:
    """The asks of all pages of ``source``. ``commissioning``: None if there is no configuration."""

    def __init__(self, source: Source, commissioning: Commissioning | None = None) -> None:
        self._source = source
        self._commissioning = commissioning
        self._places = asyncio.Semaphore(_MOST_AT_THE_RUN)
        self._one_at_a_time = asyncio.Lock()

    async def answer(self, ask: Ask) -> object:
        """Raises DpError, ValueError."""
        if ask.what in COMMISSIONING:
            return await self._commission(ask)
        handler = HANDLERS.get(ask.what)
        if handler is None:
            known = ", ".join((*HANDLERS, *COMMISSIONING))
            raise UsageError(f"there is no ask {shortened(ask.what)!r}; there are {known}")
        async with self._places:
            return await handler(self._source, ask.args)

    async def _commission(self, ask: Ask) -> object:
        """In a thread: it reads files, and a large GSD file takes a second."""
        if self._commissioning is None:
            raise UsageError(
                f"{ask.what}: this server has no configuration: start it with one, `dpstack web plant.toml`"
            )
        method, least, most = COMMISSIONING[ask.what]
        if not least <= len(ask.args) <= most:
            count = f"{least}" if least == most else f"{least} or {most}"
            raise UsageError(f"{ask.what} takes {count} argument{'s' * (most != 1)}")
        async with self._one_at_a_time:
            return await asyncio.to_thread(method, self._commissioning, *ask.args)
