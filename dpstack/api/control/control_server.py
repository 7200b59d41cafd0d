"""The server's end of the control socket of a run, sim or segment. No client can disturb the bus.

During a long command the client receives items as signs of life. A client that closes the connection cancels it.
"""

from __future__ import annotations

import asyncio
import contextlib
import inspect
import itertools
import json
import math
import os
import socket
from collections.abc import Awaitable, Callable, Coroutine, Iterable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from time import monotonic_ns
from typing import Any, Final, TypeVar

from dpstack.api.control.commands import NOW, Spec, find
from dpstack.api.control.errors import error_fields
from dpstack.api.control.socket_path import (
    OWN_NAMES,
    Sockets,
    directory,
    is_trusted,
    names_of,
    os_errors,
    own_name,
    peer_uid,
    socket_name,
    virtual_name,
)
from dpstack.errors import DpError, OrderDropped, PortBusyError, UsageError
from dpstack.plant.orders import RefusedOrder
from dpstack.ports.base import VIRTUAL
from dpstack.ports.runtime_dir import user_name
from dpstack.text import json_text
from dpstack.units import NEVER, ms_text

_T = TypeVar("_T")
#: Carries out a command: from its arguments to a JSON value or a :data:`LongCommand`, or to an awaitable of them.
Handler = Callable[[list[str]], object]
#: Sends the client of a long command an item before the result.
Send = Callable[[object], Awaitable[None]]
#: Carries out a command with items; cancelled when the client closes the connection.
LongCommand = Callable[["Sender"], Awaitable[object]]

#: octets of a request at most
_LONGEST: Final = 65_536
_MOST_CLIENTS: Final = 16
#: connections that wait to be accepted
_BACKLOG: Final = 64
#: pause of accepting when no descriptor is free
_PAUSE_S: Final = 1.0
#: time limit for the next request of a client
_IDLE_S: Final = 60.0
#: octets that wait for the client of a stream (:meth:`Sender.offer`) at most, and one line
_MOST_OFFERED: Final = 1 << 20
#: s without an octet read after which a client is disconnected that has an answer to read
_PATIENCE_S: Final = 5.0


class _ClientGoneError(Exception):
    """The client closed the connection or does not read."""


class _Client:
    """A connection. ``idle_since``: time of the loop in s; None while a request is being answered."""

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self.writer: asyncio.StreamWriter | None = None
        self.idle_since: float | None = None

    @property
    def gone(self) -> bool:
        """Whether the connection is closed, or will be as soon as the last answer is sent."""
        return self.writer is None or self.writer.transport.is_closing()

    def hang_up(self, why: str | None = None) -> None:
        """Close the connection at once, also if the client does not read. ``why``: text of the last answer."""
        if self.writer is None:
            with contextlib.suppress(OSError):
                if why is not None:
                    self.connection.setblocking(False)
                    self.connection.send(_line(_error(why)))
            self.connection.close()
        elif not self.gone:
            if why is not None:
                self.writer.write(_line(_error(why)))
            transport = self.writer.transport
            if why is None or transport.get_write_buffer_size():
                transport.abort()
            else:
                transport.close()


class Sender:
    """Sends the items of a long command to its client; a :data:`Send`."""

    def __init__(self, send: Send, writer: asyncio.StreamWriter) -> None:
        self._send = send
        self._writer = writer

    async def __call__(self, item: object) -> None:
        """Send an item, and wait for a client that reads slowly. Raises if it has gone or does not read."""
        await self._send(item)

    def offer(self, line: bytes) -> bool:
        """Send ``line``, an encoded ``{"item": ...}`` with its line end, without waiting. False if it is not sent,
        as the client has too many octets to read, or has gone."""
        transport = self._writer.transport
        if transport.is_closing() or transport.get_write_buffer_size() > _MOST_OFFERED:
            return False
        transport.write(line)
        return True

    @property
    def unread(self) -> int:
        """Octets that wait for the client beyond those in the system's own buffers."""
        return self._writer.transport.get_write_buffer_size()

    def check(self) -> None:
        """Raises if the client has gone."""
        if self._writer.transport.is_closing():
            raise _ClientGoneError

    def give_up(self) -> None:
        """Disconnect a client that does not read. Raises."""
        self._writer.transport.abort()
        raise _ClientGoneError


