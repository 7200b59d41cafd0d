"""The process of the live screen: ``python -m dpstack.screen FD``, started by ``dpstack run`` alone.

FD is its end of a socket pair: JSON lines with items of the live stream, and orders to the screen, come in; orders of
the person go out. The end of ``run`` closes it: then the screen leaves the terminal, and the process ends.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import select
import signal
import socket
import sys
from typing import Any, Final

from textual.drivers.linux_driver import LinuxDriver

from dpstack.screen.app import Plant
from dpstack.screen.pages import Order
from dpstack.screen.process import GONE, LONGEST
from dpstack.text import printable

#: the terminal is looked at this often (s)
_LOOK_S: Final = 0.5
#: the descriptor of the terminal
_TERMINAL: Final = 0


class TerminalPlant(Plant):
    """The screen on a terminal, at its end of the socket pair."""

    def __init__(self, link: socket.socket) -> None:
        super().__init__(self._send)
        self._link = link
        self._writer: asyncio.StreamWriter | None = None
        self._reading: asyncio.Task[None] | None = None
        self._left = False

    def on_mount(self) -> None:
        super().on_mount()
        self._settle_signals()
        self._reading = asyncio.create_task(self._read())
        self.set_interval(_LOOK_S, self._look_at_terminal)

    def _settle_signals(self) -> None:
        """`run` decides about its whole group, and informs this process by its line. Textual has set other handlers."""
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGTSTP, signal.SIGTTOU, signal.SIGTTIN):
            signal.signal(number, signal.SIG_IGN)
        asyncio.get_running_loop().add_signal_handler(signal.SIGCONT, self._continued)

    def _continued(self) -> None:
        """Stopped from outside and continued: somebody else may have set the terminal."""
        if not self._left:
            self._leave()
            self._come_back()

    async def _read(self) -> None:
        reader, self._writer = await asyncio.open_connection(sock=self._link, limit=LONGEST)
        self._send({"order": "ready"})
        try:
            while line := await reader.readline():
                self._take(json.loads(line))
        except (OSError, ValueError):
            pass
        self._keep_modes_of_shell()
        self.exit()

    def _keep_modes_of_shell(self) -> None:
        """If `run` was killed and the shell has the terminal again, its modes are the shell's."""
        with contextlib.suppress(OSError):
            if os.tcgetpgrp(_TERMINAL) != os.getpgrp() and isinstance(self._driver, LinuxDriver):
                self._driver.attrs_before = None

    def _take(self, message: dict[str, Any]) -> None:
        match message:
            case {"screen": "leave"}:
                self._leave()
                self._send({"order": "left"})
            case {"screen": "return"}:
                self._come_back()
            case {"screen": "note", "text": str(text)}:
                self.note = printable(text)
                self.dirty = True
            case {"why": {"slave": int(address), "story": dict(story)}}:
                self.tell_why(str(address), story)
            case {"why": {"slave": int(address), "error": str(text)}}:
                self.tell_why(str(address), text)
            case {"answer": {"text": str(text), "severity": str(severity)}}:
                self.tell_answer(text, "good" if severity == "info" else "warn")
            case _:
                self.feed(message)

    def _send(self, order: Order) -> None:
        if self._writer is not None and not self._writer.is_closing():
            self._writer.write(json.dumps(order).encode() + b"\n")

    def _leave(self) -> None:
        """Give the terminal back as it was."""
        if not self._left and self._driver is not None:
            self._left = True
            self._driver.suspend_application_mode()

    def _come_back(self) -> None:
        if self._left and self._driver is not None:
            self._driver.resume_application_mode()
            self._left = False
            self._settle_signals()
            self.action_redraw()

    def _look_at_terminal(self) -> None:
        """End if the terminal is lost: textual would read nothing from it without end."""
        poll = select.poll()
        poll.register(_TERMINAL, 0)
        if poll.poll(0):
            self._send({"order": "lost"})
            self.call_later(self._abandon)

    async def _abandon(self) -> None:
        if self._writer is not None:
            with contextlib.suppress(OSError, TimeoutError):
                await asyncio.wait_for(self._writer.drain(), 0.5)
        os._exit(GONE)


def main() -> int:
    if len(sys.argv) != 2 or not sys.argv[1].isdecimal():
        print("python -m dpstack.screen is started by dpstack run alone", file=sys.stderr)
        return 2
    os.nice(5)  # the process that drives the port goes first
    link = socket.socket(fileno=int(sys.argv[1]))
    app = TerminalPlant(link)
    app.run(mouse=False)
    return app.return_code or 0


if __name__ == "__main__":
    sys.exit(main())
