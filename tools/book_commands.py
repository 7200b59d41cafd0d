"""The commands of the book run: the marks of a ``console`` block, and the folder in which the blocks of a page run.

The blocks of a page run in their order, in a folder of the page's own. The folder has examples/, the plant of the
tutorial, and the files that the page gives a name. A command ends with exit code 0; one that goes on until Ctrl-C has
to start, and to be there still at the end of the page, or until another `run` takes its port. ``--seconds`` is 1 where
time is real. /dev/ttyUSB0 is the middle port of a simulated segment, and /dev/far0 and /dev/far1 are the ports beside
it. /tmp/bus is in the folder too.

A comment above a block says more:

- ``<!-- beside: COMMAND; COMMAND -->``: programs that are started before the block
- ``<!-- parsed: REASON -->``: the commands are parsed (tests/test_docs.py), not run;
  docs/development/book.md lists them

A ``text`` block right below it, marked ``<!-- printed -->``, is what its commands print: each line of the block is in
their output, in this order. Any number stands for any other, ``...`` alone for lines, and at the end of a line for its
rest.
"""

from __future__ import annotations

import asyncio
import contextlib
import io
import os
import re
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import dpstack
from dpstack.api.config.config import load_config
from dpstack.api.control.socket_path import Sockets
from dpstack.cli.main import main

if TYPE_CHECKING:
    from sybil import Example  # not needed by what only lists the commands

ROOT: Final = Path(__file__).resolve().parent.parent
FIRST_PLANT: Final = ROOT / "docs" / "tutorial" / "first-plant.md"
_MARK: Final = re.compile(r"<!-- ([a-z]+): ([^>]*?) -->\n$")
_FILE: Final = re.compile(r"<!-- file: (\S+) -->\n```\w+\n(.*?)^```", re.DOTALL | re.MULTILINE)
_PRINTED: Final = re.compile(r"\A(?:```)?\s*<!-- printed -->\n```\w+\n(.*?)^```", re.DOTALL | re.MULTILINE)
#: ports of the simulated segment of a page
_PORTS: Final = ("far0", "ttyUSB0", "far1")
_HANG_S: Final = 60.0
#: commands that go on until Ctrl-C, unless an option limits them
_ENDLESS: Final = {"segment", "sim", "run", "web", "capture", "monitor"}
_LIMITS: Final = {"--seconds", "--rotations"}


def commands(block: str) -> list[str]:
    """The commands of a block: lines that end with a backslash joined, without the prompt."""
    return [line.removeprefix("$ ") for line in re.sub(r" *\\\n *", " ", block).splitlines()]


class Program:
    """A ``dpstack`` that goes on until Ctrl-C."""

    def __init__(self, words: list[str], folder: Path) -> None:
        self.words = words
        self._log = folder / f"program{len(list(folder.glob('program*')))}"
        with self._log.open("wb") as log:
            command = [sys.executable, "-m", "dpstack.cli.main", *words]
            self._process = subprocess.Popen(command, cwd=folder, stdout=log, stderr=log)

    def wait_until(self, there: Any) -> None:
        end = time.monotonic() + _HANG_S
        while not there():
            assert self._process.poll() is None, f"{self}: {self.output}"
            assert time.monotonic() < end, f"{self} did not begin: {self.output}"
            time.sleep(0.02)

    @property
    def output(self) -> str:
        return self._log.read_text(encoding="utf-8", errors="replace")

    def end(self) -> None:
        assert self._process.poll() is None, f"{self} has ended by itself: {self.output}"
        self._process.send_signal(signal.SIGINT)
        assert self._process.wait(_HANG_S) in (0, 130), f"{self}: {self.output}"

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()

    def __str__(self) -> str:
        return shlex.join(["dpstack", *self.words])


