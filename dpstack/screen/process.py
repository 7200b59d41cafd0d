"""The end of ``dpstack run``: starts the process of the screen, sends items to it, receives orders of the person.

It never draws and never waits for the screen: items that the screen does not read are merged (:mod:`dpstack.plant`).
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from typing import Any, Final

from dpstack.plant.items import Item
from dpstack.plant.sender import Items, send_items
from dpstack.plant.state import begins_plant
from dpstack.ports.posix import termios
from dpstack.text import json_text

#: octets of the longest line to the screen
LONGEST: Final = 64 << 20
#: exit code of a screen whose terminal is lost
GONE: Final = 3
#: octets that may wait for the screen before its items are merged
_MOST_UNREAD: Final = 1 << 16
#: slaves in one message: making its JSON takes 0.2 ms with 244 octets each, then the bus has its turn
_SLAVES: Final = 8
#: octets of the longest order
_LONGEST_ORDER: Final = 1 << 12
#: s until the screen must have left the terminal, and its process must have ended
_LEAVE_S: Final = 2.0
#: signals that a terminal sends to the whole group: `run` decides, and informs the screen
_FROM_TERMINALS: Final = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGTSTP") if hasattr(signal, name)
)
#: what a screen that was killed has left switched on: mouse, focus, paste, key protocol, alternate screen, no cursor
_RESET: Final = b"".join(
    b"\x1b[" + code for code in b"?1000l ?1003l ?1015l ?1006l ?1004l ?2004l ?2048l <u ?7h ?1049l ?25h 0m".split()
)


def is_installed() -> bool:
    """Whether textual is there (the extra ``screen``); it is not imported here."""
    return find_spec("textual") is not None


class Terminal:
    """The state of the terminal ``fd`` at this moment, to set it back. Raises OSError, and PortError on systems without
    termios."""

    def __init__(self, fd: int) -> None:
        self.fd = fd
        self._attributes = termios.tcgetattr(fd)

    @property
    def in_foreground(self) -> bool:
        try:
            return os.tcgetpgrp(self.fd) == os.getpgrp()
        except OSError:
            return False

    def restore(self) -> None:
        """Echo and lines as before, the normal screen, a cursor. Never waits for the terminal."""
        before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGTTOU,))
        try:
            with contextlib.suppress(OSError, termios.error):
                termios.tcsetattr(self.fd, termios.TCSANOW, self._attributes)
                blocking = os.get_blocking(self.fd)
                os.set_blocking(self.fd, False)
                try:
                    os.write(self.fd, _RESET)
                finally:
                    os.set_blocking(self.fd, blocking)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


class ScreenProcess:
    """The process of the screen on ``terminal``. ``on_order`` gets each order, a dict with ``order``."""

    def __init__(self, terminal: Terminal, on_order: Callable[[Mapping[str, Any]], None]) -> None:
        self._terminal = terminal
        self._on_order = on_order
        self._process: subprocess.Popen[bytes] | None = None
        self._reader: asyncio.StreamReader | None = None
        self._writer: asyncio.StreamWriter | None = None
        self._left = asyncio.Event()

    async def start(self) -> None:
        """Start the process. Raises OSError."""
        ours, theirs = socket.socketpair()
        try:
            # in a thread, because fork and exec would stop the loop of the bus for some ms
            self._process = await asyncio.to_thread(_started, self._terminal.fd, theirs)
            await self.connect(ours)
        except OSError:
            ours.close()
            raise
        finally:
            theirs.close()

    async def connect(self, link: socket.socket) -> None:
        """Use this end of the socket pair."""
        self._reader, self._writer = await asyncio.open_connection(sock=link, limit=_LONGEST_ORDER)
        self._writer.transport.set_write_buffer_limits(high=_MOST_UNREAD)

    async def show(self, stream: Items, name: Callable[[], str]) -> None:
        """Send the items of ``stream`` until the screen ends. The screen gets ``name()``, the program's name for
        ``dpstack ctl``, as ``ctl`` of a plant."""
        assert self._reader is not None
        sending = asyncio.create_task(self._send(stream, name))
        try:
            while line := await self._reader.readline():
                order = json.loads(line)
                if isinstance(order, dict):
                    self._take(order)
        except (OSError, ValueError):
            pass  # it has ended, or sends nonsense: then it is ended
        finally:
            sending.cancel()
            stream.close()

    async def _send(self, stream: Items, name: Callable[[], str]) -> None:
        assert self._writer is not None

        def send(item: Item) -> None:
            self.tell({"plant": item["plant"] | {"ctl": name()}} if begins_plant(item) else item)

        with contextlib.suppress(OSError):
            await send_items(stream, send, self._writer.drain, _SLAVES)

    def _take(self, order: Mapping[str, Any]) -> None:
        if order.get("order") == "left":
            self._left.set()
        else:
            self._on_order(order)

    def tell(self, message: Mapping[str, Any]) -> None:
        """Send one message: an item, an order to the screen or an answer. Without effect once it has ended."""
        if self._writer is not None and not self._writer.is_closing():
            self._writer.write(json_text(message).encode() + b"\n")

    async def leave(self) -> None:
        """Make the screen leave the terminal; it goes on to receive items."""
        self._left.clear()
        self.tell({"screen": "leave"})
        try:
            async with asyncio.timeout(_LEAVE_S):
                await self._left.wait()
        except TimeoutError:
            self._terminal.restore()

    def come_back(self) -> None:
        """Let the screen have the terminal again."""
        self.tell({"screen": "return"})

    async def end(self) -> int:
        """End the process and restore the terminal. Returns its exit code, negative for a signal."""
        if self._writer is not None:
            self._writer.close()
        code = 0
        if self._process is not None:
            try:
                code = await asyncio.to_thread(self._process.wait, _LEAVE_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                code = await asyncio.to_thread(self._process.wait)
        self._terminal.restore()
        return code

    def kill(self) -> None:
        """End the process at once and restore the terminal, outside of the event loop."""
        if self._process is not None:
            self._process.kill()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(0.2)
        self._terminal.restore()


def _started(terminal: int, link: socket.socket) -> subprocess.Popen[bytes]:
    """The process has the terminal as its three standard streams: textual reads one and draws on another. Its size
    comes from there; COLUMNS and LINES are what it was at the start of a shell."""
    variables = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _FROM_TERMINALS)
    try:
        return subprocess.Popen(
            [sys.executable, "-P", "-m", "dpstack.screen", str(link.fileno())],
            stdin=terminal,
            stdout=terminal,
            stderr=terminal,
            pass_fds=(link.fileno(),),
            env=variables | {"PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))},
        )
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
