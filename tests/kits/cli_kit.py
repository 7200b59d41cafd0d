"""Commands run in the test's own process."""

from __future__ import annotations

import json
from typing import Any

import pytest

from dpstack.cli.main import main

#: what commands say on standard error that are the master themselves, on the port "virtual"
SIMULATED = (
    'dpstack: no run on "virtual" has this configuration: its slaves are simulated for this command only; '
    "`dpstack run` with this configuration keeps them, and is asked then\n"
)


class Cli:
    """``dpstack ARGS`` in the test's own process (the fixture ``cli``); it must end with the exit code ``code``."""

    def __init__(self, capsys: pytest.CaptureFixture[str], *prefix: str) -> None:
        self._capsys = capsys
        self._prefix = prefix

    def of(self, *prefix: str) -> Cli:
        """For one command, whose arguments begin with ``prefix``; that the slaves are simulated is left out.

        (``test_warning_of_simulated_slaves`` looks at that.)
        """
        return Cli(self._capsys, *prefix)

    def __call__(self, *args: str, code: int = 0) -> tuple[str, str]:
        """Standard output and standard error, also where argparse ends the program."""
        try:
            ended: object = main([*self._prefix, *args])
        except SystemExit as end:
            ended = end.code
        printed = self._capsys.readouterr()
        assert ended == code, printed
        return printed.out, printed.err.replace(SIMULATED, "", 1) if self._prefix else printed.err

    def out(self, *args: str, code: int = 0) -> str:
        return self(*args, code=code)[0]

    def err(self, *args: str, code: int = 2) -> str:
        return self(*args, code=code)[1]

    def json(self, *args: str, code: int = 0) -> Any:
        """The last line of the output with ``--json``."""
        return self.jsons(*args, code=code)[-1]

    def jsons(self, *args: str, code: int = 0) -> list[Any]:
        return [json.loads(line) for line in self.out(*args, "--json", code=code).splitlines()]
