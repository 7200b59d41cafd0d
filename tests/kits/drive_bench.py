"""Benches for drive tests: a plugin and a simulated drive, each fed with literal octets, and both together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Generic, TypeAlias, TypeVar

from dpstack.profile import DriveCore, DriveDevice, DriveProfile, Leave

D = TypeVar("D", bound=DriveDevice)
#: settings of a simulated drive, options of a plugin, arguments of an order: values by their names
Named: TypeAlias = Mapping[str, object]

MS = 1_000_000
S = 1_000 * MS
START = 5 * S
#: options of a plugin that does not read its drive's settings by itself: the parameter channel is the test's
ALONE: Named = {"check_settings": False}
#: settings of a simulated drive as delivered; of a Demag drive and an IMO drive that the bus commands
NONE: Named = {}
BUS = {"412": 1}
PZD = {"P15.02": 1, "P15.13": 1}


@dataclass
class Times:
    """The times of a parameter channel without a plugin."""

    now: int = 0
    settle_ns: int = 0


class PluginBench:
    """The master's end alone: inputs are what the test says, in hex."""

    def __init__(self, core: DriveCore, inputs: str, rotation: int = 2 * MS) -> None:
        self.core = core
        self.now = START
        self.rotation = rotation
        self.inputs = bytes.fromhex(inputs)
        self.events: list[dict[str, object]] = []
        self._token = 0
        self.run(2)

    def run(self, rotations: int = 1) -> bytes:
        """Some rotations with the present inputs; the last outputs."""
        out = b""
        for _ in range(rotations):
            self.now += self.rotation
            out = self.core.cyclic(self.inputs, self.now)
            self.events += self.core.take_events()
        return out

    def see(self, inputs: str, rotations: int = 1) -> str:
        """The drive answers ``inputs`` (hex) from now on; the outputs after some rotations, in hex."""
        self.inputs = bytes.fromhex(inputs)
        return self.run(rotations).hex(" ").upper()

    def order(self, op: str, **args: object) -> int:
        """Give an order; its token."""
        self._token += 1
        self.core.command(op, args, self._token, self.now)
        self.events += self.core.take_events()
        return self._token

    def order_and_run(self, rotations: int, op: str, **args: object) -> int:
        """Give an order and run some rotations; its token."""
        token = self.order(op, **args)
        self.run(rotations)
        return token

    def out(self, rotations: int = 1) -> str:
        """The outputs of the last of some more rotations, in hex."""
        return self.run(rotations).hex(" ").upper()

    def out_after(self, op: str, **args: object) -> str:
        """Give an order; the outputs of the rotation after it, in hex."""
        self.order(op, **args)
        return self.out()

    def result(self, token: int) -> dict[str, object] | None:
        """The result of an order, None while it is under way."""
        for event in self.events:
            if event["type"] == "result" and event["token"] == token:
                return event
        return None

    def done(self, token: int, inputs: str | None = None, rotations: int = 1) -> dict[str, object]:
        """The result of an order that has ended; with ``inputs``, after the drive has answered them."""
        if inputs is not None:
            self.see(inputs, rotations)
        result = self.result(token)
        assert result is not None
        return result

    def value(self, token: int, inputs: str | None = None, rotations: int = 1) -> object:
        """Of the result that :meth:`done` gives."""
        return self.done(token, inputs, rotations)["value"]

    def text(self, token: int, error: str | None = None) -> str:
        """The text of a result; ``error``: the kind that it must be of."""
        result = self.done(token)
        assert error in (None, result["error"])
        return str(result["text"])

    def do(self, op: str, **args: object) -> dict[str, object]:
        """Give an order that ends at once; its result."""
        return self.done(self.order(op, **args))

    def ok(self, op: str, **args: object) -> object:
        """Like :meth:`do`, for an order that must work; its value."""
        result = self.do(op, **args)
        assert result["ok"], result
        return result["value"]

    def refused(self, op: str, **args: object) -> tuple[str, str]:
        """Like :meth:`do`, for an order that must fail: kind and text."""
        result = self.do(op, **args)
        assert not result["ok"], result
        return str(result["error"]), str(result["text"])

    def refused_as(self, wanted: str, op: str, **args: object) -> str:
        """Like :meth:`refused`, for an order that must fail in this way; its text."""
        kind, text = self.refused(op, **args)
        assert kind == wanted
        return text

    def misuse(self, op: str, **args: object) -> str:
        """The text that refuses an order which no drive gets to see."""
        return self.refused_as("usage", op, **args)

    def notices(self) -> list[str]:
        return [str(event["text"]) for event in self.events if event["type"] == "notice"]


