"""The state of a running bus for the service manager (systemd), by the protocol of sd_notify(3).

The manager names a datagram socket in ``NOTIFY_SOCKET``; a message is lines of the form ``NAME=value``. Without that
variable nothing is sent.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

from dpstack.text import printable

#: the state is looked at this often (s), and at least four times in the watchdog's time
_LOOK_S: Final = 1.0
_LOOKS: Final = 4
#: while the bus runs but is not ready yet, the manager is asked to wait this much longer (us)
_LONGER_US: Final = 60_000_000
_US_PER_S: Final = 1_000_000


class BusState(NamedTuple):
    """A bus as its manager sees it."""

    #: up, and in the mode that was asked for
    ready: bool
    #: a number that changes while the bus runs and stands still otherwise: its token receipts
    beat: int
    #: one line for people
    status: str


class Manager:
    """The service manager of this process."""

    def __init__(self, address: str, watchdog_s: float | None = None) -> None:
        """``address``: path of a socket, or "@NAME" of an abstract one. ``watchdog_s``: None for no watchdog."""
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self.watchdog_s = watchdog_s

    @classmethod
    def of(cls, environment: Mapping[str, str]) -> Manager | None:
        """The manager that ``environment`` names; None without one."""
        address = environment.get("NOTIFY_SOCKET", "")
        if not address.startswith(("/", "@")) or not hasattr(socket, "AF_UNIX"):
            return None
        watchdog = environment.get("WATCHDOG_USEC", "")
        mine = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        limit = int(watchdog) if watchdog.isascii() and watchdog.isdecimal() and mine else 0
        return cls(address, limit / _US_PER_S or None)

    def tell(self, *lines: str) -> None:
        """Send ``lines``. Never waits; a message that the manager does not take is lost."""
        message = "\n".join(lines).encode()
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
            link.setblocking(False)
            link.sendto(message, self._address)


class ServiceReport:
    """Reports to the service manager what ``state`` returns; does nothing if there is no manager.

    ``READY=1`` once, ``STATUS=`` after a change, ``WATCHDOG=1`` while the bus runs: it says that the bus has gone on
    since the last look. A stuck machine, a dead or stopped bus process and a lost port send none, and a blocked event
    loop cannot send one. A context manager; :meth:`end` says ``STOPPING=1``.
    """

    def __init__(self, state: Callable[[], BusState], environment: Mapping[str, str] = os.environ) -> None:
        self._manager = Manager.of(environment)
        self._state = state
        self._last = BusState(ready=False, beat=0, status="")
        self._ready = False
        self._looking: asyncio.Task[None] | None = None

    def __enter__(self) -> ServiceReport:
        if self._manager is not None:
            self._looking = asyncio.get_running_loop().create_task(self._keep_looking(self._manager))
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def end(self) -> None:
        """The bus begins its end. May be repeated."""
        if self._manager is not None and self._looking is not None:
            self._looking.cancel()
            self._looking = None
            self._manager.tell("STOPPING=1", "STATUS=ending: safe values, Clear")

    async def _keep_looking(self, manager: Manager) -> None:
        watched = manager.watchdog_s
        interval_s = _LOOK_S if watched is None else min(_LOOK_S, watched / _LOOKS)
        while True:
            lines = self._news(watched=watched is not None)
            if lines:
                manager.tell(*lines)
            await asyncio.sleep(interval_s)

    def _news(self, *, watched: bool) -> list[str]:
        last, self._last = self._last, self._state()
        runs = self._last.beat != last.beat
        lines = [f"STATUS={printable(self._last.status)}"] if self._last.status != last.status else []
        if runs and self._last.ready and not self._ready:
            self._ready = True
            lines.append("READY=1")
        elif runs and not self._ready:
            lines.append(f"EXTEND_TIMEOUT_USEC={_LONGER_US}")
        if runs and self._ready and watched:
            lines.append("WATCHDOG=1")
        return lines
