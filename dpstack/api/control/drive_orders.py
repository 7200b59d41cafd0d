"""Orders to a drive (``speed``, ``stop``, ``read`` ...), and to another device: words, parser, execution, answers in
JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, Final

from dpstack.api.bus.bus import Bus
from dpstack.api.control import errors
from dpstack.api.control.commands import NOW, Arguments, ParsedCommand, Spec, find_word
from dpstack.api.control.control_server import LongCommand, kept_alive
from dpstack.api.control.orders import drive_for, perform
from dpstack.api.lists.parameter_list import ParameterPlace, ParameterValue
from dpstack.api.slave.drive import Drive
from dpstack.errors import ParameterError, UsageError
from dpstack.plant.orders import HALTS
from dpstack.text import number_or_name, shortened

START: Final = "start"
#: for programs; people use dump, which writes a file
PARAMETERS: Final = "parameters"
READ_MANY: Final = "read_many"

WORDS: Final = (
    Spec("status", "", "the state of the drive at this moment", ""),
    Spec("start", "", "walks its state machine until it runs, or says what is in the way", ""),
    Spec("stop", "", "ramp down, then off", ""),
    Spec("quick_stop", "", "stop by the quick stop ramp", ""),
    Spec("coast", "", "power off at once, the motor runs out", ""),
    Spec("reached", "", "wait until the set point is reached", ""),
    Spec("acknowledge", "", "acknowledge a fault until it is gone", ""),
    Spec("speed", "V", "the set point as a part of the reference: 0.5 or 50%", "0.5"),
    Spec("frequency", "V", "the set point in Hz", "25"),
    Spec("rpm", "V", "the set point in rpm, if it is known what 100 % is in rpm", "750"),
    Spec("order", "ORDER", "an order of its device file or plugin by name", "jog_on"),
    Spec("read", "P", "a parameter by number or name, in its unit", "480"),
    Spec("write", "P V", "writes a parameter in its unit", "480 20.5"),
    Spec(PARAMETERS, "", "the parameters that its plugin declares", ""),
    Spec(READ_MANY, "JSON", "several parameters, with data_set and index", '[{"number":964,"index":6}]'),
)
#: orders with the name of a method of a drive
_MOTIONS: Final = frozenset({*HALTS, START, "reached", "acknowledge"})
#: the orders that take an option
OPTIONS: Final[Mapping[str, frozenset[str]]] = {
    "data_set": frozenset({"read", "write"}),
    "index": frozenset({"read", "write"}),
    "ram": frozenset({"write"}),
    "timeout": _MOTIONS | {"read", READ_MANY, "write"},
}


def parse_order(word: str, texts: Sequence[str]) -> ParsedCommand:
    """Parse an order of :data:`WORDS` and its arguments, such as ``data_set=3``, ``index=1``, ``ram=true``,
    ``timeout=20``. Raises UsageError.
    """
    spec = find_word(word, WORDS)
    options: dict[str, object] = {}
    args = []
    for text in texts:
        name, _, value = text.partition("=")
        if name in OPTIONS:
            options[name] = _option(word, name, value)
        else:
            args.append(text)
    return spec.order(args, ARGUMENTS, options)


def drive_order(bus: Bus, args: list[str]) -> LongCommand:
    """``NAME ORDER [ARG]...`` to a drive of a run. A client that closes the connection cancels the order."""
    drive, order = find_order(bus, args)
    return lambda send: kept_alive(carry_out(drive, order), lambda: {"status": drive.status.as_dict()}, send)


def device_order(bus: Bus, args: list[str]) -> LongCommand:
    """``SLAVE ORDER [NAME=VALUE]...`` to a device or a drive, an order of its own. A client that closes the connection
    cancels it."""
    slave, op = bus.slave(number_or_name(args[0])), args[1]
    values: dict[str, float] = {}
    for text in args[2:]:
        name, equals, number = text.partition("=")
        if not equals:
            raise UsageError(f"{shortened(text)}: write NAME=VALUE, for instance value=1000")
        values[name] = _number(number)
    timeout = values.pop("timeout", None)
    drive = next((one for one in bus.drives if one.slave is slave), None)

    async def carry_out() -> dict[str, Any]:
        if drive is not None:
            value = await drive.order(op, 5.0 if timeout is None else timeout, **values)
        else:
            value = await slave.order(op, timeout, **values)
        return {"order": op, "slave": slave.name, "address": slave.address, "value": value}

    return lambda send: kept_alive(carry_out(), lambda: {"state": slave.state.value}, send)


def find_order(bus: Bus, args: Sequence[str]) -> tuple[Drive, ParsedCommand]:
    """The drive and the order of ``[now] NAME ORDER [ARG]...``. (A drive may be called "now": then an order stands
    behind it.) Raises UsageError, and as :func:`~dpstack.api.control.orders.drive_for`."""
    now = len(args) > 2 and args[0] == NOW and all(args[1] != spec.name for spec in WORDS)
    name, word, *texts = args[1:] if now else args
    return drive_for(bus, number_or_name(name), word, now=now), parse_order(word, texts)


async def carry_out(drive: Drive, order: ParsedCommand) -> dict[str, Any]:
    """Carry out ``order``. Returns the answer as plain data. Raises the errors of the methods of the drive."""
    word, values = order.word, order.values
    answer: dict[str, Any] = {"order": word, "drive": drive.name, "address": drive.address, "type": drive.kind}
    match word:
        case "read" | "write":
            found = await (drive.parameter if word == "read" else drive.write)(**values)
            return {**answer, "parameter": asdict(found)}
        case "parameters":
            listed = [asdict(one) for one in drive.parameters]
            return {**answer, "per_request": drive.per_request, "parameters": listed}
        case "read_many":
            return {**answer, "parameters": [_entry(one) for one in await drive.read_many(**values)]}
        case "status":
            pass
        case _:
            await perform(drive, word, values)
    return {**answer, "status": drive.status.as_dict()}


def _entry(one: ParameterValue | ParameterError) -> dict[str, object]:
    return {"error": str(one), **errors.error_fields(one)} if isinstance(one, ParameterError) else asdict(one)


def _option(word: str, name: str, text: str) -> object:
    if word not in OPTIONS[name]:
        raise UsageError(f"{word} has no {name}; it is for {', '.join(sorted(OPTIONS[name]))}")
    try:
        if name == "ram":
            return {"true": True, "false": False}[text.lower()]
        if name != "timeout":
            return int(text)
        seconds = float(text)
        if 0 <= seconds < math.inf:
            return seconds
    except (ValueError, KeyError):
        pass
    raise UsageError(f"{name}={shortened(text)}: write for instance {name}={'true' if name == 'ram' else '1'}")


def _places(text: str) -> list[ParameterPlace]:
    try:
        return [ParameterPlace(**one) for one in json.loads(text)]
    except (ValueError, TypeError, RecursionError):
        raise UsageError(f'{shortened(text)}: write for instance [{{"number":964,"index":6}}]') from None


def _number(text: str) -> float:
    """A number as typed: 20.5, 0x1F, 50%."""
    try:
        if text.lower().startswith("0x"):
            return int(text, 16)
        return float(text[:-1]) / 100 if text.endswith("%") else float(text)
    except ValueError:
        raise UsageError(f"{text!r} is no number; write for instance 20.5") from None


#: the names in the usages of :data:`WORDS`, as keyword arguments of the methods of a drive
ARGUMENTS: Final[Arguments] = {
    "P": ("number", number_or_name),
    "V": ("value", _number),
    "ORDER": ("op", str),
    "JSON": ("parameters", _places),
}
