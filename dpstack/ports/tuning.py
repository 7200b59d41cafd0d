"""Makes an open serial port quick and fit for RS-485, and leaves it as it was found.

What a port cannot do is tolerated and said in one line; ``dpstack doctor`` says what each of it means.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Final

from dpstack.ports import uart
from dpstack.ports.fdport import reason_of
from dpstack.ports.sysfs import Adapter

#: every telegram with data ends with ED; SC and the token do not, and within data it costs an early packet only
ED: Final = 0x16


class Tuning:
    """Of one open descriptor. ``event_char``: let an FTDI deliver at every ED octet instead of waiting for its timer.

    ``rs485`` False: the driver's RS-485 mode is left as it is (a converter behind an RS-232 port switches by itself).
    ``notices``: what had to be tolerated. ``errors``: the driver's error counters at the start, None where it has none.
    """

    def __init__(self, fd: int, adapter: Adapter, *, event_char: bool = False, rs485: bool = True) -> None:
        self.notices: list[str] = []
        self.errors: uart.UartErrors | None = None
        self._fd = fd
        self._adapter = adapter
        self._undo: list[Callable[[], object]] = []
        self._missing: list[str] = []
        self._low_latency()
        self._latency_timer()
        if rs485:
            self._rs485()
        self._counters()
        if event_char:
            self._event_char()
        if self._missing:
            self.notices.append(f"its driver has no {', no '.join(self._missing)} (see `dpstack doctor`)")

    def restore(self) -> None:
        """Everything as it was found, as far as the port is still there."""
        undo, self._undo = self._undo, []
        for step in reversed(undo):
            with contextlib.suppress(OSError):
                step()

    def damage(self) -> dict[str, int]:
        """What the driver counted since the start, by name; empty where it cannot count."""
        if self.errors is None:
            return {}
        try:
            return uart.errors(self._fd).since(self.errors)
        except OSError:  # gone
            return {}

    def _low_latency(self) -> None:
        try:
            was = uart.set_low_latency(self._fd, True)
        except OSError:
            self._missing.append("low-latency mode")
            return
        if not was:
            self._undo.append(lambda: uart.set_low_latency(self._fd, False))

    def _latency_timer(self) -> None:
        """FTDI: the low-latency mode sets it in newer kernels; where it did not, sysfs may."""
        before = self._adapter.latency_ms()
        if before is None or before <= 1:
            return
        try:
            self._adapter.set_latency_ms(1)
        except OSError as exc:
            self.notices.append(
                f"its latency timer stays at {before} ms ({reason_of(exc)}), which every exchange may cost: "
                f"run tools/setup_adapter.sh once"
            )
            return
        self._undo.append(lambda: self._adapter.set_latency_ms(before))

    def _rs485(self) -> None:
        try:
            before = uart.get_rs485(self._fd)
        except OSError:
            if self._adapter.usb is None:  # a USB adapter switches its direction by itself
                self._missing.append("RS-485 mode")
            return
        if before[0] & uart.RS485_ENABLED:
            return  # the administrator, or the board's description, knows better
        off = uart.RS485_RTS_AFTER_SEND | uart.RS485_RX_DURING_TX
        flags = before[0] & ~off | uart.RS485_ENABLED | uart.RS485_RTS_ON_SEND
        try:
            uart.set_rs485(self._fd, (flags, *before[1:]))
        except OSError as exc:
            self.notices.append(f"its driver refuses the RS-485 mode ({reason_of(exc)}): who switches the direction?")
            return
        self._undo.append(lambda: uart.set_rs485(self._fd, before))

    def _counters(self) -> None:
        try:
            self.errors = uart.errors(self._fd)
        except OSError:
            self._missing.append("error counters")

    def _event_char(self) -> None:
        try:
            self._adapter.set_event_char(ED)
        except OSError as exc:
            self.notices.append(f"event_char cannot be set ({reason_of(exc)}): it is for FTDI chips, leave it out")
            return
        self._undo.append(lambda: self._adapter.set_event_char(None))
