"""The examples of a device file: octets of the manual with their meaning, compared with what the drive's core makes.

An example is carried out in virtual time: the core of a master and the simulated drive exchange data, without a bus.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pkgutil import resolve_name
from typing import Final

from msgspec import Struct

from dpstack.devices.drive_core import SET
from dpstack.devices.model import DeviceFile, EncoderFile, Example, FileFacts, Messages, WordSpec, value_of
from dpstack.devices.profiles import profile_of
from dpstack.errors import ConfigError, DpError
from dpstack.profile.drive_profile import DriveProfile
from dpstack.profile.master.core import DriveCore
from dpstack.profile.model.drive_type import CHANNEL_LEN, CHECK_SETTINGS
from dpstack.profile.model.states import FAULTED
from dpstack.profile.simulator.device import DriveDevice
from dpstack.text import some_of
from dpstack.units import NS_PER_MS

#: the contradictions of an example to its file; PA devices have a room above this one
Mistakes = Callable[[FileFacts, Example], Iterator[str]]
_ENCODER_MISTAKES: Final = "dpstack.devices.encoder_examples:encoder_mistakes"
_PA_MISTAKES: Final = "dpstack.devices.pa.examples:pa_mistakes"
_CYCLE_NS: Final = 2 * NS_PER_MS
#: cycles until both ends are up, and until a fault has been noticed
_UP: Final = 100
#: cycles that an order in front of the last one gets
_BEFORE: Final = 250
#: cycles that an order gets
_MOST: Final = 3000
#: telegrams in a message
_SHOWN: Final = 4
#: of the value: rounding in a manual
_ROUNDED: Final = 5e-4
_TODO: Final = "correct the example, or the words of the file that it contradicts"


class Result(Struct, frozen=True):
    """An example and its contradictions to the file; none if it holds."""

    example: Example
    errors: tuple[ConfigError, ...]


def run_examples(file: FileFacts) -> tuple[Result, ...]:
    """Carry out all examples of ``file``. Raises ConfigError if the Python that it names cannot be loaded."""
    if not isinstance(file, DeviceFile):
        name = _ENCODER_MISTAKES if isinstance(file, EncoderFile) else _PA_MISTAKES
        mistakes: Mistakes = resolve_name(name)  # here, as drives are neither
        return tuple(Result(one, tuple(_at(file, one, _found(mistakes, file, one)))) for one in file.examples)
    profile = profile_of(file)
    return tuple(Result(one, tuple(_errors(file, profile, one))) for one in file.examples)


def _found(mistakes: Mistakes, file: FileFacts, example: Example) -> list[str]:
    try:
        return list(mistakes(file, example))
    except (DpError, OSError) as error:
        return [str(error)]


def _errors(file: DeviceFile, profile: DriveProfile, example: Example) -> Iterator[ConfigError]:
    try:
        found = list(_Bench(file, profile, example).contradictions())
    except ConfigError as error:
        what, _, todo = str(error).partition("; ")
        yield ConfigError.at(str(file.path), example.line, f"[[example]]: {what}", todo or _TODO)
        return
    yield from _at(file, example, found)


def _at(file: FileFacts, example: Example, found: Iterable[str]) -> Iterator[ConfigError]:
    for what in found:
        yield ConfigError.at(str(file.path), example.line, f"[[example]]: {what}", _TODO)


class _Bench:
    """Both ends of one example. Raises ConfigError for a telegram or options that the drive does not have."""

    def __init__(self, file: DeviceFile, profile: DriveProfile, example: Example) -> None:
        self.file, self.profile, self.example = file, profile, example
        self.spec = profile.telegram(example.telegram)
        if example.parameter and example.telegram is None and not self.spec.channel:
            specs = (one.spec for one in file.telegrams.values())
            self.spec = next((spec for spec in specs if spec.channel), self.spec)

    def contradictions(self) -> Iterator[str]:
        example = self.example
        if example.inputs is not None:
            yield from self._inputs(example.inputs)
        for order, wanted in example.outputs.items():
            yield from self._outputs(order, wanted)
        if example.parameter:
            yield from self._parameter()

    def _core(self) -> DriveCore:
        options = {**self.example.options, CHECK_SETTINGS: False}
        return self.profile.core("example", self.spec.name, options, simulated=True)

    # -- the meaning of inputs ------------------------------------------------------------------------------------

    def _inputs(self, octets: bytes) -> Iterator[str]:
        example, core = self.example, self._core()
        shown = f"inputs {hex_words(octets)}"
        whole = self._whole(octets, self.spec.inputs, "inputs")
        control = None
        if example.after is not None:
            control, _ = core.decode(self._whole(example.after, self.spec.outputs, "after")[core.offset :])
        status = core.read_inputs(whole, control)
        if example.state and status.state != example.state:
            yield f"{shown} mean the state {status.state}, not {example.state}"
        yield from self._messages(core, shown, "fault", self.file.fault, status.faults, example.fault)
        yield from self._messages(core, shown, "warning", self.file.warning, status.warnings, example.warning)
        if example.speed is not None and not _near(status.speed, example.speed, _ROUNDED):
            found = "no speed" if status.speed is None else f"the speed {status.speed:.5g}"
            yield f"{shown} mean {found}, not {example.speed:g}"
        for name, wanted in example.values.items():
            found_value, step = self._value(core, name)
            if not _near(found_value, wanted, step):
                yield f"{shown} mean {name} = {_number(found_value)}, not {_number(wanted)}"

    def _messages(
        self,
        core: DriveCore,
        shown: str,
        part: str,
        messages: Messages,
        found: Sequence[str],
        wanted: str | int | None,
    ) -> Iterator[str]:
        if wanted is None:
            return
        said = " and ".join(found) or f"no {part}"
        if isinstance(wanted, int):
            word = core.word(messages.word or part)
            if word is None:
                yield f"telegram {self.spec.name} has no word with the {part}"
            elif not (word >> wanted & 1 if messages.kind == "bits" else word == wanted):
                yield f"{shown} mean the {part} {word} ({said}), not {wanted}"
        elif not wanted:
            if found:
                yield f"{shown} mean the {part} {said}, not none"
        elif not any(one == wanted or one.startswith(f"{wanted} ") for one in found):
            yield f"{shown} mean {said if not found else f'the {part} {said}'}, not {wanted}"

    def _value(self, core: DriveCore, name: str) -> tuple[float | bool, float]:
        """A named value in the inputs, and the difference that does not count. Raises ConfigError."""
        known: dict[str, WordSpec] = {}
        bits: dict[str, tuple[str, int]] = {}
        for one in self.file.telegrams[self.spec.name].inputs:
            if isinstance(one, str):
                word = known[one] = self.file.words[one]
                named = self.file.table.status.bits if word.part == "status" else word.bits
                bits |= {f"{one}_{bit}": (one, number) for bit, number in named.items()}
        if name in known:
            counts = core.word(name)
            assert counts is not None
            word = known[name]
            return value_of(word, counts), word.step if word.full else 0.0
        if name in bits:
            place, number = bits[name]
            return bool((core.word(place) or 0) >> number & 1), 0.0
        if name in self.file.derived:
            return core.word(name) or 0, 0.0
        names = some_of([*known, *bits, *self.file.derived], 12)
        raise ConfigError(f"telegram {self.spec.name} has no value {name!r}; it has {names}")

    def _whole(self, octets: bytes, length: int, what: str) -> bytes:
        """Process data, given with or without the parameter channel, with it. Raises ConfigError."""
        lead = CHANNEL_LEN if self.spec.channel else 0
        if len(octets) == length:
            return bytes(lead) + octets
        if len(octets) == length + lead:
            return octets
        raise ConfigError(
            f"{what} {hex_words(octets)} have {len(octets)} octets, telegram {self.spec.name} has {length}; "
            "give those of the telegram, or name another telegram"
        )

    # -- orders ---------------------------------------------------------------------------------------------------

    def _outputs(self, order: str, wanted: Sequence[bytes]) -> Iterator[str]:
        for one in wanted:
            self._whole(one, self.spec.outputs, order)
        sent, refusal = _Exchange(self).carry_out(order)
        lead = CHANNEL_LEN if self.spec.channel else 0
        rest = iter(sent)
        if all(any(one[-self.spec.outputs :] == octets for octets in rest) for one in wanted):
            return
        said = ", then ".join(map(hex_words, sent[:_SHOWN])) + (" ..." if len(sent) > _SHOWN else "")
        should = ", then ".join(hex_words(one[lead if len(one) > self.spec.outputs else 0 :]) for one in wanted)
        yield f"{order!r} sends {said or 'nothing'}, not {should}" + (f" ({refusal})" if refusal else "")

    # -- the parameter channel ------------------------------------------------------------------------------------

    def _parameter(self) -> Iterator[str]:
        example = self.example
        if not self.spec.channel:
            raise ConfigError(f"telegram {self.spec.name} has no parameter channel; name a telegram with pkw = true")
        for what, octets in (("request", example.request), ("answer", example.answer)):
            if octets is not None and len(octets) != CHANNEL_LEN:
                raise ConfigError(
                    f"the {what} {hex_words(octets)} has {len(octets)} octets; the parameter channel has {CHANNEL_LEN}"
                )
        op, args = _job(example.parameter, parameter=True)
        exchange = _Exchange(self)
        requests, result = exchange.ask(op, args, example.request, example.answer)
        if example.request is not None and example.request not in requests:
            said = " and ".join(map(hex_words, requests)) or "nothing"
            yield f"{example.parameter!r} sends {said}, not {hex_words(example.request)}" + _why(result)
        elif example.answer is not None and not result.get("ok"):
            yield f"the answer {hex_words(example.answer)} to {example.parameter!r} gives no value{_why(result)}"
        elif example.value is not None:
            value = result.get("value")
            number = value if isinstance(value, (int, float)) else None
            if number is None or not math.isclose(number, example.value, rel_tol=1e-5, abs_tol=1e-9):
                said = "no value" if number is None else f"{number:g}"
                yield f"{example.parameter!r} gives {said}, not {example.value:g}"


class _Exchange:
    """The core and the simulated drive in data exchange; the inputs of the example stand still if it has some."""

    def __init__(self, bench: _Bench) -> None:
        self.core = bench._core()
        self.device: DriveDevice = bench.profile.simulated(bench.spec.name, bench.example.options, {})
        inputs = bench.example.inputs
        self._held = None if inputs is None else bench._whole(inputs, bench.spec.inputs, "inputs")[self.core.offset :]
        self._now = NS_PER_MS
        self.device.enter(bench.spec.config, self._now)
        self.device.operate(self._now)
        self._answer = self.device.exchange(self.core.safe_outputs, self._now)
        self._result: dict[str, object] = {}
        for _ in range(_UP):
            self._cycle()

    def _cycle(self, channel: bytes | None = None) -> bytes:
        """One exchange; ``channel``: the drive's octets of the parameter channel. Returns the outputs."""
        core = self.core
        self._now += _CYCLE_NS
        inputs = self._answer if self._held is None else self._answer[: core.offset] + self._held
        if channel is not None:
            inputs = channel + inputs[core.offset :]
        outputs = core.cyclic(inputs, self._now)
        self._answer = self.device.exchange(outputs, self._now)
        for event in core.take_events():
            if event["type"] == "result":
                self._result = event
        return outputs

    def _order(self, op: str, args: Mapping[str, object]) -> None:
        self._result = {}
        self.core.command(op, args, 1, self._now)

    def carry_out(self, orders: str) -> tuple[list[bytes], str]:
        """Give ``orders``, with commas between: the process data sent for the last one, each once in a row; why it
        was refused. Raises ConfigError."""
        *before, last = orders.split(",")
        for order in before:
            self._order(*_job(order))
            for _ in range(_BEFORE):
                self._cycle()
                if self._result:
                    break
        op, args = _job(last)
        if op == "acknowledge" and self._held is None:
            self.device.trip(next(iter(self.device.trips.values())))
            for _ in range(_UP):
                self._cycle()
                if self.core.raw_state in FAULTED:
                    break
        self._order(op, args)
        sent: list[bytes] = []
        for _ in range(_MOST):
            outputs = self._cycle()[self.core.offset :]
            if self._result and not self._result["ok"]:
                waited = self._held is not None and self._result["error"] == "timeout"  # inputs that stand still
                return sent, "" if waited else str(self._result["text"])
            if sent[-1:] != [outputs]:
                sent.append(outputs)
            if self._result:
                break
        return sent, ""

    def ask(
        self, op: str, args: Mapping[str, object], request: bytes | None, answer: bytes | None
    ) -> tuple[list[bytes], dict[str, object]]:
        """Give an order over the parameter channel: the requests sent, and the result. The drive answers ``request``
        (None: the first one) with ``answer``, if there is one."""
        self._order(op, args)
        requests: list[bytes] = []
        channel: bytes | None = None
        for _ in range(_MOST):
            sent = self._cycle(channel)[:CHANNEL_LEN]
            if any(sent) and sent not in requests:
                requests.append(sent)
            hit = sent == (request or next(iter(requests), None))
            channel = answer if hit and answer is not None else None if any(sent) or answer is None else bytes(8)
            if self._result or (request in requests and answer is None):
                break
        return requests, self._result


