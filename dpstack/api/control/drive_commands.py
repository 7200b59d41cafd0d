"""Commands for a drive (``speed``, ``stop``, ``read`` ...): parser of their arguments, execution, answers in JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Coroutine, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

from dpstack.api.control import errors
from dpstack.api.control.commands import Spec, find_word
from dpstack.api.lists.dump_compare import ParameterPlace, ParameterValue
from dpstack.api.slave.drive import Drive
from dpstack.errors import ParameterError, UsageError
from dpstack.text import number_or_name, shortened

START: Final = "start"
#: for programs: what people are shown is a file
PARAMETERS: Final = "parameters"
READ_MANY: Final = "read_many"
#: after these the motor is off
HALTS: Final = frozenset({"stop", "quick_stop", "coast"})
#: they set something that lasts as long as a master keeps it
LASTING: Final = frozenset({START, "speed", "frequency"})

WORDS: Final = (
    Spec("status", "", "what the drive tells at this moment", ""),
    Spec("start", "", "walks its state machine until it runs, or says what is in the way", ""),
    Spec("stop", "", "ramp down, then off", ""),
    Spec("quick_stop", "", "stop by the quick stop ramp", ""),
    Spec("coast", "", "power off at once, the motor runs out", ""),
    Spec("reached", "", "wait until the set point is reached", ""),
    Spec("acknowledge", "", "acknowledge a fault until it is gone", ""),
    Spec("speed", "V", "the set point as a part of the reference: 0.5 or 50%", "0.5"),
    Spec("frequency", "V", "the set point in Hz", "25"),
    Spec("read", "P", "a parameter by number or name, in its unit", "480"),
    Spec("write", "P V", "writes a parameter in its unit", "480 20.5"),
    Spec(PARAMETERS, "", "the parameters that its plugin declares", ""),
    Spec(READ_MANY, "JSON", "several parameters, with data_set and index", '[{"number":964,"index":6}]'),
)
_MOTIONS: Final[Mapping[str, Callable[..., Coroutine[object, object, None]]]] = {
    START: Drive.start,
    "stop": Drive.stop,
    "quick_stop": Drive.quick_stop,
    "coast": Drive.coast,
    "reached": Drive.reached,
    "acknowledge": Drive.acknowledge,
}
#: which words an option is for
OPTIONS: Final[Mapping[str, frozenset[str]]] = {
    "data_set": frozenset({"read", "write"}),
    "index": frozenset({"read", "write"}),
    "ram": frozenset({"write"}),
    "timeout": frozenset({*_MOTIONS, "read", READ_MANY, "write"}),
}


@dataclass(slots=True)
class _Options:
    data_set: int | None = None
    index: int | None = None
    ram: bool = False
    timeout: float | None = None


@dataclass(frozen=True, slots=True)
class ParsedOrder:
    """One of :data:`WORDS` with its arguments. ``value``: in the unit of a parameter or of the set point."""

    word: str
    options: _Options
    parameter: int | str = ""
    value: float = 0.0
    places: tuple[ParameterPlace, ...] = ()

    @property
    def for_plugin(self) -> tuple[str, dict[str, object]] | None:
        """The order and its arguments as the drive's plugin takes them; None where it has nothing to do."""
        options = self.options
        given: dict[str, object]
        match self.word:
            case "status" | "parameters":
                return None
            case "speed" | "frequency":
                given = {"value": self.value}
            case "read":
                given = {"number": self.parameter, "data_set": options.data_set, "index": options.index}
            case "write":
                given = {"number": self.parameter, "value": self.value, "data_set": options.data_set}
                given |= {"index": options.index, "ram": options.ram or None}
            case "read_many":
                given = {"parameters": [place.as_dict() for place in self.places]}
            case _:
                given = {}
        given["timeout_s"] = options.timeout
        return self.word, {key: value for key, value in given.items() if value is not None}