class DeviceBench(Generic[D]):
    """The simulated drive alone: outputs are what the test says, in hex."""

    def __init__(self, device: D, config: str, rotation: int = 2 * MS) -> None:
        self.device = device
        self.now = START
        self.rotation = rotation
        self.config = bytes.fromhex(config)
        assert device.check_cfg(self.config) is None
        device.enter(self.config, self.now)
        device.operate(self.now)

    def send(self, outputs: str, ms: float = 70) -> str:
        """Exchange ``outputs`` (hex) for ``ms`` (two scans and more); the last inputs, in hex."""
        octets = bytes.fromhex(outputs)
        end = self.now + round(ms * MS)
        inputs = b""
        while self.now < end:
            self.now += self.rotation
            inputs = self.device.exchange(octets, self.now)
        return inputs.hex(" ").upper()

    def until(self, outputs: str, wanted: str, ms: float) -> list[str]:
        """Exchange until the inputs are ``wanted``; the different inputs on the way, in order, with the last one."""
        octets = bytes.fromhex(outputs)
        end = self.now + round(ms * MS)
        seen: list[str] = []
        while self.now < end:
            self.now += self.rotation
            inputs = self.device.exchange(octets, self.now).hex(" ").upper()
            if not seen or seen[-1] != inputs:
                seen.append(inputs)
            if inputs == wanted:
                return seen
        raise AssertionError(f"{wanted} did not come; seen {seen[-5:]}")

    def pass_time(self, ms: float) -> None:
        """Time of the bus without a telegram."""
        self.now += round(ms * MS)
        self.device.advance(self.now)

    def lose(self, ms: float, reason: Leave = Leave.WATCHDOG) -> None:
        """The master has left the drive, for some time already."""
        self.device.leave(reason, self.now)
        self.pass_time(ms)

    def away(self, ms: float = 0, reason: Leave = Leave.WATCHDOG) -> None:
        """The master leaves the drive and returns after some time; nobody looks at the drive meanwhile."""
        self.device.leave(reason, self.now)
        self.now += round(ms * MS)
        self.device.enter(self.config, self.now)


class PairBench(PluginBench):
    """Plugin and simulated drive against each other, one exchange a rotation."""

    def __init__(self, core: DriveCore, device: DriveDevice, rotation: int = 2 * MS) -> None:
        self.device = device
        assert device.check_cfg(core.telegram.config) is None
        device.enter(core.telegram.config, START)
        device.operate(START)
        super().__init__(core, "00" * core.telegram.input_octets, rotation)

    def run(self, rotations: int = 1) -> bytes:
        out = b""
        for _ in range(rotations):
            self.now += self.rotation
            out = self.core.cyclic(self.inputs, self.now)
            self.events += self.core.take_events()
            self.inputs = self.device.exchange(out, self.now)
        return out

    def pass_time(self, ms: float) -> None:
        self.run(round(ms * MS) // self.rotation)

    def do(self, op: str, **args: object) -> dict[str, object]:
        """Give an order and wait for its result."""
        token = self.order(op, **args)
        end = self.now + 120 * S
        while (result := self.result(token)) is None:
            assert self.now < end, f"{op} never ended"
            self.run()
        return result


def as_mapping(value: object) -> Named:
    """A JSON object out of an event."""
    assert isinstance(value, dict)
    return value


def pair(
    drive: DriveProfile,
    telegram: str | None,
    simulated: Named = NONE,
    options: Named = NONE,
    rotation: int = 2 * MS,
) -> PairBench:
    """A drive with the settings ``simulated``, and its plugin with ``options``."""
    return PairBench(
        drive.core("it", telegram, options, simulated=True), drive.simulated(telegram, {}, simulated), rotation
    )
