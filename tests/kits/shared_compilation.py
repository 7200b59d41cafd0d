"""The processes of ``make test`` compile the test modules together.

Each process collects all tests, all in the same order: on a new checkout each would compile every module, 15 s of a
processor. So each begins at a place of its own, and finds what the others have compiled by then.
"""

from __future__ import annotations

import contextlib
import importlib
import sys
from pathlib import Path
from typing import Final

import pytest

TESTS: Final = Path(__file__).resolve().parents[1]
#: fewer modules that are not compiled are no new checkout
_FEW: Final = 50


def share_compilation(config: pytest.Config) -> None:
    """Import the modules that no process has compiled, if this is one of several that collect the whole folder."""
    place = getattr(config, "workerinput", {})
    count = place.get("workercount", 1)
    if count < 2 or [Path(name) for name in config.args] not in ([Path("tests")], [TESTS]):
        return
    paths = sorted(TESTS.rglob("test_*.py"))
    if sum(not is_compiled(path) for path in paths) < _FEW:
        return
    begin = int(place["workerid"].removeprefix("gw")) * len(paths) // count
    for path in paths[begin:] + paths[:begin]:
        if not is_compiled(path):
            if str(path.parent) not in sys.path:  # as pytest finds the module
                sys.path.insert(0, str(path.parent))
            with contextlib.suppress(Exception, pytest.skip.Exception):  # pytest imports it again, and reports that
                importlib.import_module(path.stem)


def is_compiled(path: Path) -> bool:
    """Whether pytest has compiled a module, in this state or in an earlier one."""
    return any((path.parent / "__pycache__").glob(f"{path.stem}.*-pytest-*.pyc"))