class Stage:
    """The folder of a page, and the programs that its commands have started."""

    def __init__(self) -> None:
        self._temporary = tempfile.TemporaryDirectory(prefix="book")
        self.folder = Path(self._temporary.name)
        self._before = Path.cwd(), os.environ.get("XDG_RUNTIME_DIR")
        self._programs: list[Program] = []
        sockets = self.folder / "sockets"
        sockets.mkdir(mode=0o700)
        os.environ["XDG_RUNTIME_DIR"] = str(sockets)
        (self.folder / "examples").symlink_to(ROOT / "examples")
        self.write_files(FIRST_PLANT.read_text(encoding="utf-8"))
        os.chdir(self.folder)

    def write_files(self, text: str) -> None:
        files = _FILE.findall(text)
        assert len({name for name, _ in files}) == len(files), f"two files of one name: {[name for name, _ in files]}"
        for name, content in files:
            (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
            (self.folder / name).write_text(self._own_paths(content), encoding="utf-8")

    def start(self, words: list[str]) -> None:
        """A program that goes on; one that holds its port, or a web server, ends before."""
        before = self._sockets()
        program = Program(words, self.folder)
        self._programs.append(program)
        if words[0] == "segment":
            folder = Path(words[words.index("--dir") + 1])
            program.wait_until(lambda: (folder / "0").exists() and self._sockets() - before)
        elif words[0] in ("run", "sim"):
            program.wait_until(lambda: self._sockets() - before)
            with Sockets(make=True) as sockets, sockets.locked():  # it holds the lock until it has all its names
                pass
            if words[0] == "run":
                slaves = len(load_config(words[1]).slaves)
                program.wait_until(lambda: program.output.count(": data_exchange") >= slaves)
        else:
            program.wait_until(lambda: program.output)
            self._programs.remove(program)
            program.end()

    def _sockets(self) -> set[Path]:
        return set((self.folder / "sockets").rglob("*.sock"))

    def line(self, line: str) -> None:
        """One command of the book or of a mark."""
        if "/dev/" in line and not (self.folder / "usb").exists():
            self.start(["segment", "--stations", "3", "--dir", str(self.folder / "usb")])
        line, _, target = line.partition(" > ")
        program, *words = shlex.split(self._own_paths(line), comments=True)
        assert program == "dpstack", f"{line}: mark the block with <!-- parsed: REASON --> if this cannot run in a test"
        port = words[words.index("--port") + 1] if "--port" in words else None
        for one in [other for other in self._programs if other.words[0] in ("run", "sim")]:
            if port in one.words if port else words[:2] == one.words[:2]:
                self._programs.remove(one)
                one.end()
        if "--web" in words or words[0] == "web":
            self.start([*words, "--listen", "127.0.0.1:0"])
        elif words[0] in _ENDLESS and not _LIMITS & set(words) and not _reads_a_file(words):
            self.start(words)
        else:
            if self._programs and "--seconds" in words:  # in real time
                words[words.index("--seconds") + 1] = "1"
            with contextlib.ExitStack() as around:
                if target:
                    around.enter_context(contextlib.redirect_stdout(around.enter_context(Path(target).open("w"))))
                if not self._programs and not _reads_a_file(words):  # a file is written by a thread
                    around.enter_context(virtual_time())
                assert _exit_code(words) == 0, line

    def _own_paths(self, text: str) -> str:
        """``text`` of the book with the paths of this folder."""
        for number, name in enumerate(_PORTS):
            text = text.replace(f"/dev/{name}", f"{self.folder}/usb/{number}")
        return text.replace("/tmp/bus", f"{self.folder}/bus")

    def book_paths(self, output: str) -> str:
        """``output`` with the paths that the book has."""
        for number, name in enumerate(_PORTS):
            output = output.replace(f"{self.folder}/usb/{number}", f"/dev/{name}")
        return output.replace(f"{self.folder}/bus", "/tmp/bus")

    def close_programs(self) -> None:
        while self._programs:
            self._programs[-1].end()
            self._programs.pop()

    def close(self) -> None:
        """Ends everything; the first program that has not gone on fails the page."""
        try:
            self.close_programs()
        finally:
            for program in self._programs:
                program.kill()
            os.chdir(self._before[0])
            os.environ.pop("XDG_RUNTIME_DIR")
            if self._before[1] is not None:
                os.environ["XDG_RUNTIME_DIR"] = self._before[1]
            self._temporary.cleanup()


def _reads_a_file(words: list[str]) -> bool:
    return any(word.endswith((".pcapng", ".sr")) for word in words if words[words.index(word) - 1] != "--write")


def _exit_code(words: list[str]) -> object:
    try:
        return main(words)
    except SystemExit as end:  # --version, --help
        return end.code


@contextlib.contextmanager
def virtual_time() -> Iterator[None]:
    real = asyncio.run
    asyncio.run = dpstack.run_virtual  # type: ignore[assignment]
    try:
        yield
    finally:
        asyncio.run = real


def run_commands(example: Example) -> None:
    stage: Stage = example.namespace["stage"]
    stage.write_files(example.document.text)
    mark = _MARK.search(example.document.text[: example.start])
    kind, text = (mark[1], mark[2]) if mark else ("", "")
    if kind == "parsed":
        return
    for line in text.split("; ") if kind == "beside" else []:
        stage.line(line)
    output = io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
        try:
            for line in commands(example.parsed):
                stage.line(line)
        except AssertionError as error:
            error.add_note(stage.book_paths(output.getvalue()))
            raise
    printed = _PRINTED.match(example.document.text[example.end :])
    if printed:
        said = stage.book_paths(output.getvalue())
        assert missing_line(printed[1], said) is None, f"{missing_line(printed[1], said)!r} is not in:\n{said}"


def _shape(line: str) -> str:
    """``line`` without the width of its columns, and with one number for all."""
    return re.sub(r"\d+(?:\.\d+)?", "0", " ".join(line.split()))


def missing_line(wanted: str, output: str) -> str | None:
    """The first line of ``wanted`` that does not follow the ones before it in ``output``."""
    rest = iter([_shape(line) for line in output.splitlines()])
    for line in wanted.splitlines():
        shape = _shape(line)
        begin = shape.removesuffix("...")
        if begin and not any(one.startswith(begin) if begin != shape else one == shape for one in rest):
            return line
    return None
