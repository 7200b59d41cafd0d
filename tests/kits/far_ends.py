"""Other ends of ports, and waits for what happens there: they know octets and the operating system, nothing of the
project."""

from __future__ import annotations

import asyncio
import contextlib
import os
import resource
import socket
import termios
import threading
import time
import tty
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from typing import Any, Final

import serial
from serial import rfc2217

#: What did not happen for so long will not. For hangs only: no test shows how long something takes
HANG_S: Final = 60.0


What = str | Callable[[], object]
_UNSAID: Final = "what is waited for"


async def until(condition: Callable[[], object], what: What = _UNSAID) -> None:
    """Wait for something to happen. ``what`` may be what tells, when it has not, how things are."""
    end = time.monotonic() + HANG_S
    while not condition():
        assert time.monotonic() < end, f"did not happen: {what if isinstance(what, str) else what()}"
        await asyncio.sleep(0.001)


def eventually(condition: Callable[[], object], what: What = _UNSAID, limit_s: float = HANG_S) -> None:
    """The same without a loop."""
    end = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end, f"did not happen: {what if isinstance(what, str) else what()}"
        time.sleep(0.01)


@contextlib.asynccontextmanager
async def beside(work: Coroutine[Any, Any, None]) -> AsyncIterator[asyncio.Task[None]]:
    """``work`` goes on beside the block, and is cancelled behind it."""
    task = asyncio.create_task(work)
    try:
        yield task
    finally:
        task.cancel()
        await asyncio.wait((task,))


def free_port() -> int:
    """A TCP port of this computer that nobody has."""
    with socket.create_server(("127.0.0.1", 0)) as there:
        return int(there.getsockname()[1])


class FarEnd:
    """A non-blocking descriptor at the other end of a port."""

    def __init__(self, fd: int = -1) -> None:
        self.fd = fd
        if fd >= 0:
            os.set_blocking(fd, False)

    def send(self, octets: bytes) -> None:
        assert os.write(self.fd, octets) == len(octets)

    def take(self) -> bytes:
        """The octets that have arrived."""
        with contextlib.suppress(BlockingIOError):
            return os.read(self.fd, 65_536)
        return b""

    def stall(self) -> None:
        """Read nothing any more; a descriptor is read by the tests only, so nothing is to be done."""

    async def recv(self, count: int) -> bytes:
        got = b""
        async with asyncio.timeout(HANG_S):
            while len(got) < count:
                got += self.take()
                await asyncio.sleep(0.001)
        return got

    def hang_up(self) -> None:
        fd, self.fd = self.fd, -1
        if fd >= 0:
            os.close(fd)


def open_slave(path: str) -> FarEnd:
    """The slave end of a pty, raw."""
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(fd)
    return FarEnd(fd)


class PtyFarEnd(FarEnd):
    """The master end of a pty whose slave end the port under test opens by ``path``."""

    def __init__(self) -> None:
        master, slave = os.openpty()
        tty.setraw(slave)
        self.path = os.ttyname(slave)
        os.close(slave)
        super().__init__(master)


class TcpFarEnd(FarEnd):
    """A TCP server for one client at a time."""

    scheme = "socket"

    def __init__(self) -> None:
        super().__init__()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.path = f"{self.scheme}://127.0.0.1:{self._listener.getsockname()[1]}"

    def _accept(self) -> None:
        if self.fd < 0:
            connected, _address = self._listener.accept()
            connected.setblocking(False)
            self.fd = connected.detach()

    def send(self, octets: bytes) -> None:
        self._accept()
        super().send(octets)

    def take(self) -> bytes:
        self._accept()
        return super().take()

    def hang_up(self) -> None:
        self._accept()
        super().hang_up()

    def shut(self) -> None:
        FarEnd.hang_up(self)
        self._listener.close()


class Rfc2217FarEnd(FarEnd):
    """An RFC 2217 server made of pyserial's own server half, with a serial port that goes nowhere."""

    def __init__(self) -> None:
        super().__init__()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.path = f"rfc2217://127.0.0.1:{self._listener.getsockname()[1]}"
        self.line: Any = serial.serial_for_url("loop://")
        self._manager: Any = None
        self._client: socket.socket | None = None
        self._got = bytearray()
        self._reading = threading.Event()
        self._reading.set()
        threading.Thread(target=self._serve, daemon=True).start()

    def write(self, octets: bytes) -> None:
        """Send octets of the server half to its client."""
        if self._client is not None:
            self._client.sendall(octets)

    def send(self, octets: bytes) -> None:
        self.write(b"".join(self._manager.escape(octets)))

    def take(self) -> bytes:
        got = bytes(self._got)
        self._got.clear()
        return got

    def hang_up(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            client.shutdown(socket.SHUT_RDWR)

    def stall(self) -> None:
        self._reading.clear()

    def shut(self) -> None:
        self._reading.set()
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self.line.close()

    def _serve(self) -> None:
        while True:
            try:
                client, _address = self._listener.accept()
            except OSError:
                return
            with client:
                self._client = client
                self._manager = rfc2217.PortManager(self.line, self)
                with contextlib.suppress(OSError):
                    while chunk := client.recv(4096):
                        self._got += b"".join(self._manager.filter(chunk))
                        self._reading.wait()


@contextlib.contextmanager
def many_files_open() -> Iterator[None]:
    """The lowest free descriptor is beyond what select() can wait for."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, min(hard, 2048)), hard))
    files = [os.open(os.devnull, os.O_RDONLY)]
    try:
        while files[-1] < 1030:
            files.append(os.dup(files[0]))
        yield
    finally:
        for fd in files:
            os.close(fd)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def set_rate(fd: int, speed: int) -> None:
    """Set a rate that POSIX has a constant for (``termios.B500000`` ...)."""
    attributes = termios.tcgetattr(fd)
    attributes[4] = attributes[5] = speed
    termios.tcsetattr(fd, termios.TCSANOW, attributes)