def _job(order: str, *, parameter: bool = False) -> tuple[str, dict[str, object]]:
    """An order in words as a core has it. Raises ConfigError."""
    op, *rest = order.split() or ("",)
    kinds = {"read": 1, "write": 2} if parameter else {SET: 2}
    wanted = kinds.get(op)
    if not op or (parameter and wanted is None) or (wanted is not None and len(rest) != wanted):
        form = '"read NAME" or "write NAME VALUE"' if parameter else '"start", "speed 0.5" or "set NAME VALUE"'
        raise ConfigError(f"{order.strip()!r} is no order; write {form}")
    numbers = [_as_number(order, one) for one in (rest[1:] if wanted else rest)]
    if parameter:
        name = int(rest[0]) if rest[0].isascii() and rest[0].isdecimal() else rest[0]
        return op, {"number": name} | ({"value": numbers[0]} if numbers else {})
    if op == SET:
        return op, {"values": [{"name": rest[0], "value": numbers[0]}]}
    if len(numbers) > 1:
        raise ConfigError(f"{order.strip()!r} is no order; an order has one value")
    return op, {"value": numbers[0]} if numbers else {}


def _as_number(order: str, text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ConfigError(f"{order.strip()!r}: {text!r} is no number; write for instance speed 0.5")
    return number


def _near(found: float | bool | None, wanted: float | bool, step: float) -> bool:
    """Whether the values are the same, up to one step and the rounding of a manual."""
    if found is None or isinstance(wanted, bool) or isinstance(found, bool):
        return found is not None and bool(found) is bool(wanted) and wanted in (0, 1)
    return abs(found - wanted) <= (step + _ROUNDED * abs(wanted) if step else 1e-9)


def _number(value: float | bool) -> str:
    return str(value).lower() if isinstance(value, bool) else f"{value:.6g}"


def _why(result: Mapping[str, object]) -> str:
    return f" ({result['text']})" if "text" in result else ""


def hex_words(octets: bytes) -> str:
    """``047F 0000``."""
    return octets.hex(" ", -2).upper()