class ControlServer:
    """The control server of a program, a context manager (``async with``).

    ``kind``: run, sim or segment. Clients find the program by ``port``, and by ``also`` unless another program has it.
    ``handlers``: one for each of ``specs`` except ``help``. ``config``: the configuration file, by which clients check
    that this is the right program. ``refused``: called with each order from outside that was refused: one of a page,
    or with :data:`NOW`. Entering raises PortError if it can make no socket, PortBusyError if another
    program answers for the port already.
    """

    def __init__(
        self,
        kind: str,
        port: str,
        specs: Iterable[Spec],
        handlers: Mapping[str, Handler],
        *,
        also: str | None = None,
        config: Path | None = None,
        refused: Callable[[RefusedOrder], object] | None = None,
    ) -> None:
        self.kind = kind
        self.port = port
        #: its name for `dpstack ctl`: the port, or a name of its own if several programs may have the same port
        self.name = port
        #: the absolute path of the configuration file; None without one
        self.config = config
        #: time of creation
        self.started = datetime.now(UTC)
        self._also = also
        self._refused = refused
        #: the reason why `dpstack ctl` does not find the program by its port alone; None if it does
        self.remark: str | None = None
        #: time limit (s) for a client that reads nothing of its answer
        self.patience_s = _PATIENCE_S
        #: time limit (s) for a client that sends no request
        self.idle_s = _IDLE_S
        self._specs = tuple(specs)
        self._handlers = {"help": self._help, **handlers}
        self._sockets: Sockets | None = None
        self._names: list[str] = []  # file names: the socket, then links to it
        self._listening: socket.socket | None = None
        self._pause: asyncio.TimerHandle | None = None
        self._clients: dict[asyncio.Task[None], _Client] = {}

    async def __aenter__(self) -> ControlServer:
        try:
            with os_errors(f"no control socket in {directory()}", ": is it writable?"):
                self._listening = self._bind_names()
        except BaseException:
            self._release()
            raise
        self._listen()
        if self._also is not None:
            with contextlib.suppress(PortBusyError):
                self._link(self._also)
        return self

    def move_to(self, port: str) -> None:
        """Add ``port``, the new name of the port, to the names of this program. Raises PortError, PortBusyError."""
        self._link(port)
        self.port = self.name = port

    async def __aexit__(self, *_exc: object) -> None:
        self._release()  # before it stops to listen: until then no other program takes its names
        self._stop_listening()
        clients = list(self._clients)
        for task in clients:
            task.cancel()
        if clients:
            await asyncio.wait(clients)

    # --- the socket -----------------------------------------------------------------------------------------------

    def _release(self) -> None:
        """Remove the socket and its links."""
        names, self._names = self._names, []
        sockets, self._sockets = self._sockets, None
        if sockets is not None:
            with sockets:
                for name in names:
                    sockets.remove(name)

    def _bind_names(self) -> socket.socket:
        """Bind a socket under the first name of the port, and make links under the others. Returns the socket."""
        sockets = self._sockets = Sockets(make=True)
        with sockets.locked():
            own, shared = self._own_names(self.port), list(map(socket_name, names_of(self.port)))
            if self.port == VIRTUAL:
                own, shared = [self._name_on_virtual(sockets)], []
            elif not own:
                own, shared = shared, []
            for name in own:
                self._remove_stale(sockets, name)
            listening = socket.socket(socket.AF_UNIX)
            try:
                sockets.bind(listening, own[0])
                self._names.append(own[0])
                listening.listen(_BACKLOG)
                self._link_all(sockets, own[1:])
                try:
                    self._link_all(sockets, shared)
                except PortBusyError as busy:
                    self.remark = str(busy)
            except BaseException:
                listening.close()
                raise
        listening.setblocking(False)
        return listening

    def _name_on_virtual(self, sockets: Sockets) -> str:
        """The socket of a name for this run on "virtual", so that a command never goes to another run."""
        others = sockets.virtual_names()
        self.name = next(name for name in map(virtual_name, itertools.count(1)) if name not in others)
        if others:
            self.remark = (
                f'there are other runs on "{VIRTUAL}" ({", ".join(others)}): this one answers `dpstack ctl {self.name}`'
            )
        return socket_name(self.name)

    def _link(self, port: str) -> None:
        """Make links under the names of ``port``. Raises PortError, PortBusyError."""
        sockets = self._sockets
        if sockets is None:  # the server is not entered
            return
        names = [name for name in map(socket_name, names_of(port)) if name not in self._names]
        own = [name for name in self._own_names(port) if name not in self._names]
        with os_errors(f"not to be found by {port}"), sockets.locked():
            with contextlib.suppress(PortBusyError):
                self._link_all(sockets, own)
            self._link_all(sockets, names)

    def _own_names(self, port: str) -> list[str]:
        """The names for the run only: a sim on the other end of a pty has the plain name of the same path."""
        return [socket_name(own_name(self.kind, name)) for name in names_of(port)] if self.kind in OWN_NAMES else []

    def _link_all(self, sockets: Sockets, names: Sequence[str]) -> None:
        """Make links ``names`` to the socket. Raises PortBusyError, and makes none, when another program has one."""
        for name in names:
            self._remove_stale(sockets, name)
        for name in names:
            sockets.link(name, self._names[0])
            self._names.append(name)

    def _remove_stale(self, sockets: Sockets, name: str) -> None:
        """Remove the socket or link ``name`` of a killed program. Raises PortBusyError when another program has it.

        (A link of a killed program may lead to the socket that this program has just bound.)
        """
        if sockets.link_target(name) not in self._names and sockets.answers(name):
            raise PortBusyError(f"another program answers `dpstack ctl {self.port}` already; this one will not")
        sockets.remove(name)

    # --- clients ---------------------------------------------------------------------------------------------------

    def _listen(self) -> None:
        self._pause = None
        if self._listening is not None:
            asyncio.get_running_loop().add_reader(self._listening.fileno(), self._accept)

    def _stop_listening(self) -> None:
        listening, self._listening = self._listening, None
        if self._pause is not None:
            self._pause.cancel()
        if listening is not None:
            asyncio.get_running_loop().remove_reader(listening.fileno())
            listening.close()

    def _accept(self) -> None:
        """Accept a connection. (asyncio's server of 3.11 loses a connection that comes while it is closed.)"""
        listening = self._listening
        if listening is None:
            return
        loop = asyncio.get_running_loop()
        try:
            connection, _ = listening.accept()
        except (BlockingIOError, InterruptedError, ConnectionAbortedError):
            return
        except OSError:  # no free descriptor, for instance: try again later
            loop.remove_reader(listening.fileno())
            self._pause = loop.call_later(_PAUSE_S, self._listen)
            return
        client = _Client(connection)
        why = self._why_refused(client)
        if why is not None:
            client.hang_up(why)
            return
        task = loop.create_task(self._serve(client))
        self._clients[task] = client
        task.add_done_callback(lambda task: self._over(task, client))

    def _over(self, task: asyncio.Task[None], client: _Client) -> None:
        self._clients.pop(task, None)
        client.hang_up()

    def _why_refused(self, client: _Client) -> str | None:
        """The reason to refuse the new client, else None. If there are too many, disconnect the one idle longest."""
        try:
            uid = peer_uid(client.connection)
        except OSError as exc:
            return str(exc)
        if not is_trusted(uid):
            return f"only {user_name(os.geteuid())} and root may give orders to this program"
        if len(self._clients) < _MOST_CLIENTS:
            return None
        idle = {task: one.idle_since for task, one in self._clients.items() if one.idle_since is not None}
        if not idle:
            return f"{len(self._clients)} clients have an order under way: end some of them"
        idlest = self._clients.pop(min(idle, key=idle.__getitem__))
        idlest.hang_up("closed: there are too many clients, and this one was idle longest; connect again")
        return None

    async def _serve(self, client: _Client) -> None:
        # the client has gone or does not read, or the program ends
        with contextlib.suppress(_ClientGoneError, OSError, asyncio.CancelledError):
            reader, client.writer = await asyncio.open_unix_connection(sock=client.connection, limit=_LONGEST)
            client.idle_since = asyncio.get_running_loop().time()
            await self._answer_requests(reader, client)

    async def _answer_requests(self, reader: asyncio.StreamReader, client: _Client) -> None:
        while True:
            try:
                async with asyncio.timeout(self.idle_s):
                    line = await reader.readline()
            except TimeoutError:
                client.hang_up(f"closed: no request came for {self.idle_s:g} s; connect again")
                return
            except ValueError:  # too long: the beginning of the next request is unknown
                client.hang_up(f"a request has at most {_LONGEST} octets")
                return
            if not line or client.writer is None or client.gone:
                return
            if line.strip():
                client.idle_since = None
                await self._answer(line, client.writer)
                client.idle_since = asyncio.get_running_loop().time()

    async def _answer(self, line: bytes, writer: asyncio.StreamWriter) -> None:
        request = _parsed(line)
        try:
            spec, args = self._check_request(request)
            result = self._handlers[spec.name](args)
            if inspect.isawaitable(result):
                result = await result
            if callable(result):
                result = await result(Sender(lambda item: self._send(writer, {"item": item}), writer))
            answer: dict[str, object] = {"ok": True, "result": result}
        except _ClientGoneError:
            raise
        except (DpError, ValueError) as error:  # ValueError: a wrong argument
            answer = {**_error(str(error)), **error_fields(error)}
            self._report(request, str(error))
        except Exception as error:  # a defect of a command must not end the bus
            answer = _error(f"failed by a defect, please report it: {type(error).__name__}: {error}")
            self._report(request, str(answer["error"]))
        await self._send(writer, answer)

    def _report(self, request: Mapping[str, Any], why: str) -> None:
        """Report a ``request`` that was refused, if it is an order from outside."""
        name, args = request.get("command"), request.get("args", [])
        if self._refused is None or not isinstance(name, str) or not isinstance(args, list):
            return
        origin = request.get("origin") or ("control socket" if args[:1] == [NOW] else "")
        if origin:
            order = " ".join(map(str, (name, *args[args[:1] == [NOW] :])))
            self._refused(RefusedOrder(order, why, str(origin)))

    def _check_request(self, request: Mapping[str, Any]) -> tuple[Spec, list[str]]:
        """The command and its arguments. Raises UsageError, and OrderDropped for a request after its time limit."""
        name, args, until = request.get("command"), request.get("args", []), request.get("until_ns", NEVER)
        if type(until) is not int or abs(until) > NEVER:
            name = None
        elif (late := monotonic_ns() - until) > 0:
            raise OrderDropped(
                f"this program took the order {ms_text(late)} too late (it was stopped, or busy) and dropped it"
            )
        if not isinstance(name, str) or not isinstance(args, list) or not all(isinstance(a, str) for a in args):
            raise UsageError('a request is one line: {"command": "status", "args": []}, all arguments are texts')
        spec = find(self.kind, self._specs, name)
        spec.check(args)
        return spec, args

    async def _send(self, writer: asyncio.StreamWriter, answer: Mapping[str, object]) -> None:
        """Raises _ClientGoneError when the client has gone, or has read nothing for :attr:`patience_s`: an answer of a
        large plant is longer than the buffers of the system, and of any length as long as its client reads."""
        transport = writer.transport
        writer.write(_line(answer))
        unread = math.inf
        while (waiting := transport.get_write_buffer_size()) < unread:
            unread = waiting
            try:
                # wait_for loses a cancellation on 3.11: the end would hang
                async with asyncio.timeout(self.patience_s):
                    await writer.drain()
                return
            except TimeoutError:
                continue
            except OSError:
                break
        raise _ClientGoneError

    def _help(self, _args: list[str]) -> object:
        commands = [spec.as_dict() for spec in self._specs]
        return {
            "kind": self.kind,
            "port": self.port,
            "name": self.name,
            "pid": os.getpid(),
            "config": None if self.config is None else str(self.config),
            "started": self.started.isoformat(timespec="seconds").replace("+00:00", "Z"),
            "commands": commands,
        }


def _parsed(line: bytes) -> Mapping[str, Any]:
    """The request in ``line``; empty for other octets."""
    try:
        request = json.loads(line)
    except (ValueError, RecursionError):
        return {}
    return request if isinstance(request, dict) else {}


def _line(answer: Mapping[str, object]) -> bytes:
    return json_text(answer, default=str).encode() + b"\n"


def _error(text: str) -> dict[str, object]:
    return {"ok": False, "error": " ".join(text.split())}


#: interval in s of the signs of life; without them the client of a long command would give up
_SIGN_OF_LIFE_S: Final = 0.5


async def kept_alive(work: Coroutine[Any, Any, _T], sign: Callable[[], object], send: Send) -> _T:
    """The result of ``work``. Until then send ``sign()`` as an item repeatedly. A cancellation cancels ``work``."""
    order = asyncio.ensure_future(work)
    try:
        while not (await asyncio.wait({order}, timeout=_SIGN_OF_LIFE_S))[0]:
            await send(sign())
        return order.result()
    finally:
        order.cancel()
        with contextlib.suppress(asyncio.CancelledError, Exception):
            await order
