"""Commands run in the test's own process."""

from __future__ import annotations

import pytest

from dpstack.cli.main import main

#: what commands say on standard error that are the master themselves, on the port "virtual"
SIMULATED = (
    'dpstack: no run holds the port "virtual": its slaves are simulated for this command only; '
    "`dpstack run` with this configuration keeps them, and is asked then\n"
)


def acyclic(capsys: pytest.CaptureFixture[str], *args: str, code: int = 0) -> tuple[str, str]:
    """``dpstack acyclic ARGS``, which ends with ``code``: what it printed, and what it printed as errors.

    That the slaves are simulated is left out (``test_warning_of_simulated_slaves`` looks at that).
    """
    assert main(["acyclic", *args]) == code, capsys.readouterr()
    printed = capsys.readouterr()
    return printed.out, printed.err.replace(SIMULATED, "", 1)
