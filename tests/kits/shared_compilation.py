"""The processes of ``make test`` compile the test modules together.

Each process collects all tests, all in the same order: on a new checkout each would compile every module, 10 s of a
processor. So each begins at a place of its own, and leaves out what the others have compiled by then.
"""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import Final

import pytest

TESTS: Final = Path(__file__).resolve().parents[1]
#: fewer modules that are not compiled are no new checkout
_FEW: Final = 50


def share_compilation(config: pytest.Config) -> None:
    """Compile the modules that no process has compiled, if this is one of several that collect the whole folder."""
    place = getattr(config, "workerinput", {"workercount": 1})
    count = place["workercount"]
    if count < 2 or sys.dont_write_bytecode or [Path(name).resolve() for name in config.args] != [TESTS]:
        return
    try:  # inner names: without them each process compiles all
        from _pytest.assertion.rewrite import PYC_TAIL, _rewrite_test, _write_pyc, assertstate_key, get_cache_dir
    except ImportError:
        return
    made = {path: get_cache_dir(path) / f"{path.stem}{PYC_TAIL}" for path in sorted(TESTS.rglob("test_*.py"))}
    if sum(not compiled.exists() for compiled in made.values()) < _FEW:
        return
    paths = list(made)
    begin = int(place["workerid"].removeprefix("gw")) * len(paths) // count
    for path in paths[begin:] + paths[:begin]:
        if not made[path].exists():
            with contextlib.suppress(SyntaxError):  # pytest reports it
                made[path].parent.mkdir(exist_ok=True)
                source, code = _rewrite_test(path, config)
                _write_pyc(config.stash[assertstate_key], code, source, made[path])
