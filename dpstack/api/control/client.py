"""The client's end of the control socket: finds a running program by its port and sends commands."""

from __future__ import annotations

import contextlib
import json
import os
import socket
from collections.abc import Callable, Iterable, Iterator, Mapping
from time import monotonic_ns
from typing import TYPE_CHECKING, Any, Final, TypeVar

from dpstack.api.control.errors import failure
from dpstack.api.control.socket_path import Sockets, directory, names_of, os_errors, own_name, socket_name
from dpstack.errors import DpError, PortError, UsageError
from dpstack.ports import posix
from dpstack.ports.base import VIRTUAL
from dpstack.units import s_to_ns

if TYPE_CHECKING:
    from pathlib import Path

T = TypeVar("T")
#: time-out of an answer
TIMEOUT_S: Final = 10.0
_CHUNK: Final = 65_536
#: octets; a list of parameters comes in lines of a hundred
LONGEST_ANSWER: Final = 16_000_000
#: nested brackets in an answer; those of dpstack have at most eight
_MOST_LEVELS: Final = 32


def checked(value: object, kind: type[T], port: str, command: str) -> T:
    """Check that ``value``, the answer of the program on ``port`` to ``command``, has the fields of ``kind``.

    Returns them. Raises PortError: the program may be another version of dpstack, or something else. More fields are
    allowed, as a newer version may have them.
    """
    import msgspec  # here, as most commands of `dpstack ctl` do not need it

    try:
        return msgspec.convert(value, kind)
    except (msgspec.ValidationError, UnicodeError) as error:  # a lone surrogate in a key, for instance
        raise PortError(
            f"{port}: the answer to {command!r} is not as dpstack writes it ({error}): is it another version?"
        ) from None


class ControlClient:
    """A connection to the program that holds ``port``, made by :func:`connect`. A context manager."""

    def __init__(self, port: str, connection: socket.socket) -> None:
        self.port = port
        self._pid = 0  # unknown before :meth:`help`
        self._socket = connection
        self._rest = bytearray()
        self._searched = 0  # octets of _rest that have no line end

    def __enter__(self) -> ControlClient:
        return self

    def __exit__(self, *_exc: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection. A call that waits in another thread raises PortError."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    def call(
        self,
        command: str,
        *args: str,
        kind: type | None = None,
        progress: Callable[[str, int, int], None] | None = None,
        origin: str = "",
    ) -> Any:
        """The result of ``command``, checked for the fields of ``kind``, with the parameters of earlier items.

        ``origin``: who gives the order, if not the user of this program: one that is refused is reported there. A long
        command calls ``progress``. Raises the error of the program: UsageError or ConfigError for a wrong
        request, any other error for a failure (BusError for a defect); PortError if no program or another one
        answers.
        """
        result: Any = None
        found: list[object] = []
        for answer in self._answers(command, args, origin):
            if "item" not in answer:
                result = answer.get("result")
                continue
            from dpstack.api.control.answers import Item  # here and below, as most answers are not checked

            item = checked(answer["item"], Item, self.port, command)
            found.extend(item.get("parameters", ()))
            if progress is not None and "progress" in item:
                progress(*item["progress"])
        if found and isinstance(result, Mapping):
            result = {**result, "parameters": found}
        if kind is not None:
            checked(result, kind, self.port, command)
        return result

    def help(self) -> Any:
        """The description of the program, checked for the fields of :class:`~dpstack.api.control.answers.Help`. Raises
        like :meth:`call`.
        """
        from dpstack.api.control.answers import Help

        found = self.call("help", kind=Help)
        self._pid = found["pid"]
        return found

    @property
    def pid(self) -> int:
        """Process number of the program, which is asked for it once. Raises like :meth:`call`."""
        if not self._pid:
            self.help()
        return self._pid

    def detach(self) -> socket.socket:
        """Hand the connection over; this client can send no more commands."""
        return self._socket

    def _answers(self, command: str, args: tuple[str, ...], origin: str) -> Iterator[Mapping[str, Any]]:
        limit_s = self._socket.gettimeout() or TIMEOUT_S
        until = monotonic_ns() + s_to_ns(limit_s)  # later the program must not carry out the request
        by = {"origin": origin} if origin else {}
        request = json.dumps({"command": command, "args": list(args), "until_ns": until, **by}).encode() + b"\n"
        try:
            # a program that has closed the connection has sent the reason as its last line
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):
                self._socket.sendall(request)
            while True:
                answer = self._line()
                if answer.get("ok") is False:
                    raise failure(answer)
                yield answer
                if "ok" in answer:
                    return
        except DpError:  # some of them are OSErrors, too
            raise
        except TimeoutError:
            raise PortError(f"{self.port}: the program does not answer; is it stopped or busy?") from None
        except OSError as exc:
            raise PortError(f"{self.port}: the program closed the connection ({exc.strerror or exc})") from None

    def _line(self) -> Mapping[str, Any]:
        rest = self._rest
        while (end := rest.find(b"\n", self._searched)) < 0:
            self._searched = len(rest)
            if self._searched > LONGEST_ANSWER:
                raise PortError(f"{self.port}: an answer of more than {LONGEST_ANSWER} octets; is it dpstack?")
            chunk = self._socket.recv(_CHUNK)
            if not chunk:
                raise PortError(f"{self.port}: the program closed the connection before its answer was complete")
            rest += chunk
        line = bytes(rest[:end])
        del rest[: end + 1]
        self._searched = 0
        return self.parsed(line)

    def parsed(self, line: bytes) -> Mapping[str, Any]:
        """A line of the program. Raises PortError if it is no answer of dpstack."""
        try:
            answer = json.loads(line)
        except (ValueError, RecursionError):
            answer = None
        if not isinstance(answer, dict) or _levels(answer) > _MOST_LEVELS:
            raise PortError(f"{self.port}: the answer is no JSON object; is it another version of dpstack?")
        return answer


