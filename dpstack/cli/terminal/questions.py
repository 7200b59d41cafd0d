"""Questions on standard error, with answers from standard input; a pipe may hold them."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TypeVar

from dpstack.cli.terminal import output
from dpstack.errors import ConfigError, UsageError
from dpstack.text import printable

_T = TypeVar("_T")


def say(text: str) -> None:
    """One line for the person at the keyboard."""
    with output.guarded():
        sys.stderr.write(printable(text) + "\n")
        sys.stderr.flush()


class Questions:
    """The questions of ``command``, which makes ``what`` of the answers.

    After the end of input every question gets its default.
    """

    def __init__(self, command: str, what: str) -> None:
        self._command, self._what = command, what
        self._ended = False

    def ask(
        self,
        prompt: str,
        read: Callable[[str], _T],
        default: str | None = None,
        search: Callable[[str], None] | None = None,
    ) -> _T:
        """Ask until ``read`` accepts the answer (it raises ConfigError or UsageError otherwise); an empty answer is
        ``default``.

        ``search`` gets the text of an answer ``/text`` or ``?text``, then the question comes again. Raises UsageError
        if the input has ended and there is no default.
        """
        while True:
            line = "" if self._ended else self._line(prompt)
            if not line and default is None:
                raise UsageError(
                    f"{self._command}: the answers ended before the {self._what} was complete; nothing was written"
                )
            answer = line.strip() or (default or "")
            if search is not None and answer[:1] in ("/", "?"):
                search(answer[1:].strip())
                continue
            try:
                return read(answer)
            except (ConfigError, UsageError) as error:
                if self._ended:
                    raise UsageError(f"{self._command}: {error}; nothing was written") from None
                output.warn(str(error))

    def _line(self, prompt: str) -> str:
        """One line of input with its line end; empty at the end of input."""
        with output.guarded():
            sys.stderr.write(printable(prompt))
            sys.stderr.flush()
        line = sys.stdin.readline()
        if not line:
            self._ended = True
            say("")
        return line
