"""The server's end of the control socket: requests in, answers out, and nothing of it disturbs the bus."""

from __future__ import annotations

import asyncio
import contextlib
import inspect
import json
import os
import socket
from collections.abc import AsyncGenerator, Callable, Iterable, Mapping
from pathlib import Path
from typing import Final, NamedTuple, Never

from dpstack.api.control.failures import told
from dpstack.api.control.places import OWN_NAMES, answers, locked, names_of, own_name, socket_path
from dpstack.api.control.specs import Spec, find
from dpstack.errors import DpError, PortBusyError, PortError, UsageError
from dpstack.text import json_text

#: Does a command: takes its arguments, returns what JSON can hold, an awaitable of it, or an async generator of items.
Handler = Callable[[list[str]], object]

#: A request longer than this is none.
_LONGEST: Final = 65_536
_MOST_CLIENTS: Final = 16
#: A client that leaves so many octets unread is dropped, or fewer for so long.
_UNREAD: Final = 1 << 18
_PATIENCE_S: Final = 5.0


class Result(NamedTuple):
    """The last thing that a command which goes on yields, where it has a result beside its items."""

    value: object


class _GoneError(Exception):
    """The client hung up or does not read."""


class ControlServer:
    """Answers for one program while it is entered (``async with``).

    ``kind``: run, sim or segment. ``port``: what the program is found by; ``also``: and by this, unless another is.
    ``handlers``: one for each of ``specs`` except ``help``. Entering raises PortError where no socket can be made,
    PortBusyError where another program answers for the port already.
    """

    def __init__(
        self,
        kind: str,
        port: str,
        specs: Iterable[Spec],
        handlers: Mapping[str, Handler],
        *,
        also: str | None = None,
    ) -> None:
        self.kind = kind
        self.port = port
        self._also = also
        #: why `dpstack ctl` does not find it by its port, where another program has that name
        self.unheard: str | None = None
        #: a client that reads nothing for so long is dropped
        self.patience_s = _PATIENCE_S
        self._specs = tuple(specs)
        self._handlers = {"help": self._help, **handlers}
        self._paths: list[Path] = []
        self._server: asyncio.Server | None = None
        self._clients: set[asyncio.Task[None]] = set()

    async def __aenter__(self) -> ControlServer:
        try:
            listening = self._take_names()
        except PortError:
            raise
        except OSError as exc:
            raise PortError(f"no control socket ({exc.strerror or exc}): is the runtime directory writable?") from None
        # asyncio.start_unix_server would remove the path of a socket it was given, on some versions only
        self._server = await asyncio.start_unix_server(self._serve, sock=listening, limit=_LONGEST)
        if self._also is not None:
            with contextlib.suppress(PortBusyError):
                self._link(self._also)
        return self

    def move_to(self, port: str) -> None:
        """The port is called so now: be found by that too. Raises PortError, PortBusyError."""
        if self._server is not None:
            self._link(port)
        self.port = port

    async def __aexit__(self, *_exc: object) -> None:
        server, self._server = self._server, None
        if server is None:
            return
        server.close()
        for path in self._paths:
            path.unlink(missing_ok=True)
        clients = list(self._clients)
        for task in clients:
            task.cancel()
        if clients:
            await asyncio.wait(clients)

    # --- the socket ---------------------------------------------------------------------------------------------------

    def _take_names(self) -> socket.socket:
        """Bind under the first name; the others are links to it."""
        plain = [socket_path(name) for name in names_of(self.port)]
        first, *others = self._own(self.port) or plain
        listening = socket.socket(socket.AF_UNIX)
        try:
            with locked():
                for path in (first, *others):
                    self._clear(path)
                listening.bind(str(first))
                self._paths.append(first)
                os.chmod(first, 0o600)
                listening.listen(_MOST_CLIENTS)
                self._point(others)
                if first not in plain:
                    self._share(plain)
        except BaseException:
            listening.close()
            raise
        listening.setblocking(False)
        return listening

    def _link(self, port: str) -> None:
        """Be found by the names of ``port`` too. Raises PortError, PortBusyError."""
        paths = [path for path in map(socket_path, names_of(port)) if path not in self._paths]
        own = [path for path in self._own(port) if path not in self._paths]
        try:
            with locked():
                if own and not any(map(answers, own)):
                    for path in own:
                        self._clear(path)
                    self._point(own)
                for path in paths:
                    self._clear(path)
                self._point(paths)
        except PortError:
            raise
        except OSError as exc:
            raise PortError(f"not to be found by {port} ({exc.strerror or exc})") from None

    def _own(self, port: str) -> list[Path]:
        """Where a run is found as such: a sim behind the pty that it made has the plain name of the same path."""
        return [socket_path(own_name(self.kind, name)) for name in names_of(port)] if self.kind in OWN_NAMES else []

    def _share(self, paths: Iterable[Path]) -> None:
        """Be found by the plain names too, unless another program is."""
        try:
            for path in paths:
                self._clear(path)
            self._point(paths)
        except PortBusyError as busy:
            self.unheard = str(busy)

    def _point(self, paths: Iterable[Path]) -> None:
        for path in paths:
            path.symlink_to(self._paths[0].name)
            self._paths.append(path)

    def _clear(self, path: Path) -> None:
        """Remove a stale socket. Raises PortBusyError when somebody lives behind it."""
        if answers(path):
            raise PortBusyError(f"another program answers `dpstack ctl {self.port}` already; this one will not")
        path.unlink(missing_ok=True)

    # --- one client ---------------------------------------------------------------------------------------------------

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        if task is not None:
            self._clients.add(task)
            task.add_done_callback(self._clients.discard)
        try:
            if len(self._clients) > _MOST_CLIENTS:
                await self._send(writer, _error("too many clients at once: close some"))
            else:
                await self._talk(reader, writer)
        except (_GoneError, OSError, asyncio.CancelledError):
            pass  # gone, does not read, or the program ends
        finally:
            writer.transport.abort()

    async def _talk(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while True:
            try:
                line = await reader.readline()
            except ValueError:  # longer than the limit: where the next one begins is not known
                await self._send(writer, _error(f"a request has at most {_LONGEST} octets"))
                return
            if not line:
                return
            if line.strip():
                await self._answer(line, writer)

    async def _answer(self, line: bytes, writer: asyncio.StreamWriter) -> None:
        try:
            spec, args = self._understand(line)
            result = self._handlers[spec.name](args)
            if inspect.isasyncgen(result):
                result = await self._go_on(result, writer)
            elif inspect.isawaitable(result):
                result = await result
            answer: dict[str, object] = {"ok": True, "result": result}
        except _GoneError:
            raise
        except (DpError, ValueError) as error:  # a ValueError: of an argument
            answer = {**_error(str(error)), **told(error)}
        except Exception as error:  # a defect of the command is the client's to read, not the bus's to die of
            answer = _error(f"failed by a defect, please report it: {type(error).__name__}: {error}")
        await self._send(writer, answer)

    async def _go_on(self, items: AsyncGenerator[object, Never], writer: asyncio.StreamWriter) -> object:
        """Send the items; the result, where there is one. Who hangs up ends them."""
        async with contextlib.aclosing(items):
            async for item in items:
                if isinstance(item, Result):
                    return item.value
                await self._send(writer, {"item": item})
        return None

    def _understand(self, line: bytes) -> tuple[Spec, list[str]]:
        """Raises UsageError."""
        try:
            request = json.loads(line)
            name, args = request["command"], request.get("args", [])
        except (ValueError, RecursionError, TypeError, LookupError, AttributeError):
            name, args = None, None
        if not isinstance(name, str) or not isinstance(args, list) or not all(isinstance(a, str) for a in args):
            raise UsageError('a request is one line: {"command": "status", "args": []}, all arguments are texts')
        spec = find(self.kind, self._specs, name)
        spec.check(args)
        return spec, args

    async def _send(self, writer: asyncio.StreamWriter, answer: Mapping[str, object]) -> None:
        """Raises _GoneError when the client has gone or does not read."""
        writer.write(json_text(answer, default=str).encode() + b"\n")
        if writer.transport.get_write_buffer_size() > _UNREAD:
            raise _GoneError
        try:
            async with asyncio.timeout(self.patience_s):  # wait_for loses a cancellation on 3.11: the end would hang
                await writer.drain()
        except (OSError, TimeoutError):
            raise _GoneError from None

    def _help(self, _args: list[str]) -> object:
        commands = [spec.as_dict() for spec in self._specs]
        return {"kind": self.kind, "port": self.port, "pid": os.getpid(), "commands": commands}


def _error(text: str) -> dict[str, object]:
    return {"ok": False, "error": " ".join(text.split())}
