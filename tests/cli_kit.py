"""Commands run in the test's own process."""

from __future__ import annotations

import pytest

from dpstack.cli.main import main


def acyclic(capsys: pytest.CaptureFixture[str], *args: str, code: int = 0) -> tuple[str, str]:
    """``dpstack acyclic ARGS``, which ends with ``code``: what it printed, and what it printed as errors."""
    assert main(["acyclic", *args]) == code, capsys.readouterr()
    printed = capsys.readouterr()
    return printed.out, printed.err
