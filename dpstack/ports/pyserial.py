"""Serial ports through pyserial-asyncio: Windows, macOS, the BSDs, and Linux on processors without ``termios2``.

pyserial-asyncio waits for octets; the port writes straight to the descriptor (Windows: to pyserial). The transport's
``write`` waits for the next iteration of the loop (27.6 instead of 16.9 us an exchange), and pyserial's own ``write``
spins for ever on a full line.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import sys
from typing import Any, cast

import serial
import serial_asyncio

from dpstack.errors import PortBusyError, PortError
from dpstack.ports.base import Delivery, Loop, Port

if sys.platform == "win32":
    from builtins import OSError as TermiosError
else:
    from termios import error as TermiosError  # noqa: N812 - the C library's own error, which is no OSError

_FAILURES = (OSError, ValueError, TermiosError)  # pyserial's own errors are OSErrors


class PySerialPort(Port):
    """A serial port by its name in the system: ``COM3``, ``/dev/cu.usbserial-1420``."""

    delivery = Delivery.ADAPTER
    _failures = _FAILURES

    def __init__(self, name: str, baud: int, *, paced: bool = True, listen: bool = False) -> None:
        super().__init__(name, baud, paced=paced)
        self._listen = listen
        self._serial: Any = None
        self._transport: Any = None

    async def open(self) -> None:
        """Open 8E1, exclusive if the system has that, and flush. Raises PortError, PortBusyError, BaudError."""
        self.close()
        await asyncio.sleep(0)
        self.notices = []
        try:
            self._serial = self._open_serial(serial.PARITY_EVEN)
        except TermiosError:  # a pty refuses parity at the second open
            self._serial = self._open_serial(serial.PARITY_NONE)
            self.notices.append("has no parity bit (8E1 was asked for), only check sums protect the data")
        self._serial.reset_input_buffer()

    def set_baud(self, baud: int) -> None:
        port = self._serial
        if port is None:
            raise self._not_open()
        try:
            port.baudrate = baud
            port.reset_input_buffer()
        except _FAILURES as exc:
            raise self._refuses(baud, exc, "") from None
        self.baud = baud

    def read_now(self) -> bytes:
        port = self._serial
        if port is None:
            return b""
        try:
            waiting = port.in_waiting
            return cast(bytes, port.read(waiting)) if waiting else b""
        except _FAILURES:  # the reader in the loop notices a loss
            return b""

    def close(self) -> None:
        """Detach and close. A transport releases the descriptor in the next iteration of the loop."""
        self.detach()
        port, self._serial = self._serial, None
        transport, self._transport = self._transport, None
        if port is None:
            return
        with contextlib.suppress(*_FAILURES):
            port.reset_output_buffer()  # close() waits until all octets are sent
        if transport is None:
            port.close()
        else:
            transport.abort()

    def _send(self, octets: bytes) -> int:
        if self._serial is None or self._listen:
            return 0
        if sys.platform == "win32":
            try:
                return self._serial.write(octets) or 0
            except serial.SerialTimeoutException:
                return 0
        return os.write(self._serial.fileno(), octets)

    def _open_serial(self, parity: str) -> Any:
        port: Any = None
        try:
            port = serial.serial_for_url(
                self.name,
                baudrate=self.baud,
                parity=parity,
                timeout=0,
                write_timeout=0,
                exclusive=True,
                do_not_open=True,
            )
            if self._listen:
                port.rts = False  # a converter that RTS switches must not drive the bus
            port.open()
            port.timeout = 0  # sets the port again, as the transport will do: here an error can be handled
            return port
        except ValueError as exc:
            raise self._refuses(self.baud, exc) from None
        except TermiosError:
            if port is not None:
                port.close()
            if parity != serial.PARITY_NONE:
                raise
            raise PortError(f"{self.name}: cannot be set to 8N1; is it a serial port?") from None
        except OSError as exc:
            text = str(exc)
            if "exclusively lock" in text or "PermissionError(13" in text:  # POSIX; Windows
                raise PortBusyError(
                    f"{self.name} is held by another program: end it or take another port ({text})"
                ) from None
            raise PortError(f"{self.name}: {text}; check the name and that you may use it") from None

    def _start(self, loop: Loop) -> None:
        if self._transport is not None:
            self._transport.resume_reading()
        elif self._serial is not None:
            self._transport = serial_asyncio.SerialTransport(loop, _Protocol(self), self._serial)

    def _stop(self, loop: Loop) -> None:
        if self._transport is not None:
            self._transport.pause_reading()

    def _gone(self, transport: Any, exc: Exception) -> None:
        if transport is self._transport:
            self._transport = self._serial = None  # the transport closes it
            self._lose(str(exc))


class _Protocol(asyncio.Protocol):
    def __init__(self, port: PySerialPort) -> None:
        self._port = port
        self._transport: asyncio.BaseTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        if self._port._on_data is not None:
            self._port._on_data(data)

    def connection_lost(self, exc: Exception | None) -> None:
        if exc is not None:
            self._port._gone(self._transport, exc)
