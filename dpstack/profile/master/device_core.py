"""Master side of a device that is no drive, called once a rotation: its orders, and the outputs that they make."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from dpstack.profile.model.drive_type import TelegramSpec
from dpstack.profile.model.jobs import Args, CommandError, DriveJob, DriveJobs, Steps
from dpstack.units import NS_PER_MS

#: the order that sets named outputs
SET: Final = "set"
#: outputs leave, inputs come, their turn here
_ROTATIONS: Final = 3
_LEAST_NS: Final = 20 * NS_PER_MS


class DeviceCore:
    """Implements :class:`dpstack.dp.process_image.CyclicPlugin` for one device called ``name``; its values are the
    named inputs of its slave. ``kind``: name of its profile.

    Subclass it: :attr:`operations`, :meth:`order`, :meth:`received`, :attr:`outputs`. Time comes in as ``now`` in ns;
    nothing here blocks or reads a clock.
    """

    #: its orders, each with its time-out in s if the caller gives none; a new one ends the former
    operations: Mapping[str, float] = {}

    def __init__(self, kind: str, name: str, telegram: TelegramSpec) -> None:
        #: name of the device in the configuration
        self.name = name
        #: name of its profile
        self.kind = kind
        #: telegram in use
        self.telegram = telegram
        #: octets of the outputs for every way out
        self.safe_outputs = bytes(telegram.output_octets)
        #: octets of the next Data_Exchange
        self.outputs = self.safe_outputs
        #: the last inputs of this stay in data exchange; empty before
        self.inputs = b""
        #: bus time of the present cycle in ns
        self.now = 0
        self._called_at: int | None = None
        self._rotation_ns = 0
        self._orders = DriveJobs("device")
        #: returns plain JSON data for the application, oldest first
        self.take_events: Callable[[], list[dict[str, object]]] = self._orders.take_events

    # -- CyclicPlugin -----------------------------------------------------------------------------------------------

    def cyclic(self, inputs: bytes, now: int) -> bytes:
        """See :class:`CyclicPlugin`."""
        if self._called_at is not None:
            self._rotation_ns = now - self._called_at
        self.now = self._called_at = now
        if inputs != self.inputs:
            self.inputs = inputs if len(inputs) == self.telegram.input_octets else b""
            if self.inputs:
                self.received()
        if self._orders.jobs:
            self._orders.step(now, 0)
        return self.outputs

    def lost(self, now: int) -> None:
        """The slave left data exchange, or outputs went to their safe values: pending orders end with a reason."""
        self.now = now
        self._orders.end(CommandError("lost", "the device left data exchange"))
        self._called_at, self.inputs, self.outputs = None, b"", self.safe_outputs

    def safe(self, configured: bytes) -> bytes:
        return configured

    def moved(self, address: int) -> str | None:
        """No order gives it another address."""
        return None

    def command(self, op: str, args: Mapping[str, object], token: int, now: int) -> None:
        """An order of the application in plain JSON data; its result is an event that carries ``token``. It waits for
        data exchange until its time is over."""
        self.now = now
        checked = Args(op, args)
        try:
            if op == "cancel":
                found = checked.integer("order")
                steps = self._cancel(found)
            elif op == SET and (value := self.set_values(checked)) is not None:
                self._orders.tell({"type": "result", "token": token, "ok": True, "value": value})
                return
            elif op in self.operations:
                deadline = now + checked.timeout_ns(self.operations[op])
                steps = self._in_data_exchange(self.order(op, checked, deadline), deadline)
            else:
                known = ", ".join(self.operations) or "none"
                raise CommandError("usage", f"{self.kind} has no order {op!r}; it has {known}")
            checked.done()
        except CommandError as error:
            self._orders.failed(token, error)
            return
        self._orders.begin(DriveJob(op, token, steps, motion=op != "cancel"))

    # -- what a device adds ------------------------------------------------------------------------------------------

    def order(self, op: str, args: Args, deadline: int) -> Steps[dict[str, object]]:
        """The job of an order of :attr:`operations`; it begins in data exchange. Raises CommandError."""
        raise NotImplementedError

    def set_values(self, args: Args) -> dict[str, object] | None:
        """Named outputs have new values, at once and whatever the bus does; the values. None: it has no such outputs.
        Raises CommandError."""
        return None

    def received(self) -> None:
        """There are other :attr:`inputs`."""

    # -- for jobs ------------------------------------------------------------------------------------------------------

    def notice(self, text: str) -> None:
        """A line for people."""
        self._orders.tell({"type": "notice", "text": text})

    @property
    def settle_ns(self) -> int:
        """After this time the inputs belong to the outputs given now, in ns."""
        return max(_ROTATIONS * self._rotation_ns, _LEAST_NS)

    def _in_data_exchange(self, steps: Steps[dict[str, object]], deadline: int) -> Steps[dict[str, object]]:
        while not self.inputs:
            if self.now >= deadline:
                raise CommandError("lost", "the device is not in data exchange")
            yield
        return (yield from steps)

    def _cancel(self, token: int | None) -> Steps[dict[str, object]]:
        yield from ()
        return {"value": self._orders.cancel(token)}
