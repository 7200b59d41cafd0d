"""Commands for the records of a slave (``read``, ``write`` ...), of ``dpstack acyclic`` and the control socket."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, Final, Protocol

from dpstack.api.config.table import parse_hex
from dpstack.api.control.commands import Spec, find_word
from dpstack.api.lists.record_list import ListedValues
from dpstack.api.slave.ms2_connection import Connection
from dpstack.api.slave.record_parameters import RecordParameters
from dpstack.api.slave.slave import Slave
from dpstack.dp.pdu.layouts import MAX_RECORD, MAX_SLOT
from dpstack.dpv1.pdu.im import Im, Im0
from dpstack.errors import AcyclicError, SlaveFault, UsageError
from dpstack.profile.record47 import Progress
from dpstack.text import shortened

PARAMETERS: Final = "parameters"
WORDS: Final = (
    Spec("read", "SLOT INDEX [LENGTH]", "a record, as hex; LENGTH: at most so many octets", "1 47"),
    Spec("write", "SLOT INDEX HEX", "all octets of a record", "1 47 00FF"),
    Spec(
        PARAMETERS, "[SLOT] [OBJECT]", "the device's own list of parameters (PROFIdrive, 980 to 989), all values", "1"
    ),
    Spec("im", "[SLOT]", "I&M0, and those of I&M1 to 4 that it says there are", ""),
)
#: what `dpstack acyclic` makes of PARAMETERS itself: a run writes no files
DUMP, COMPARE = "dump", "compare"
TRANSPORT: Final = Spec("transport", "SLOT INDEX [HEX]", "Data_Transport (class 2): to the slave and back", "0 1 00FF")


class Target(Protocol):
    """Whose records they are: a slave of this master, or a class 2 connection."""

    @property
    def name(self) -> str: ...

    @property
    def address(self) -> int: ...

    async def read(self, slot: int, index: int, length: int | None = None) -> bytes:
        """A record."""

    async def write(self, slot: int, index: int, data: bytes) -> None:
        """A record."""

    async def im(self, number: int = 0, *, slot: int = 0) -> Im: ...

    def parameters(self, slot: int = 1, *, object: int = 1) -> RecordParameters:
        """Record 47."""


#: of each number, by its name in a usage
_HIGHEST: Final = {"SLOT": MAX_SLOT, "INDEX": 255, "LENGTH": MAX_RECORD, "OBJECT": 255}
#: what is being read, how many of it, of how many
OnProgress = Callable[[str, int, int], None]
#: slot and object where nothing is said
_FIRST_OBJECT: Final = (1, 1)


def check(word: str, args: Sequence[str], *, class2: bool = False, who: str = "dpstack acyclic") -> None:
    """Raises UsageError where ``word`` or what belongs to it cannot be; ``who``: has been told."""
    if word == TRANSPORT.name and not class2:
        raise UsageError("Data_Transport is a service of class 2 connections: add --class 2 (`ctl`: class2)")
    spec = find_word(word, (*WORDS, TRANSPORT) if class2 else WORDS, who)
    spec.check(list(args))
    for name, text in zip(spec.usage.split(), args, strict=False):
        _octets(text) if name.strip("[]") == "HEX" else _check_number(name.strip("[]"), text)


async def carry_out(
    slave: Target, word: str, args: Sequence[str], progress: OnProgress | None = None
) -> dict[str, Any]:
    """One word with its arguments; what came of it as plain data. Raises what :meth:`Slave.read` raises.

    ``parameters`` raises what :class:`~dpstack.api.slave.record_parameters.RecordParameters` raises, too, and tells how
    far it is.
    """
    check(word, args, class2=isinstance(slave, Connection))
    head = {"order": word, "slave": slave.name, "address": slave.address}
    match word:
        case "read":
            slot, index, *length = _numbers(args)
            data = await slave.read(slot, index, *length)
            return {**head, "slot": slot, "index": index, "length": len(data), "data": data.hex()}
        case "write":
            slot, index = _numbers(args[:2])
            octets = _octets(args[2])
            await slave.write(slot, index, octets)
            return {**head, "slot": slot, "index": index, "length": len(octets)}
        case "transport":
            assert isinstance(slave, Connection)
            slot, index = _numbers(args[:2])
            back = await slave.transport(slot, index, _octets(args[2]) if len(args) > 2 else b"")
            return {**head, "slot": slot, "index": index, "length": len(back), "data": back.hex()}
        case "parameters":
            slot, axis = (*_numbers(args), *_FIRST_OBJECT[len(args) :])
            return {**head, "slot": slot, "object": axis, **await _all_parameters(slave, slot, axis, progress)}
        case _:
            (slot,) = _numbers(args) or (0,)
            return {**head, "slot": slot, "im": await _all_im(slave, slot)}


async def _all_parameters(slave: Target, slot: int, axis: int, progress: OnProgress | None) -> dict[str, object]:
    parameters = slave.parameters(slot, object=axis)

    def counter(what: str) -> Progress | None:
        return None if progress is None else lambda done, of: progress(what, done, of)

    found = await parameters.read_out(progress=counter("values"), describing=counter("descriptions"))
    return {"ident": await _ident_of(slave), "parameters": [ListedValues.of(one).as_dict() for one in found]}


async def _ident_of(slave: Target) -> int:
    if isinstance(slave, Connection):
        return await slave.ident()
    assert isinstance(slave, Slave)
    if slave.setup.ident is not None:
        return slave.setup.ident
    return 0 if slave.diagnosis is None else slave.diagnosis.ident  # "ask": in data exchange it has told


async def _all_im(slave: Target, slot: int) -> dict[str, dict[str, object]]:
    im0 = await slave.im(0, slot=slot)
    found: dict[str, dict[str, object]] = {"0": _plain(im0)}
    for number in range(1, 5):
        if isinstance(im0, Im0) and im0.supported & (1 << number):
            try:
                found[str(number)] = _plain(await slave.im(number, slot=slot))
            except (AcyclicError, SlaveFault) as error:  # it says that it has it
                found[str(number)] = {"error": str(error)}
    return found


def _plain(record: Im) -> dict[str, object]:
    fields = dataclasses.asdict(record)
    return {name: value.hex() if isinstance(value, bytes) else value for name, value in fields.items()}


def _check_number(name: str, text: str) -> None:
    try:
        value = int(text, 0)
    except ValueError:
        value = -1
    highest = _HIGHEST[name]
    if not 0 <= value <= highest:
        raise UsageError(f"{shortened(text)!r} is no {name}: write a number 0..{highest}, 0x2F for instance")


def _numbers(args: Sequence[str]) -> tuple[int, ...]:
    """What :func:`check` has found to be numbers."""
    return tuple(int(text, 0) for text in args)


def _octets(text: str) -> bytes:
    try:
        return parse_hex(text)
    except ValueError as error:
        raise UsageError(f"{text!r}: {error}; write octets as 00FF") from None
