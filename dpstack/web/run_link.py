"""The connection to the run: its stream of items, and commands, over its control socket."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncGenerator, Callable
from typing import Any, Final

from dpstack.api.control.client import ControlClient, connect
from dpstack.api.control.errors import failure
from dpstack.api.control.stream import stream_lines
from dpstack.errors import PortError, UsageError
from dpstack.plant.items import Item
from dpstack.ports.base import VIRTUAL

#: seconds between two snapshots of the run
INTERVAL_S: Final = 0.2

#: connects to the run; None without one. Blocks; raises DpError
Find = Callable[[], ControlClient | None]


class RunLink:
    """The run behind ``client``, which :meth:`items` uses up. ``about``: its answer to ``help``.

    ``find`` makes further connections, one for each command.
    """

    def __init__(self, client: ControlClient, about: dict[str, Any], find: Find) -> None:
        self.about = about
        self._client = client
        self._find = find
        self._connections: set[_Connection] = set()

    @classmethod
    async def join(cls, find: Find) -> RunLink | None:
        """The run that ``find`` finds; None without one. Raises DpError, PortError if it has no ``live``."""
        connection = _Connection(find)
        about = await connection.use(lambda client: client.help())
        client = connection.client
        if client is None:
            return None
        if not any(one["command"] == "live" for one in about["commands"]):
            connection.close()
            raise PortError(
                f"{client.port}: the {about['kind']} that holds it (pid {about['pid']}) has no command live: it is no "
                f"run, or another version of dpstack"
            )
        return cls(client, about, find)

    @property
    def text(self) -> str:
        """The run for people."""
        return f"{self.about['kind']} on {self.about.get('name', self.about['port'])} (pid {self.about['pid']})"

    async def items(self) -> AsyncGenerator[Item | None]:
        """The items of the run until it has ended, and can be found no more. None: it has sent nothing for 10 s (it is
        stopped, or busy).

        Raises the error of the run, PortError if it is no dpstack.
        """
        async with contextlib.aclosing(stream_lines(self._client, "live", f"{INTERVAL_S:g}")) as lines:
            async for line in lines:
                if line is None:
                    yield None
                    continue
                answer = self._client.parsed(line)
                if answer.get("ok") is False:
                    raise failure(answer)
                if "item" in answer:
                    yield answer["item"]

    async def call(self, command: str, *args: str, origin: str = "") -> Any:
        """The answer to ``command``, of this very run; ``origin``: who gives the order.

        Raises DpError: UsageError if another run is there now.

        Cancelled, it closes the connection, which ends a long command in the run.
        """

        def carry_out(client: ControlClient) -> Any:
            if client.help()["pid"] != self.about["pid"]:
                raise UsageError(f"{command}: the run that the page shows has ended, and another one is there now")
            return client.call(command, *args, origin=origin)

        name = str(self.about.get("name"))
        # there may be several runs of one configuration on "virtual", each with a name of its own
        connection = _Connection((lambda: connect(name)) if name.startswith(f"{VIRTUAL}:") else self._find)
        self._connections.add(connection)
        try:
            result = await connection.use(carry_out)
            if connection.client is None:
                raise PortError(f"{command}: the run has ended")
            return result
        finally:
            self._connections.discard(connection)
            connection.close()

    def close(self) -> None:
        """Disconnect the commands that are under way: they raise PortError."""
        for connection in self._connections:
            connection.close()


class _Connection:
    """A connection of its own to the run, used in a thread, as it blocks."""

    def __init__(self, find: Find) -> None:
        self._find = find
        self._closed = False
        #: None before :meth:`use`, and if there is no run
        self.client: ControlClient | None = None

    async def use(self, work: Callable[[ControlClient], Any]) -> Any:
        """The result of ``work``; None if there is no run. Cancelled, or with an error, it closes the connection."""
        task = asyncio.ensure_future(asyncio.to_thread(self._carry_out, work))
        try:
            return await asyncio.shield(task)
        except BaseException:
            self.close()
            await asyncio.wait({task})
            self.close()  # it may have connected meanwhile
            if not task.cancelled():
                task.exception()
            raise

    def _carry_out(self, work: Callable[[ControlClient], Any]) -> Any:
        client = self.client = self._find()
        if client is None:
            return None
        if self._closed:
            raise PortError(f"{client.port}: given up")
        return work(client)

    def close(self) -> None:
        self._closed = True
        if self.client is not None:
            self.client.close()
