"""A ``dpstack run`` as a child process: it ends in order with the web server, however that ends."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
from collections import deque
from collections.abc import Callable, Sequence
from typing import Final

from dpstack.text import printable

#: the signal at the death of the parent is set in the child itself, before anything else
_PROGRAM: Final = """
import os, runpy, signal, sys
if sys.platform == "linux":
    import ctypes
    ctypes.CDLL(None).prctl(1, signal.SIGTERM)
if os.getppid() != int(sys.argv.pop(1)):
    sys.exit(1)
sys.argv[0] = "dpstack"
runpy.run_module("dpstack.cli.main", run_name="__main__")
"""
#: lines of its standard error that are kept
_KEPT: Final = 5
_LONGEST_LINE: Final = 1 << 16
#: seconds for the ordered end after the first signal (outputs to safe values, Clear, the token to others), the second
#: (one Clear), the third
_PATIENCE_S: Final = (15.0, 3.0, 1.0)


class Child:
    """``dpstack ARGS...`` in a session of its own: a Ctrl-C on the terminal reaches the web server alone.

    ``on_line`` gets each line of its standard error, ``on_output`` each of its standard output.
    """

    def __init__(
        self, args: Sequence[str], on_line: Callable[[str], None], on_output: Callable[[str], None] = lambda _: None
    ) -> None:
        self.text = "dpstack " + " ".join(args)
        self._args = args
        self._on_line = on_line
        self._on_output = on_output
        self._lines: deque[str] = deque(maxlen=_KEPT)
        self._process: asyncio.subprocess.Process | None = None
        self._reading: asyncio.Future[tuple[None, None]] | None = None

    async def start(self) -> None:
        """Raises OSError."""
        self._process = process = await asyncio.create_subprocess_exec(
            sys.executable,
            # -P: no module of the working directory
            *("-P", "-c", _PROGRAM, str(os.getpid()), *self._args),
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            start_new_session=True,
            limit=_LONGEST_LINE,
        )
        assert process.stdout is not None
        assert process.stderr is not None
        self._reading = asyncio.gather(_read(process.stdout, self._on_output), _read(process.stderr, self._note))

    @property
    def runs(self) -> bool:
        return self._process is not None and self._process.returncode is None

    @property
    def code(self) -> int | None:
        """Its exit code; None while it runs."""
        return None if self._process is None else self._process.returncode

    @property
    def last_line(self) -> str:
        """The last line of its standard error."""
        return self._lines[-1] if self._lines else f"it ended with exit code {self.code}, without a word"

    async def wait(self) -> None:
        """Until its end."""
        assert self._process is not None
        await self._process.wait()
        if self._reading is not None:
            await asyncio.wait({self._reading}, timeout=1.0)

    async def end(self) -> None:
        """End it in order, as SIGTERM does; more firmly if it does not end."""
        process = self._process
        if process is None:
            return
        for number, patience in zip((signal.SIGTERM, signal.SIGTERM, signal.SIGKILL), _PATIENCE_S, strict=True):
            if process.returncode is not None:
                break
            with contextlib.suppress(ProcessLookupError):
                process.send_signal(number)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(patience):
                    await process.wait()
        await self.wait()

    def _note(self, line: str) -> None:
        text = printable(line.removeprefix("dpstack: "))
        self._lines.append(text)
        self._on_line(text)


async def _read(stream: asyncio.StreamReader, on_line: Callable[[str], None]) -> None:
    """Read ``stream`` to its end, so that the process never waits for a reader."""
    while True:
        try:
            line = await stream.readline()
        except ValueError:  # a line without end
            continue
        if not line:
            return
        text = line.decode(errors="replace").strip()
        if text:
            on_line(text)
