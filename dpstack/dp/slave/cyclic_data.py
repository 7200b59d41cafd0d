"""The cyclic data of a slave in data exchange: double buffers for SYNC and FREEZE, Clear and Operate.

Exists only while the slave is in data exchange; leaving drops it, and with it outputs and modes
(docs/reference/protocol.md#slave-states). Exceptions of the device come out of here and are caught by the slave
application.
"""

from __future__ import annotations

from collections.abc import Callable

from dpstack.dp.error_origin import DEVICE_CALL
from dpstack.dp.pdu.requests import GlobalControl
from dpstack.dp.slave.device import DpV0Device
from dpstack.fdl.interface import SC_REPLY, Reply
from dpstack.fdl.telegram import Resp

#: from the outputs of the master, and whether the values of publishers may act, to the outputs of the device
Overlay = Callable[[bytes, bool], bytes]


class CyclicData:
    """Outputs and inputs of one stay in data exchange.

    ``outputs`` are what the device has, ``inputs`` what the master reads; before the first exchange the device's safe
    outputs and zeros. Raises ValueError if the safe outputs have another length than the configuration's. Outputs
    are valid from the first Data_Exchange on (masters that never send Operate exist:
    docs/reference/protocol.md#global_control). A Global_Control Clear holds until one without Clear_Data, an empty
    frame until a full one. ``plain``: none of Clear, SYNC, FREEZE. ``void``: the outputs are not valid (Clear, or an
    empty output frame).
    """

    def __init__(self, device: DpV0Device, config: bytes, input_len: int, output_len: int) -> None:
        self._device = device
        self.run = device.exchange
        self.config = config
        self.input_len = input_len
        self.output_len = output_len
        self.inputs = bytes(input_len)
        #: the answer with :attr:`inputs`
        self.reply = _reply_with(self.inputs)
        self._safe = device.safe or bytes(output_len)
        if len(self._safe) != output_len:
            raise ValueError(f"{len(self._safe)} safe octets, the configuration has {output_len} output octets")
        self.outputs = self._safe
        self.synced = False
        self.frozen = False
        self.plain = False
        self._received = self.outputs  # the next SYNC passes them on
        self._clear = False  # Global_Control said Clear
        self.void = False
        self._started = False  # operate() of the device was called
        #: puts the values of publishers over the outputs of the master, or safe octets; None if they give none of them
        self.overlay: Overlay | None = None
        self._operates = False  # the last Global_Control was Operate
        self._exchanged = False  # outputs of the master have come

    def accepts(self, octets: bytes) -> bool:
        """Whether ``octets`` can be the outputs: the right length, or an empty fail-safe frame."""
        return len(octets) == self.output_len or (not octets and self._device.fail_safe)

    def take(self, inputs: bytes, *, hold: bool) -> None:
        """Answer with ``inputs`` of the device from now on; ``hold``: FREEZE holds the earlier ones.

        Raises TypeError and ValueError if they cannot go out on the wire.
        """
        if type(inputs) is not bytes or len(inputs) != self.input_len:
            raise wrong_inputs(inputs, self.input_len)
        if hold:
            return
        if inputs != self.inputs:  # the same reply again needs no new telegram (PassiveStation)
            self.reply = _reply_with(inputs)
        self.inputs = inputs

    def exchange(self, octets: bytes, now: int) -> None:
        """A Data_Exchange that was accepted."""
        # a Fail_Safe slave is sent empty frames in Clear (docs/reference/protocol.md#clear)
        if len(octets) != self.output_len:
            self._make_void(now)
        elif not self._clear and (self.void or not self._started):
            self._make_valid(now)
        self._exchanged = True
        self._received = self._safe if self.void else octets
        if self.void or not self.synced:
            self.outputs = self._for_device()
        self._sample(now, hold=self.frozen)
        self._set_plain()

    def control(self, command: GlobalControl, now: int) -> None:
        """A Global_Control that concerns this slave (docs/reference/protocol.md#global_control): each further SYNC or
        FREEZE acts."""
        if self.plain:  # the slave application does not store the outputs of plain exchanges here
            self._received = self.outputs
        self._clear = command.clear
        self._operates = not command.clear
        if command.clear:
            self._make_void(now)
            self._received = self.outputs = self._safe
        elif self.void or not self._started:
            self._make_valid(now)
        passes = self._switch_sync(command)
        samples = self._switch_freeze(command)
        if passes or samples:
            self._sample(now, hold=self.frozen and not samples)
        self._set_plain()

    def _switch_sync(self, command: GlobalControl) -> bool:
        """Enter or leave the mode; True when the outputs received last go to the device now."""
        passes = self.synced if command.unsync else command.sync and self._device.sync_supported
        if passes:
            self.synced = not command.unsync
            self.outputs = self._for_device()
        return passes

    def _switch_freeze(self, command: GlobalControl) -> bool:
        """Enter or leave the mode; True when the inputs of this moment are to be held."""
        if command.unfreeze:
            self.frozen = False
            return False
        samples = command.freeze and self._device.freeze_supported
        if samples:
            self.frozen = True
        return samples

    def refresh(self, now: int) -> None:
        """The values of publishers have changed: the device gets them at once, unless SYNC holds its outputs. They are
        no outputs before the first Data_Exchange, before the master has said Operate, and in Clear."""
        if not self._exchanged or self.void or self.synced:
            return
        outputs = self._for_device()
        if outputs != self.outputs:
            self.outputs = outputs
            self._sample(now, hold=self.frozen)

    def _for_device(self) -> bytes:
        if self.overlay is None or self.void:
            return self._received
        return self.overlay(self._received, self._operates and self._exchanged)

    def _make_void(self, now: int) -> None:
        if not self.void:
            self.void = True
            with DEVICE_CALL:
                self._device.clear(now)

    def _make_valid(self, now: int) -> None:
        self.void = False
        self._started = True
        with DEVICE_CALL:
            self._device.operate(now)

    def _sample(self, now: int, *, hold: bool) -> None:
        try:
            inputs = self.run(self.outputs, now)
        except Exception as error:
            DEVICE_CALL.mark(error)
            raise
        self.take(inputs, hold=hold)

    def _set_plain(self) -> None:
        held = self.void or self.synced or self.frozen
        self.plain = self._started and not held and self.overlay is None


def _reply_with(inputs: bytes) -> Reply:
    return Reply(Resp.DL, inputs) if inputs else SC_REPLY


def wrong_inputs(inputs: object, expected: int) -> Exception:
    """The exception for a device that returns no inputs, or of the wrong length: they would go out on the wire."""
    if not isinstance(inputs, bytes):
        return TypeError(f"it returned {type(inputs).__name__}, inputs are bytes")
    return ValueError(f"it returned {len(inputs)} input octets, its configuration has {expected}")
