"""``rfc2217://host:port``: a serial port of another machine, its rate and parity set over the network.

pyserial has the Telnet side, in a thread of its own and without a descriptor, so neither pyserial-asyncio nor a
selector can wait for it. A second thread here reads and delivers to the loop: about 0.1 ms later than a socket.
"""

from __future__ import annotations

import asyncio
import contextlib
import selectors
import threading
import warnings
from typing import Any, Final

import serial
import serial.rfc2217

from dpstack.errors import PortError
from dpstack.ports.base import Delivery, Loop, Port, host_and_port

#: time-out of one read: after it the reader thread notices that the port is closed
_READ_S: Final = 0.2
#: Octets that wait here for the loop at most; more are thrown away and counted.
_INBOX: Final = 30_080
#: Octets that wait in pyserial at most; TCP holds back the rest.
_BACKLOG: Final = 65_536
#: poll() has no greatest descriptor, select() has (1023); not every system has poll()
_Selector: Final = getattr(selectors, "PollSelector", selectors.SelectSelector)


class _Client(serial.rfc2217.Serial):  # type: ignore[misc]
    """pyserial's client. Its reading thread keeps the exception of a wrong answer in ``failure``, for the message.

    In pyserial the exception ends the thread, which prints a traceback.
    """

    failure: Exception | None = None

    def _telnet_read_loop(self) -> None:
        self._read_buffer.maxsize = _BACKLOG
        try:
            super()._telnet_read_loop()
        except Exception as exc:
            self.failure = exc

    def close(self) -> None:
        """Close, also while the reading thread waits for room in its buffer."""
        self.is_open = False
        waiting = self._read_buffer
        if waiting is not None:
            with waiting.mutex:
                waiting.queue.clear()
                waiting.not_full.notify_all()
        super().close()


class Rfc2217Port(Port):
    """A serial port served by an RFC 2217 server (``pyserial``'s examples, ser2net, terminal servers)."""

    delivery = Delivery.ADAPTER
    _failures = (OSError, ValueError)

    def __init__(self, name: str, baud: int, *, paced: bool = True, listen: bool = False) -> None:
        super().__init__(name, baud, paced=paced)
        self._listen = listen
        host_and_port(name, "rfc2217")
        self._serial: Any = None
        self._writable: Any = None  # a selector that has the socket
        self._lock = threading.Lock()
        self._inbox = bytearray()
        self._failure = ""

    async def open(self) -> None:
        """Connect and negotiate 8E1, in a thread since pyserial waits up to 5 s. Raises PortError, BaudError."""
        self.close()
        opening = asyncio.ensure_future(asyncio.to_thread(self._open_serial))
        try:
            port = await asyncio.shield(opening)
        except asyncio.CancelledError:
            opening.add_done_callback(_close_late)
            raise
        self._writable = _Selector()
        self._writable.register(port._socket, selectors.EVENT_WRITE)
        self._serial = port
        self._failure = ""
        self._inbox.clear()
        threading.Thread(target=self._receive, args=(port,), name=f"reader of {self.name}", daemon=True).start()

    def read_now(self) -> bytes:
        with self._lock:
            octets = bytes(self._inbox)
            self._inbox.clear()
        return octets

    def _send(self, octets: bytes) -> int:
        port = self._serial
        # pyserial has no time-out for writing here: ask before. A socket that is ready takes a telegram whole.
        if port is None or self._listen or not self._writable.select(0):
            return 0
        port.write(octets)
        return len(octets)

    def close(self) -> None:
        """Detach and hang up (in a thread: pyserial sleeps 0.3 s over it)."""
        self.detach()
        port, self._serial = self._serial, None
        if port is not None:
            self._writable.close()
            threading.Thread(target=_hang_up, args=(port,), name=f"closing {self.name}", daemon=True).start()

    def _open_serial(self) -> Any:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", DeprecationWarning)  # pyserial 3.5 starts its thread the old way
                client = _Client(None, baudrate=self.baud, parity=serial.PARITY_EVEN, timeout=_READ_S)
                if self._listen:
                    client.rts = False  # a converter that RTS switches must not drive the bus
                client.port = self.name
                client.open()
                return client
        except (OSError, ValueError) as exc:
            text = str(exc)
            if "parameter change" in text or "baudrate" in text:
                raise self._refuses(self.baud, text) from None
            raise PortError(f"{self.name}: {text}; is the server running, and does it speak RFC 2217?") from None

    def _receive(self, port: _Client) -> None:
        """The reader thread: runs until the port is closed or fails."""
        while self._serial is port:
            try:
                chunk = port.read(1)
                if chunk:
                    chunk += port.read(port.in_waiting)
            except Exception as exc:  # whatever a dying connection raises in pyserial
                if self._serial is port:
                    self._failure = self._reason(port, exc)
                    self._call_in_loop(self._fail)
                return
            if chunk and self._serial is port:
                with self._lock:
                    room = _INBOX - len(self._inbox)
                    self._inbox += chunk[:room]
                    self.discarded += len(chunk[room:])
                self._call_in_loop(self._deliver)

    def _reason(self, port: _Client, exc: Exception) -> str:
        if port.failure is not None:
            return f"the server sent what is not RFC 2217 ({type(port.failure).__name__}: {port.failure})"
        return str(exc) or type(exc).__name__

    def _call_in_loop(self, callback: Any) -> None:
        loop = self._loop
        if loop is not None:
            with contextlib.suppress(RuntimeError):  # the loop was closed meanwhile
                loop.call_soon_threadsafe(callback)

    def _deliver(self) -> None:
        if self._on_data is not None and self._inbox:
            self._on_data(self.read_now())

    def _fail(self) -> None:
        self._lose(self._failure)

    def _start(self, loop: Loop) -> None:
        loop.call_soon(self._fail if self._failure else self._deliver)

    def _stop(self, loop: Loop) -> None:
        """Nothing is registered: the reader thread finds no loop."""


def _hang_up(port: Any) -> None:
    """Close. pyserial leaves its socket open if the far end has closed the connection first."""
    connection = port._socket
    port.close()
    if connection is not None:
        connection.close()


def _close_late(opening: asyncio.Future[Any]) -> None:
    """Close a connection that was made after its ``open`` was cancelled."""
    if not opening.cancelled() and opening.exception() is None:
        threading.Thread(target=_hang_up, args=(opening.result(),), daemon=True).start()
