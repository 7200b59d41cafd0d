"""``Drive``: orders, status and parameters of a drive."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import math
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterable, Mapping, Sequence
from typing import Final, NamedTuple

from dpstack.api.lists.parameter_list import ParameterPlace, ParameterValue, Readable
from dpstack.api.slave.host import TOKENS, Host
from dpstack.api.slave.record_parameters import drive_error
from dpstack.api.slave.slave import Slave
from dpstack.api.streams import Stream
from dpstack.argcheck import Sealed, is_number
from dpstack.dp.master.commands import DriveCommand
from dpstack.dp.master.events import FaultKind
from dpstack.errors import BusError, DpError, DriveError, DriveTimeout, ParameterError, UsageError
from dpstack.plant.orders import HALTS
from dpstack.profile import DriveCore, DriveStatus, ListedParam
from dpstack.profile.master.several_drives import ARGUMENTS, DRIVE
from dpstack.profile.model.jobs import LARGEST, CommandError
from dpstack.text import brief

#: seconds: the plugin checks time-outs once a rotation; after this time its answer is late
_GRACE: Final = 0.25
#: True and False are no set points, and other numbers take the way of an order
_PLAIN: Final = (float, int)
#: most notices that a Drive keeps
_NOTICES: Final = 5


def declared_parameters(core: DriveCore) -> tuple[ListedParam, ...]:
    """The parameters that a plugin declares. Raises UsageError if the telegram has no parameter channel."""
    if core.access is None:
        raise UsageError(f"drive {core.name}: {core.telegram.name} of {core.drive} has no parameter channel")
    return core.parameters()


class DriveNotice(NamedTuple):
    """A line of text from a drive plugin to the application."""

    #: bus time in ns
    t_ns: int
    #: one line for people
    text: str


class DrivePlugin(NamedTuple):
    """The plugin of a drive for its application: ``core`` knows ranges, references and parameters, ``status`` returns
    the last status of the plugin that runs."""

    core: DriveCore
    status: Callable[[], DriveStatus]
    #: its slave has several drives
    several: bool = False
    #: whether the drive gets a set point (part of the reference) already; None: the plugin runs in a bus process
    has_setpoint: Callable[[float], bool] | None = None


class Drive(Sealed, Readable):
    """A drive by its name in the configuration. Orders are awaitable and raise DriveFault or DriveTimeout."""

    slave: Slave

    def __init__(self, bus: Host, slave: Slave, plugin: DrivePlugin) -> None:
        self._bus = bus
        self._core, self._last_status, self._is_one_of_several, has_setpoint = plugin
        self._pending: dict[int, asyncio.Future[dict[str, object]]] = {}
        self._readers: list[Stream[DriveStatus]] = []
        self._seen = b""
        self._over = False
        self._setpoints: dict[int, float] = {}  # that the plugin has not answered yet, by token
        self._is_unchanged = _comparison(bus, has_setpoint, self._setpoints)
        self._refused: DpError | None = None  # why the plugin did not take a set point
        self._notices: deque[DriveNotice] = deque(maxlen=_NOTICES)
        #: the slave behind it
        self.slave = slave
        self._seal(Drive)

    def _sealed_name(self) -> str:
        return f"drive {self.name}"

    def __repr__(self) -> str:
        return f"<Drive {self.name!r} {self._core.drive} at {self.slave.address}>"

    @property
    def name(self) -> str:
        """The name in the configuration."""
        return self._core.name

    @property
    def kind(self) -> str:
        """The name of its plugin, for instance ``fuji-frenic``."""
        return self._core.drive

    @property
    def address(self) -> int:
        """The station address of its slave."""
        return self.slave.address

    @property
    def status(self) -> DriveStatus:
        """The latest status of the drive; offline while the bus does not run."""
        status = self._last_status()
        if self._setpoints:
            status = dataclasses.replace(status, setpoint=[*self._setpoints.values()][-1])
        return status if self._bus.runtime.not_running is None else status.unknown()

    @property
    def notices(self) -> tuple[DriveNotice, ...]:
        """The last notices of its plugin (why it left the running state, settings that differ), oldest first."""
        return tuple(self._notices)

    @property
    def speed(self) -> float:
        """The speed set point as a part of the reference (0.5 = 50 %); the actual value is ``status.speed``.

        An assigned set point goes out in the next rotation; one that the drive gets already costs a comparison only.
        Raises UsageError outside the range. If the plugin refuses the set point, the next order raises the refusal (an
        order that stops the drive goes out before).
        """
        return self.status.setpoint

    @speed.setter
    def speed(self, fraction: float) -> None:
        self._set("speed", fraction, 1.0)

    @property
    def frequency(self) -> float:
        """The speed set point in Hz, by the drive's reference. Raises UsageError while nobody knows that reference."""
        return self.speed * self._reference("Hz")

    @frequency.setter
    def frequency(self, hertz: float) -> None:
        self._set("frequency", hertz, self._reference("Hz"))

    @property
    def rpm(self) -> float:
        """The speed set point in rpm, by the drive's reference. Raises UsageError while nobody knows that reference."""
        return self.speed * self._reference("rpm")

    @rpm.setter
    def rpm(self, rpm: float) -> None:
        self._set("rpm", rpm, self._reference("rpm"))

    def _reference(self, unit: str) -> float:
        """What 100 % means, as the plugin knows it: the drive itself may have said it."""
        status = self.status
        known = status.reference_hz if unit == "Hz" else status.reference_rpm
        if known:
            return known
        try:
            return self._core.known_reference(unit)
        except CommandError as error:
            raise UsageError(f"drive {self.name}: {error.text}") from None

    def _set(self, op: str, value: float, reference: float) -> None:
        if type(value) in _PLAIN and -LARGEST <= value <= LARGEST and self._is_unchanged(value / reference):
            return
        if not is_number(value):
            raise UsageError(f"drive {self.name}: {op} = {brief(value)} is no number: give one, 0.5 for instance")
        if LARGEST < abs(value) < math.inf:
            raise UsageError(f"drive {self.name}: {op} must be a number up to {LARGEST:g}")
        value = float(value)
        try:
            self._core.setpoint_word(value / reference)
        except (ValueError, TypeError) as error:
            raise UsageError(f"drive {self.name}: {error}") from None
        token = next(TOKENS)
        self._setpoints[token] = value / reference
        try:
            self._bus.command(self._command(op, {"value": value}, token))
        except BaseException:
            self._setpoints.pop(token, None)
            raise

    async def start(self, timeout: float = 5.0) -> None:
        """Walk the state machine until the drive runs. Raises DriveFault or DriveTimeout, which say why not."""
        await self._order("start", timeout)

    async def stop(self, timeout: float = 60.0) -> None:
        """Ramp down and switch off.

        Raises DriveError at once, with the state of the outputs, when the drive cannot get the order: its slave has a
        fault, is out of service or leaves data exchange, or the master went to Clear by itself. The order stays: its
        control word goes out with the first outputs in Operate, unless another order came since.
        """
        await self._order("stop", timeout)

    async def quick_stop(self, timeout: float = 60.0) -> None:
        """Stop by the quick stop ramp. Raises DriveError as :meth:`stop`."""
        await self._order("quick_stop", timeout)

    async def coast(self, timeout: float = 5.0) -> None:
        """Switch the output off; the motor coasts to a stop. Raises DriveError as :meth:`stop`."""
        await self._order("coast", timeout)

    async def acknowledge(self, timeout: float = 20.0) -> None:
        """Acknowledge a fault until it is gone (some drives lock this for 15 s). Raises DriveFault when it stays."""
        await self._order("acknowledge", timeout)

    async def reached(self, timeout: float = 60.0, *, tolerance: float | None = None) -> None:
        """Wait until the drive reports its set point as reached.

        With ``tolerance`` (part of the reference): until the actual speed is that close to it.
        """
        await self._order("reached", timeout, tolerance=tolerance)

    async def settled(self, timeout: float = 5.0) -> None:
        """Wait until :attr:`status` answers the present set point, and a fault has its name.

        Right after data exchange began the status may still be older. Raises DriveError.
        """
        await self._order("settled", timeout)

    async def read(
        self, number: int | str, *, data_set: int | None = None, index: int | None = None, timeout: float = 5.0
    ) -> float | int:
        """A parameter by number or name, decoded and scaled. Raises ParameterError with the drive's reason."""
        return (await self.parameter(number, data_set=data_set, index=index, timeout=timeout)).value

    async def parameter(
        self, number: int | str, *, data_set: int | None = None, index: int | None = None, timeout: float = 5.0
    ) -> ParameterValue:
        """As :meth:`read`, with name, unit and the integer on the wire."""
        return _value(await self._order("read", timeout, number=number, data_set=data_set, index=index))

    async def read_many(
        self, parameters: Sequence[int | str | ParameterPlace], *, timeout: float = 5.0
    ) -> list[ParameterValue | ParameterError]:
        """Read several parameters, as :meth:`parameter`, in few requests if one request can carry several.

        Returns one entry for each parameter, in their order: the value, or the error of a parameter that the drive
        refuses. Raises the other errors of :meth:`read`.
        """
        if isinstance(parameters, str) or not isinstance(parameters, Iterable):
            raise UsageError(
                f"parameters = {brief(parameters)} is no list: read_many([480, 'F26', ParameterPlace(...)])"
            )
        tables = [one.as_dict() if isinstance(one, ParameterPlace) else {"number": one} for one in parameters]
        found = (await self._order("read_many", timeout, parameters=tables)).get("values")
        if not isinstance(found, (list, tuple)):
            raise TypeError(f"several parameters are {found!r}")
        return [self._entry(one) for one in found]

    async def read_array(
        self, number: int | str, count: int, *, first: int = 0, timeout: float = 5.0
    ) -> list[ParameterValue | ParameterError]:
        """``count`` elements of an array from ``first`` on (indexes as :meth:`read` has them), as :meth:`read_many`."""
        return await self.read_many(
            [ParameterPlace(number, index=at) for at in range(first, first + count)], timeout=timeout
        )

    @property
    def per_request(self) -> int:
        """The number of parameters that one request can carry: several over record 47, else 1."""
        access = self._core.access
        return 1 if access is None else access.per_request

    @property
    def parameters(self) -> tuple[ListedParam, ...]:
        """The parameters that the plugin declares, as :meth:`dump` reads them.

        Raises UsageError if the telegram has no parameter channel.
        """
        return declared_parameters(self._core)

    async def write(
        self,
        number: int | str,
        value: float,
        *,
        data_set: int | None = None,
        index: int | None = None,
        ram: bool = False,
        timeout: float = 5.0,
    ) -> ParameterValue:
        """Write a parameter in its own unit; ``ram`` does not store it (EEPROMs wear out). Raises ParameterError.

        Returns the value that the drive has confirmed.
        """
        return _value(
            await self._order(
                "write", timeout, number=number, value=value, data_set=data_set, index=index, ram=ram or None
            )
        )

    async def read_map(self, timeout: float = 10.0) -> dict[str, object]:
        """Read the process data map of the drive. Raises UsageError if the drive has no map."""
        return _members(await self.order("read_map", timeout))

    async def write_map(
        self, *, inputs: str | None = None, outputs: str | None = None, timeout: float = 10.0
    ) -> dict[str, object]:
        """Write a process data map, checked before the first request; the plugin knows how the drive takes it."""
        return _members(await self.order("write_map", timeout, inputs=inputs, outputs=outputs))

    async def order(self, op: str, timeout: float = 5.0, **args: object) -> object:
        """A drive-specific order by name, with its arguments. Raises UsageError naming the known ones."""
        return (await self._order(op, timeout, **args)).get("value")

    async def statuses(self) -> AsyncIterator[DriveStatus]:
        """Each new status. A slow reader gets the latest one only. Ends with the bus."""
        reader = Stream(1, [self.status])
        if self._over:
            reader.end()
        self._readers.append(reader)
        try:
            with self._bus.rounds.watched(self.on_round):
                async for status in reader:
                    yield status
        finally:
            self._readers.remove(reader)

    # --- from the bus -------------------------------------------------------------------------------------------

    def on_round(self) -> None:
        """After each round: give the readers the status when the inputs have changed."""
        inputs = self.slave.inputs
        if inputs is not self._seen and inputs != self._seen:
            self._seen = inputs
            self.publish_status()

    def on_payload(self, payload: Mapping[str, object], t_ns: int) -> None:
        """Handle the ``payload`` that the plugin sent at ``t_ns``."""
        kind = payload.get("type")
        if kind == "result":
            token = payload.get("token")
            future = self._pending.pop(token, None) if isinstance(token, int) else None
            if isinstance(token, int) and self._setpoints.pop(token, None) is not None and not payload.get("ok"):
                self._refused = self._error(payload)
            if future is not None and not future.done():
                if payload.get("ok"):
                    future.set_result(dict(payload))
                else:
                    future.set_exception(self._error(payload))
        elif kind == "status":
            self.publish_status()
        elif kind == "notice":
            text = str(payload.get("text"))
            before = next((one for one in self._notices if one.text == text), None)
            if before is not None:
                self._notices.remove(before)
            self._notices.append(DriveNotice(t_ns, text))
        elif kind == "failed":
            where = f", in {payload['where']}" if "where" in payload else ""
            self._refuse(DriveError(self.name, f"drive {self.name}: its plugin failed: {payload.get('text')}{where}"))

    def on_refused(self, token: int, error: DpError) -> None:
        """The bus process refused a set point."""
        if self._setpoints.pop(token, None) is not None:
            self._refused = error

    def end(self, error: DpError) -> None:
        """The bus has ended or the drive was removed: pending orders and readers end."""
        self._over = True
        self._setpoints.clear()
        self._refuse(error)
        for reader in self._readers:
            reader.end()

    # --- inside -------------------------------------------------------------------------------------------------

    def _command(self, op: str, args: dict[str, object], token: int) -> DriveCommand:
        if self._is_one_of_several:
            args = {DRIVE: self.name, ARGUMENTS: args}
        return DriveCommand(self.slave.address, op, args, token)

    def _refuse(self, error: DpError) -> None:
        """Pending orders raise the error."""
        pending, self._pending = self._pending, {}
        for future in pending.values():
            if not future.done():
                future.set_exception(error)

    def publish_status(self) -> None:
        """Hand the status to its readers: something has changed."""
        if self._readers:
            status = self.status
            for reader in self._readers:
                reader.put(status)

    async def _order(self, op: str, timeout: float, **args: object) -> dict[str, object]:
        if not is_number(timeout) or not 0 <= timeout <= LARGEST:
            raise UsageError(f"drive {self.name}: {op}: timeout must be a number of seconds, not {timeout!r}")
        token = next(TOKENS)
        refused, self._refused = self._refused, None
        if refused is not None and op not in HALTS:
            raise refused
        given = {key: value for key, value in args.items() if value is not None}
        future: asyncio.Future[dict[str, object]] = asyncio.get_running_loop().create_future()
        self._pending[token] = future
        try:
            await self._bus.order(self._command(op, {**given, "timeout_s": timeout}, token))
            async with asyncio.timeout(timeout + _GRACE + self._bus.rotation_limit_s):
                if op in HALTS:
                    await self._bus.until(lambda: future.done() or self._gets_no_outputs)
                    if self._gets_no_outputs:
                        raise self._not_stopped(op)
                result = await future
        except TimeoutError as error:
            if isinstance(error, DpError):
                raise
            raise DriveTimeout(self.name, f"drive {self.name}: {op}: {self._why_silent()}") from None
        finally:
            if future.done() and not future.cancelled():
                future.exception()  # asyncio reports one that nobody has asked for
            if self._pending.pop(token, None) is not None and not self._over and op not in HALTS:
                # the caller was cancelled or its time is over: the plugin must not start the motor later
                with contextlib.suppress(UsageError, BusError):
                    self._bus.command(self._command("cancel", {"order": token}, next(TOKENS)))
        if refused is not None:
            raise refused
        return result

    @property
    def _gets_no_outputs(self) -> bool:
        """Whether no order reaches the drive until something changes at its slave or at the bus."""
        slave = self.slave
        if slave.ready_now:
            return self._bus.forced_clear is not None
        return slave.deactivated or slave.fault is not None

    def _not_stopped(self, op: str) -> DriveError:
        slave = self.slave
        fault = slave.fault
        silent = fault is not None and fault.kind in (FaultKind.ABSENT, FaultKind.LOST)
        if slave.ready_now:
            outputs = "the master sends it safe outputs"
        elif fault is not None and fault.kind is FaultKind.LOCKED:
            outputs = "its outputs are those of the other master"
        elif silent and not slave.exchanges:
            outputs = "this master has sent it no outputs"
        elif silent and not slave.watchdog_ms:
            outputs = "its watchdog is off: it keeps its last outputs and may go on turning; stop it at the device"
        elif silent:
            outputs = f"its watchdog makes its outputs safe {slave.watchdog_ms} ms after the last telegram"
        else:
            outputs = "outside data exchange its outputs are safe"
        text = f"{self._why_silent()}. Now {outputs}. When it is back, the first outputs order {op} again"
        return DriveError(self.name, f"drive {self.name}: {op}: {text}")

    def _why_silent(self) -> str:
        held = self.slave.held_because
        if held is None:
            return "no answer from the plugin"
        return held if self._bus.forced_clear is None else f"{held} and start() again"

    def _entry(self, payload: Mapping[str, object]) -> ParameterValue | ParameterError:
        if "error" not in payload:
            return _value(payload)
        error = self._error(payload)
        if not isinstance(error, ParameterError):
            raise error
        return error

    def _error(self, payload: Mapping[str, object]) -> DpError:
        kind, text = payload.get("error"), payload.get("text")
        if kind == "usage":
            return UsageError(f"drive {self.name}: {text}")
        if kind == "lost" and not self._over:
            if self._bus.forced_clear is not None:
                text = f"ended: {self._why_silent()}"
            elif not self.slave.ready_now:
                text = f"{text}: {self._why_silent()}"
        return drive_error(self.name, kind, text, payload.get("number"))


def _members(value: object) -> dict[str, object]:
    if isinstance(value, dict):
        return value
    raise TypeError(f"a process data map is {value!r}")


def _value(result: Mapping[str, object]) -> ParameterValue:
    value, raw, number, name, data_set = (result.get(key) for key in ("value", "raw", "number", "name", "data_set"))
    if not (isinstance(value, (int, float)) and isinstance(raw, int) and isinstance(number, int)):
        raise TypeError(f"a parameter is {result!r}")
    return ParameterValue(
        number,
        None if name is None else str(name),
        value,
        raw,
        str(result.get("unit", "")),
        data_set if isinstance(data_set, int) else None,
    )


def _comparison(
    bus: Host, has_setpoint: Callable[[float], bool] | None, waiting: Mapping[int, float]
) -> Callable[[float], bool]:
    """Whether an assignment of this set point changes nothing: the drive gets it already, and no other one is on its
    way. Raises UsageError if the bus is not open. (A function without attributes: :class:`Sealed`.)"""
    if has_setpoint is None:
        return lambda _: False

    def is_unchanged(fraction: float) -> bool:
        if waiting or not has_setpoint(fraction) or bus.runtime.not_running is not None:
            return False
        bus.check_open()
        return True

    return is_unchanged
