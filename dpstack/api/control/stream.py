"""The lines of a long command from a running program, without blocking the event loop."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator

from dpstack.api.control.client import LONGEST_ANSWER, TIMEOUT_S, ControlClient
from dpstack.errors import DpError, PortError


async def stream_lines(client: ControlClient, command: str, *args: str) -> AsyncGenerator[bytes | None]:
    """The lines that the program sends after ``command``, until it ends or this generator is closed. None if it has
    sent nothing for 10 s (:data:`~dpstack.api.control.client.TIMEOUT_S`): it is stopped, or busy.

    It uses up the connection. Raises PortError when the connection breaks, and for a line without end.
    """
    connection = client.detach()
    connection.setblocking(False)
    reader, writer = await asyncio.open_unix_connection(sock=connection, limit=LONGEST_ANSWER)
    try:
        writer.write(json.dumps({"command": command, "args": list(args)}).encode() + b"\n")
        while True:
            try:
                async with asyncio.timeout(TIMEOUT_S):
                    line = await reader.readline()
            except TimeoutError:
                yield None
                continue
            if not line.endswith(b"\n"):
                return
            yield line
    except DpError:  # some of them are OSErrors, too
        raise
    except ValueError:  # a line without end
        raise PortError(f"{client.port}: an answer of more than {LONGEST_ANSWER} octets; is it dpstack?") from None
    except OSError as exc:
        raise PortError(f"{client.port}: the program closed the connection ({exc.strerror or exc})") from None
    finally:
        writer.close()
