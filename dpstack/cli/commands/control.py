"""The control socket beside a running command: nice to have, never a reason not to run."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager

from dpstack.api.control.server import ControlServer
from dpstack.cli.terminal.lost_stdout import warn
from dpstack.errors import PortError


@asynccontextmanager
async def reachable(server: ControlServer, *, quiet: bool = False) -> AsyncIterator[str | None]:
    """``dpstack ctl`` works within; where it cannot, the line that says why is given, and printed unless ``quiet``."""
    why = None
    async with AsyncExitStack() as stack:
        try:
            await stack.enter_async_context(server)
            why = server.remark
        except PortError as error:
            why = str(error)
        if why is not None and not quiet:
            warn(why)
        yield why