def connect(port: str, timeout: float | None = TIMEOUT_S) -> ControlClient:
    """Connect to the program that holds ``port``; ``timeout`` in seconds for each answer, None for no limit. "virtual"
    stands for the only run on it; if there are several, each has a name of its own, ``virtual:PID``.

    Raises PortError if none exists, UsageError when there are several; the message lists the programs.
    """
    posix.check("a control socket")
    with _open_directory() as sockets:
        name = port
        if sockets is not None and port == VIRTUAL:
            names = sockets.virtual_names()
            if len(names) > 1:
                there = _programs_text(_help_of(sockets, map(socket_name, names)))
                raise UsageError(
                    f'there are {len(names)} runs on "{VIRTUAL}": {there}; name the one that is meant, for instance '
                    f"`dpstack ctl {names[0]}`"
                )
            name = names[0] if names else port
        client = None if sockets is None else _connect_first(sockets, port, names_of(name), timeout)
    if client is not None:
        return client
    others = running()
    there = f"there is: {_programs_text(others)}" if others else "no run, sim or segment of yours is running"
    raise PortError(f"nobody answers for {port}; {there}")


def find_run(port: str, config: Path | None, timeout: float | None = TIMEOUT_S) -> ControlClient | None:
    """Connect to the run on ``port`` with the configuration file ``config``; None if no run answers for that port.
    On "virtual", where each program has a bus of its own, runs with other files do not count.

    Raises UsageError if the run has another file, or if several runs on "virtual" have this one; PortError if
    the program cannot connect to a run.
    """
    with _open_directory() as sockets:
        if sockets is None:
            return None
        if port == VIRTUAL:
            runs = _help_of(sockets, map(socket_name, sockets.virtual_names()), timeout)
            mine = [one["name"] for one in runs if is_same_file(one.get("config"), config)]
            if len(mine) > 1:
                raise UsageError(
                    f'{len(mine)} runs on "{VIRTUAL}" have the configuration {config}: {", ".join(mine)}; name the one '
                    f"that is meant: `dpstack ctl {mine[0]} drive NAME ORDER`, `dpstack web --join {mine[0]}`"
                )
            return _connect_first(sockets, port, mine, timeout)
        client = _connect_first(sockets, port, [own_name("run", name) for name in names_of(port)], timeout)
    if client is not None:
        _check_file(client, port, config)
    return client