def parse_order(word: str, args: Sequence[str]) -> ParsedOrder:
    """One of :data:`WORDS` with its arguments; among them ``data_set=3``, ``index=1``, ``ram=true``, ``timeout=20``.

    Raises UsageError.
    """
    spec = find_word(word, WORDS)
    plain = [text for text in args if text.partition("=")[0] not in OPTIONS]
    options = _options(word, [text for text in args if text not in plain])
    if len(plain) != len(spec.usage.split()):
        raise spec.wrong_arguments()
    match word:
        case "read":
            return ParsedOrder(word, options, parameter=number_or_name(plain[0]))
        case "write":
            return ParsedOrder(word, options, parameter=number_or_name(plain[0]), value=_value(plain[1]))
        case "read_many":
            return ParsedOrder(word, options, places=tuple(_places(plain[0])))
        case "speed" | "frequency":
            return ParsedOrder(word, options, value=_value(plain[0]))
    return ParsedOrder(word, options)


async def carry_out(drive: Drive, word: str, args: Sequence[str]) -> dict[str, Any]:
    """Carry out one order, see :func:`parse_order`. Raises UsageError, and what the drive raises."""
    order = parse_order(word, args)
    options = order.options
    answer: dict[str, Any] = {"order": word, "drive": drive.name, "address": drive.address, "type": drive.kind}
    seconds = 5.0 if options.timeout is None else options.timeout
    places = {"data_set": options.data_set, "index": options.index}
    match word:
        case "read":
            found = await drive.parameter(order.parameter, **places, timeout=seconds)
            return {**answer, "parameter": asdict(found)}
        case "write":
            found = await drive.write(order.parameter, order.value, **places, ram=options.ram, timeout=seconds)
            return {**answer, "parameter": asdict(found)}
        case "parameters":
            listed = [asdict(one) for one in drive.parameters]
            return {**answer, "per_request": drive.per_request, "parameters": listed}
        case "read_many":
            entries = await drive.read_many(order.places, timeout=seconds)
            return {**answer, "parameters": [_entry(one) for one in entries]}
        case "speed" | "frequency":
            await drive.order(word, value=order.value)
        case "status":
            pass
        case _:
            motion = _MOTIONS[word]
            await (motion(drive) if options.timeout is None else motion(drive, options.timeout))
    return {**answer, "status": drive.status.as_dict()}


def _places(text: str) -> list[ParameterPlace]:
    try:
        return [ParameterPlace(**one) for one in json.loads(text)]
    except (ValueError, TypeError, RecursionError):
        raise UsageError(f'{shortened(text)}: write for instance [{{"number":964,"index":6}}]') from None


def _entry(one: ParameterValue | ParameterError) -> dict[str, object]:
    return {"error": str(one), **errors.error_fields(one)} if isinstance(one, ParameterError) else asdict(one)


def _options(word: str, given: Sequence[str]) -> _Options:
    options = _Options()
    for text in given:
        name, _, value = text.partition("=")
        if word not in OPTIONS[name]:
            raise UsageError(f"{word} has no {name}; it is for {', '.join(sorted(OPTIONS[name]))}")
        try:
            if name == "ram":
                options.ram = {"true": True, "false": False}[value.lower()]
            elif name == "timeout":
                options.timeout = _seconds(value)
            elif name == "index":
                options.index = int(value)
            else:
                options.data_set = int(value)
        except (ValueError, KeyError):
            example = "true" if name == "ram" else "1"
            raise UsageError(f"{name}={shortened(value)}: write for instance {name}={example}") from None
    return options


def _seconds(text: str) -> float:
    seconds = float(text)
    if not 0 <= seconds < math.inf:
        raise ValueError(text)
    return seconds


def _value(text: str) -> float:
    """A number as typed: 20.5, 0x1F, 50%."""
    try:
        if text.lower().startswith("0x"):
            return int(text, 16)
        return float(text[:-1]) / 100 if text.endswith("%") else float(text)
    except ValueError:
        raise UsageError(f"{text!r} is no number; write for instance 20.5") from None
