"""The client's end of the control socket: finds a running program by its port and tells it what to do."""

from __future__ import annotations

import contextlib
import json
import socket
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from dpstack.api.control.failures import failure
from dpstack.api.control.places import SUFFIX, clean, directory, names_of, own_name, socket_path
from dpstack.errors import DpError, PortError

#: No answer for so long: the program hangs.
TIMEOUT_S: Final = 10.0
_CHUNK: Final = 65_536


class ControlClient:
    """A connection to the program that holds ``port``, made by :func:`connect`; use it as a context manager."""

    def __init__(self, port: str, connection: socket.socket) -> None:
        self.port = port
        self._socket = connection
        self._rest = b""

    def __enter__(self) -> ControlClient:
        return self

    def __exit__(self, *_exc: object) -> None:
        self.close()

    def close(self) -> None:
        """Hang up; who waits for an answer in another thread is told that there is none."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    def call(self, command: str, *args: str, on_item: Callable[[Any], None] | None = None) -> Any:
        """The result of ``command``; ``on_item`` is told what came before it.

        Raises what it raised there: UsageError or ConfigError where the request is wrong, one of the others with all
        that it carries where it failed (a BusError that tells a defect, too). PortError when nobody answers.
        """
        result = None
        for answer in self._answers(command, args):
            if "item" not in answer:
                result = answer.get("result")
            elif on_item is not None:
                on_item(answer["item"])
        return result

    def items(self, command: str, *args: str) -> Iterator[Any]:
        """What a command that goes on tells, one by one. Raises like :meth:`call`."""
        for answer in self._answers(command, args):
            if "item" in answer:
                yield answer["item"]

    def _answers(self, command: str, args: tuple[str, ...]) -> Iterator[Mapping[str, Any]]:
        request = json.dumps({"command": command, "args": list(args)}).encode() + b"\n"
        try:
            self._socket.sendall(request)
            while True:
                answer = self._line()
                if answer.get("ok") is False:
                    raise failure(answer)
                yield answer
                if "ok" in answer:
                    return
        except DpError:  # of which some are built-in errors, too
            raise
        except TimeoutError:
            raise PortError(f"{self.port}: the program does not answer; is it stopped or busy?") from None
        except OSError as exc:
            raise PortError(f"{self.port}: the program ended ({exc.strerror or exc})") from None

    def _line(self) -> Mapping[str, Any]:
        while b"\n" not in self._rest:
            chunk = self._socket.recv(_CHUNK)
            if not chunk:
                raise PortError(f"{self.port}: the program ended without an answer")
            self._rest += chunk
        line, _, self._rest = self._rest.partition(b"\n")
        try:
            answer = json.loads(line)
        except ValueError:
            answer = None
        if not isinstance(answer, dict):
            raise PortError(f"{self.port}: the answer is no JSON object; is it another version of dpstack?")
        return answer


def connect(port: str, timeout: float | None = TIMEOUT_S) -> ControlClient:
    """The program that holds ``port``; ``timeout`` in seconds for each answer, None for no limit.

    Raises PortError when there is none; the line names the programs there are.
    """
    client = reach(port, timeout)
    if client is not None:
        return client
    others = [f"{one['kind']} on {one['port']}" for one in running()]
    there = "there is: " + ", ".join(others) if others else "no run, sim or segment of yours is running"
    raise PortError(f"nobody answers for {port}; {there}")


def reach(port: str, timeout: float | None = TIMEOUT_S, *, kind: str | None = None) -> ControlClient | None:
    """As :func:`connect`, ``kind``: a run only; None where there is no such program.

    Raises PortError where it cannot be reached.
    """
    for name in (own_name(kind, name) if kind is not None else name for name in names_of(port)):
        try:
            return ControlClient(port, _open(socket_path(name), timeout))
        except (FileNotFoundError, ConnectionRefusedError):
            continue
        except OSError as exc:
            raise PortError(f"{port}: its program cannot be reached ({exc.strerror or exc})") from None
    return None


def running() -> list[dict[str, Any]]:
    """The programs that can be talked to, as their ``help`` tells it: kind, port, pid, commands. Stale sockets go."""
    found = []
    for path in sorted(directory().glob(f"*{SUFFIX}")):
        if path.is_symlink():
            clean(path)
            continue
        with contextlib.suppress(OSError, DpError), ControlClient(str(path), _open(path, 1.0)) as client:
            found.append(client.call("help"))
    return found


def _open(path: Path, timeout: float | None) -> socket.socket:
    """Connect; a stale socket is removed. Raises OSError."""
    connection = socket.socket(socket.AF_UNIX)
    connection.settimeout(timeout)
    try:
        connection.connect(str(path))
    except BaseException as exc:
        connection.close()
        if isinstance(exc, ConnectionRefusedError):
            clean(path)
        raise
    return connection
