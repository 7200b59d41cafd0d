"""Records of a slave of another program: commands to the ``run`` that holds the port, over its control socket."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncGenerator, Sequence
from typing import Annotated, Any, Final, NotRequired, TypedDict

import msgspec

from dpstack.api.bus.bus import Bus
from dpstack.api.bus.parts import SEARCHING
from dpstack.api.config.config import Config
from dpstack.api.control.client import find_run
from dpstack.api.control.record_commands import COMPARE, DUMP, PARAMETERS, OnProgress, carry_out, check
from dpstack.api.control.server import Result, kept_alive
from dpstack.api.lists.record_list import ListedValues
from dpstack.errors import BusError, UsageError
from dpstack.text import number_or_name

#: parameters in one line of an answer: it stays well below what the server keeps for a slow reader
_IN_A_LINE: Final = 100

Hex = Annotated[str, msgspec.Meta(pattern=r"^(?:[0-9a-fA-F]{2})*$")]


class _OfSlave(TypedDict):
    slave: str
    address: int
    slot: int


class WriteAnswer(_OfSlave):
    """``write`` of a slave's record."""

    index: int
    length: int


class RecordAnswer(WriteAnswer):
    """``read`` and ``transport`` of a slave."""

    data: Hex


class ListAnswer(_OfSlave):
    """``parameters`` of a slave; the entries come in items before."""

    object: int
    ident: int
    parameters: NotRequired[list[ListedValues]]


class ImAnswer(_OfSlave):
    """``im`` of a slave: the fields of each record, by its number."""

    im: dict[str, dict[str, Any]]


#: of a slave's records, by the order
OF_SLAVE: Final[dict[str, type]] = {
    "read": RecordAnswer,
    "transport": RecordAnswer,
    "write": WriteAnswer,
    "parameters": ListAnswer,
    "im": ImAnswer,
}

#: the commands of a run, by class of master
COMMANDS: Final = {1: "acyclic", 2: "class2"}


async def acyclic_order(bus: Bus, args: list[str], *, class2: bool = False) -> AsyncGenerator[object, None]:
    """``SLAVE ORDER [ARG]...`` at a slave of a run, with ``class2`` over a connection of its own, which is closed
    afterwards. A client that hangs up ends the order.

    Items tell its ``state`` and, where it takes its time, ``progress``; a long list comes in items before its result.
    """
    if bus.searching:
        raise BusError(f"{SEARCHING}: the slaves are known once it is found")
    name, word, *rest = args
    slave = bus.slave(number_or_name(name))
    who = f"ctl {COMMANDS[2 if class2 else 1]}"
    if word in (DUMP, COMPARE):
        with_class = " --class 2" if class2 else ""
        raise UsageError(
            f"{who} has no files: `dpstack acyclic CONFIG {name} {word} FILE{with_class}` has, and goes through this "
            f"run; {PARAMETERS} gives the same list"
        )
    check(word, rest, class2=class2, who=who)
    progress: list[object] = []

    def sign() -> dict[str, object]:
        return {"state": slave.state.value, **({"progress": progress} if progress else {})}

    def on_progress(*one: object) -> None:
        progress[:] = one

    async def work() -> dict[str, Any]:
        if not class2:
            return await carry_out(slave, word, rest, on_progress)
        async with bus.class2.connect(slave) as connection:
            return await carry_out(connection, word, rest, on_progress)

    async with contextlib.aclosing(kept_alive(work(), sign)) as items:
        async for item in items:
            if isinstance(item, Result) and isinstance(item.value, dict) and PARAMETERS in item.value:
                found = item.value[PARAMETERS]
                for at in range(0, len(found), _IN_A_LINE):
                    yield {PARAMETERS: found[at : at + _IN_A_LINE]}
                item = Result({key: value for key, value in item.value.items() if key != PARAMETERS})
            yield item


async def through_run(
    config: Config, slave: int, word: str, args: Sequence[str], progress: OnProgress | None = None, *, master: int = 1
) -> dict[str, Any] | None:
    """As :func:`~dpstack.api.control.record_commands.carry_out`, by the run that has the port and the file of
    ``config``; None where no run answers for the port. ``master``: class 1 or 2.

    Raises what it raises there, UsageError where the run has another configuration file or no such slave, PortError.
    ``progress`` is called by another thread.
    """
    client = await asyncio.to_thread(find_run, config.port, config.file)
    if client is None:
        return None
    with client:
        answer = await asyncio.to_thread(
            client.ask, COMMANDS[master], str(slave), word, *args, kind=OF_SLAVE.get(word), progress=progress
        )
    return {PARAMETERS: [], **answer, "order": word} if word == PARAMETERS else {**answer, "order": word}