def find_any_run(port: str, timeout: float | None = TIMEOUT_S) -> ControlClient | None:
    """Connect to the run on ``port``, whatever its configuration; None if no run answers for that port. "virtual"
    stands for the only run on it, as in :func:`connect`.

    Raises PortError if the program cannot connect to the run, UsageError if there are several on "virtual".
    """
    with _open_directory() as sockets:
        if sockets is None:
            return None
        virtual = sockets.virtual_names()
        if port not in (*virtual, *([VIRTUAL] if virtual else [])):
            return _connect_first(sockets, port, [own_name("run", name) for name in names_of(port)], timeout)
    return connect(port, timeout)


def running() -> list[dict[str, Any]]:
    """The ``help`` of every running program: kind, port, name, pid, config, commands. Removes stale sockets."""
    with _open_directory() as sockets:
        return [] if sockets is None else _help_of(sockets, sockets.names())


@contextlib.contextmanager
def _open_directory() -> Iterator[Sockets | None]:
    """The directory of the sockets; None if no program has created it. Raises PortError."""
    sockets = None
    with os_errors(f"control sockets in {directory()} cannot be looked at"), contextlib.suppress(FileNotFoundError):
        sockets = Sockets() if posix.is_available() else None
    with sockets or contextlib.nullcontext():
        yield sockets


def _connect_first(sockets: Sockets, port: str, names: Iterable[str], timeout: float | None) -> ControlClient | None:
    """Connect to the first of ``names`` that exists, else None. Raises PortError if its program is silent."""
    for name in map(socket_name, names):
        with (
            os_errors(f"{port}: its program cannot be reached"),
            contextlib.suppress(FileNotFoundError, ConnectionRefusedError),
        ):
            return ControlClient(port, _open(sockets, name, timeout))
    return None


def _help_of(sockets: Sockets, names: Iterable[str], timeout: float | None = 1.0) -> list[dict[str, Any]]:
    """The ``help`` of the programs behind the sockets ``names``, each once; without those that do not answer within
    ``timeout`` in seconds (None: no limit)."""
    found = []
    for name in names:
        if sockets.link_target(name) is not None:
            sockets.clean(name)
            continue
        with (
            contextlib.suppress(OSError, DpError),
            ControlClient(os.path.join(sockets.path, name), _open(sockets, name, timeout)) as client,
        ):
            found.append(client.help())
    return found


def _check_file(client: ControlClient, port: str, config: Path | None) -> None:
    """Close ``client`` and raise UsageError if its run has another configuration file than ``config``."""
    try:
        run = client.help()
        if not is_same_file(run.get("config"), config):
            mine = config or "a program without a configuration file"
            raise UsageError(
                f"the run on {port} (pid {run.get('pid')}) has the configuration "
                f"{run.get('config') or 'none from a file'}, not {mine}: give the one that the run has, or end that run"
            )
    except BaseException:
        client.close()
        raise


def _levels(answer: object) -> int:
    """The number of nested levels of objects and lists, counted up to the limit plus one."""
    count, level = 0, [answer]
    while level and count <= _MOST_LEVELS:
        below: list[object] = []
        for one in level:
            below += one.values() if isinstance(one, dict) else one if isinstance(one, list) else ()
        count, level = count + 1, below
    return count


def is_same_file(path: object, config: Path | None) -> bool:
    """Whether ``path``, the answer of a run, is the file ``config``: by its name, or by the file itself."""
    if not isinstance(path, str) or config is None:
        return False
    if path == str(config):
        return True
    try:
        return os.path.samefile(path, config)
    except (OSError, ValueError):
        return False


def _programs_text(programs: Iterable[Mapping[str, Any]]) -> str:
    """Programs for people: kind, name and configuration file."""
    texts = []
    for one in programs:
        config = one.get("config")
        texts.append(f"{one.get('kind')} on {one.get('name', one.get('port'))}" + (f" ({config})" if config else ""))
    return ", ".join(texts)


def _open(sockets: Sockets, name: str, timeout: float | None) -> socket.socket:
    """Connect to a socket. Removes it if it is stale. Raises OSError."""
    try:
        return sockets.connect(name, timeout)
    except ConnectionRefusedError:
        sockets.clean(name)
        raise
