"""``Parser``: command lines of the program, their errors and help."""

from __future__ import annotations

import argparse
import contextlib
import gc
import importlib
import sys
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, Final, NoReturn

from dpstack.cli.terminal import output
from dpstack.text import printable

#: for the arguments, each of which is formatted once as it is added: the width of the terminal takes 3 ms to find
_ANY_WIDTH: Final = partial(argparse.RawDescriptionHelpFormatter, width=80)


@contextlib.contextmanager
def lasting() -> Iterator[None]:
    """Around the import of modules and the reading of files, which stay: to look for garbage among them takes a tenth
    of the start of a command. Nor do later collections look at them, or the end of the program."""
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


class Parser(argparse.ArgumentParser):
    """Prints errors in one line, and imports the module of a command when it is used."""

    #: name of the module that still has to add the arguments of its command; empty afterwards
    module = ""

    def __init__(self, **how: Any) -> None:
        super().__init__(formatter_class=_ANY_WIDTH, **how)

    def value(self, name: str, metavar: str | tuple[str, ...] | None, text: str, **how: Any) -> None:
        """Add an argument or option with a value; ``text`` is its help, ``how`` as ``add_argument`` has it."""
        self.add_argument(name, metavar=metavar, help=text, **how)

    def flag(self, name: str, text: str, **how: Any) -> None:
        """Add an option without a value; otherwise as :meth:`value`."""
        self.add_argument(name, action="store_true", help=text, **how)

    def run_by(self, execute: Callable[[argparse.Namespace], int], *, json: bool = True) -> None:
        """``execute`` runs the command; the last option is ``--json``."""
        if json:
            self.flag("--json", "print JSON lines")
        self.set_defaults(execute=execute)

    def load(self) -> None:
        """Let the module of the command add its arguments."""
        if self.module:
            with lasting():
                module = importlib.import_module(self.module)
            module.add_to(self)
            self.module = ""

    def format_help(self) -> str:
        """As wide as the terminal."""
        self.formatter_class = argparse.RawDescriptionHelpFormatter
        return super().format_help()

    def actions(self) -> list[argparse.Action]:
        """The arguments and options so far."""
        return list(self._actions)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Also called for the help of a command."""
        self.load()
        found, rest = super().parse_known_args(args, namespace)
        if rest and " " in self.prog:  # of a command: its own help says what it takes
            self.error(f"unrecognized arguments: {' '.join(rest)}")
        return found, rest

    def error(self, message: str) -> NoReturn:
        """One line on stderr, exit code 2."""
        self.exit(2, f"{self.prog}: {printable(message)}; see {self.prog} --help\n")

    def exit(self, status: int = 0, message: str | None = None) -> NoReturn:
        """The exit code of a help that nobody could read is 1, as that of a command."""
        super().exit(status or int(output.lost.error is not None), message)

    def _print_message(self, message: str, file: Any = None) -> None:
        text = "\n".join(map(printable, message.split("\n")))
        if file is sys.stdout:
            output.raw(text)
        else:
            super()._print_message(text, file)
