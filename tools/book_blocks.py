"""Plugin for pytest: the Python blocks and the commands of the book run.

``python -m pytest -p tools.book_blocks README.md docs``. The blocks of a page run in their order, in a folder of the
page's own (:class:`tools.book_commands.Stage`; that module tells how commands run and which marks they have).

A ``python`` block is a program of its own: its names are gone afterwards. It runs in virtual time (``asyncio.run`` is
``dpstack.run_virtual``), and ``await`` may stand at the top of a block. Comments around a block say more, and no viewer
of the page shows them:

- ``<!-- invisible-code-block: python``, lines of Python, ``-->``: these run first. The block below them has their
  names, an open bus for instance
- ``<!-- invisible-code-block: python after``, lines of Python, ``-->`` below a block: these run last
- ``<!-- file: NAME -->``: the block is also a file of the page's folder
- ``<!-- readers -->``: the block runs elsewhere, with packages of others
  (``tests/strangers/test_recordings_in_readers.py``)
- ``<!-- tests: FOLDER -->``: the block is a module of tests, which pytest runs beside the files of ``FOLDER``

A program that prints has a ``text`` block right below it: marked ``<!-- output -->`` it is the output to the last
character, marked ``<!-- printed -->`` as behind commands.
"""

from __future__ import annotations

import ast
import contextlib
import inspect
import io
import logging
import os
import re
import shutil
import subprocess
import sys
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from sybil import Example, Sybil
from sybil.parsers.myst import CodeBlockParser

import dpstack
from tools.book_commands import ROOT, Stage, missing_line, run_commands, virtual_time

_MARK: Final = re.compile(r"<!-- ([a-z]+)(?:: ([^>]*?))? -->\n\Z")
_SHOWN: Final = re.compile(r"\A(?:```)?\s*<!-- (output|printed) -->\n```\w+\n(.*?)^```", re.DOTALL | re.MULTILINE)
#: right above a block; sybil gives it as an example of its own, which then has nothing to do
_BEFORE: Final = re.compile(r"<!-- invisible-code-block: python\n((?:(?!-->).)*)-->\n\Z", re.DOTALL)
_AFTER: Final = re.compile(r"\A(?:```)?\s*<!-- invisible-code-block: python after\n((?:(?!-->).)*)-->", re.DOTALL)


def run_python(example: Example) -> None:
    """A visible block, with the invisible lines around it."""
    text, stage = example.document.text, example.namespace["stage"]
    if text.startswith("<!--", example.start):
        return
    stage.write_files(text)
    above = text[: example.start]
    mark = _MARK.search(above)
    if mark and mark[1] == "readers":
        return
    if mark and mark[1] == "tests":
        stage.close_programs()
        run_tests(example.parsed, ROOT / mark[2], stage.folder)
        return
    if mark:
        above = above[: mark.start()]
    before, after = _BEFORE.search(above), _AFTER.match(text[example.end :])
    parts = [(before[1], _line(text, before.start(1)))] if before else []
    parts.append((example.parsed, example.line + 1))
    if after:
        parts.append((after[1], _line(text, example.end + after.start(1))))
    output = run_program(parts, example.path)
    shown = _SHOWN.match(text[example.end :])
    if shown is None:
        assert output == "", f"no block below says that the program prints:\n{output}"
    elif shown[1] == "output":
        assert output == shown[2]
    else:
        assert missing_line(shown[2], output) is None, f"{missing_line(shown[2], output)!r} is not in:\n{output}"


def _line(text: str, position: int) -> int:
    return text.count("\n", 0, position) + 1


def run_program(parts: list[tuple[str, int]], path: str) -> str:
    """Run sources, each with its first line in ``path``, as one program in virtual time; its output."""
    body: list[ast.stmt] = []
    for source, line in parts:
        body += ast.parse("\n" * (line - 1) + source, path).body
    code = compile(ast.Module(body, []), path, "exec", ast.PyCF_ALLOW_TOP_LEVEL_AWAIT, dont_inherit=True)
    main = types.ModuleType("__main__")
    output = io.StringIO()
    before = sys.modules["__main__"]
    sys.modules["__main__"] = main
    try:
        with (
            contextlib.redirect_stdout(output),
            contextlib.redirect_stderr(output),
            logging_as_before(),
            virtual_time(),
        ):
            running = eval(code, main.__dict__)
            if inspect.iscoroutine(running):
                dpstack.run_virtual(running)
    finally:
        sys.modules["__main__"] = before
    return output.getvalue()


def run_tests(source: str, beside: Path, folder: Path) -> None:
    """Run a module of tests in a copy of ``beside`` that has no other tests."""
    place = folder / "tests"
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(beside, place, ignore=shutil.ignore_patterns("test_*", "__pycache__"))
    (place / "test_page.py").write_text(source, encoding="utf-8")
    without = [word for name in ("cacheprovider", "asyncio", "anyio") for word in ("-p", f"no:{name}")]
    command = [sys.executable, "-m", "pytest", "-q", *without, "-W", "error", "--rootdir", str(place), str(place)]
    path = os.pathsep.join([str(place), str(ROOT / "drives"), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(command, cwd=place, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@contextlib.contextmanager
def logging_as_before() -> Iterator[None]:
    """Put levels and handlers back that a program sets for itself."""
    before = {one.name: (one.level, list(one.handlers)) for one in _loggers()}
    yield
    for one in _loggers():
        level, one.handlers[:] = before.get(one.name, (logging.NOTSET, []))
        one.setLevel(level)


def _loggers() -> list[logging.Logger]:
    known = [one for one in logging.Logger.manager.loggerDict.values() if isinstance(one, logging.Logger)]
    return [logging.getLogger(), *(one for one in known if one.name.startswith("dpstack"))]


def _set_up(namespace: dict[str, Any]) -> None:
    namespace["stage"] = Stage()


def _tear_down(namespace: dict[str, Any]) -> None:
    namespace["stage"].close()


pytest_collect_file = Sybil(
    parsers=[
        CodeBlockParser(language="console", evaluator=run_commands),
        CodeBlockParser(language="python", evaluator=run_python),
    ],
    pattern="*.md",
    excludes=["docs/reference/options.md"],  # examples of --help, with files that are not there
    path=str(ROOT),
    setup=_set_up,
    teardown=_tear_down,
).pytest()
