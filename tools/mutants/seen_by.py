"""Tests that execute a line: measured once with coverage.py, kept in a file outside of the repository."""

from __future__ import annotations

import hashlib
import os
import pickle
import re
import time
import traceback
from collections.abc import Generator, Iterable, Sequence
from dataclasses import dataclass, field
from difflib import SequenceMatcher
from functools import cache
from pathlib import Path
from typing import Any, Final

import pytest

from tools.mutants import trial
from tools.mutants.made import ROOT, Mutant

CACHE: Final = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "dpstack-mutants"


#: number of files of tests that are measured by one process
_TOGETHER: Final = 12


@dataclass(slots=True)
class SeenBy:
    """The map from lines to tests."""

    #: ids of the tests that passed, and the seconds of each (measured, so longer than without measuring)
    tests: list[str]
    seconds: list[float]
    #: file -> line -> set of tests, as the bits of a number
    lines: dict[str, dict[int, int]]
    #: file -> lines that are executed when tests are imported and collected
    imported: dict[str, set[int]]
    #: file of tests -> its digest
    files: dict[str, str] = field(default_factory=dict)
    #: file -> its lines when the map was made
    sources: dict[str, list[str]] = field(default_factory=dict)

    def keep(self, file: Path) -> None:
        """Write the map to ``file``."""
        self.sources = {path: _lines_of(path) for path in self.lines}
        part = file.with_suffix(f".{os.getpid()}")
        part.write_bytes(pickle.dumps(self))
        part.replace(file)

    def follow_sources(self) -> None:
        """Give the lines of files that changed the tests of the lines that stood there before."""
        for path, before in self.sources.items():
            now = _lines_of(path)
            if now == before:
                continue
            lines, imported = self.lines[path], self.imported.get(path, set())
            moved: dict[int, int] = {}
            at_import: set[int] = set()
            for tag, old, old_end, new, new_end in SequenceMatcher(None, before, now, False).get_opcodes():
                if tag == "equal":
                    moved.update({new + n + 1: lines.get(old + n + 1, 0) for n in range(old_end - old)})
                    at_import.update(new + n + 1 for n in range(old_end - old) if old + n + 1 in imported)
                else:  # a new line: the tests of the lines that it replaces, and of the line before
                    tests = 0
                    for line in range(old, old_end + 1):
                        tests |= lines.get(line, 0)
                    moved.update({line + 1: tests for line in range(new, new_end)})
            self.lines[path] = {line: bits for line, bits in moved.items() if bits or line in at_import}
            self.imported[path] = at_import

    def without(self, files: set[str]) -> SeenBy:
        """The map without the tests of ``files``."""
        stay = [number for number, test in enumerate(self.tests) if test.split("::")[0] not in files]
        place = {number: index for index, number in enumerate(stay)}
        lines = {
            path: {
                line: _bits(place[number] for number in _numbers(bits) if number in place) for line, bits in of.items()
            }
            for path, of in self.lines.items()
        }
        left = {file: digest for file, digest in self.files.items() if file not in files}
        tests, seconds = [self.tests[number] for number in stay], [self.seconds[number] for number in stay]
        return SeenBy(tests, seconds, lines, self.imported, left)

    def with_part(self, part: SeenBy) -> SeenBy:
        """The map with the tests of another one."""
        shift = len(self.tests)
        for path, lines in part.lines.items():
            mine = self.lines.setdefault(path, {})
            for line, bits in lines.items():
                mine[line] = mine.get(line, 0) | bits << shift
            self.imported.setdefault(path, set()).update(part.imported.get(path, ()))
        tests, seconds = [*self.tests, *part.tests], [*self.seconds, *part.seconds]
        return SeenBy(tests, seconds, self.lines, self.imported, self.files)

    def of_mutant(self, mutant: Mutant) -> list[int]:
        """The numbers of the tests that can notice ``mutant``: the room's own first, then the quickest first.

        Before them those of the whole room, in files that end in ``_texts.py`` or ``_stories.py``: they notice most
        mutants, and at once. A line in a function: the tests that execute it. Elsewhere: the tests that
        name what the statement defines, then those that execute a line which names it. Where nobody names it: the tests
        that name a value made of it, then those that execute anything of the file's functions.
        """
        place, found = mutant.place, 0
        lines = self.lines.get(mutant.path, {})
        for line in range(place.first, place.last + 1):
            found |= lines.get(line, 0)
        # texts, tables, defaults and transcripts of a whole room, held by tests that name none of them
        texts = self._that_match(rf"tests/{mutant.room}/.*_texts\.py::")
        stories = self._that_match(rf"tests/{mutant.room}/.*_stories\.py::")
        if place.function_line and found:
            return self._order((found & (texts | stories), found), mutant.room)
        name_it = 0
        if place.names:
            name = re.compile(rf"\b(?:{'|'.join(map(re.escape, place.names))})\b")
            for path, others in self.lines.items():
                text = _lines_of(path)
                for line, tests in others.items():
                    if line <= len(text) and name.search(text[line - 1]):
                        found |= tests
            name_it = self._that_name(place.names)
        if not found | name_it:
            name_it = self._that_name(place.through)
        if not found:
            for tests in lines.values():
                found |= tests
        return self._order((texts, name_it | stories, found), mutant.room)

    def _that_match(self, pattern: str) -> int:
        """The tests whose ids begin with ``pattern``."""
        wanted = re.compile(pattern)
        return _bits(number for number, test in enumerate(self.tests) if wanted.match(test))

    def _that_name(self, names: Sequence[str]) -> int:
        """The tests whose functions name one of ``names``."""
        name = re.compile(rf"\b(?:{'|'.join(map(re.escape, names))})\b")
        return _bits(number for number, test in enumerate(self.tests) if name.search(_source_of(test)))

    def runs_at_import(self, mutant: Mutant) -> bool:
        """Whether the mutant takes effect before the first test: its line is executed at import, or its function is.

        A function that was made inside of another one at import never gets the new code of that one.
        """
        place = mutant.place
        lines = self.imported.get(mutant.path, set())
        return not place.function_line or any(line in lines for line in range(place.body[0], place.body[1] + 1))

    def _order(self, groups: Sequence[int], room: str) -> list[int]:
        """The tests of each group, then those of the next one: the room's own first, then the quickest first."""
        own = f"tests/{room}/"

        def key(number: int) -> tuple[bool, float]:
            return not self.tests[number].startswith(own), self.seconds[number]

        found: dict[int, None] = {}
        for group in groups:
            found.update(dict.fromkeys(sorted(_numbers(group), key=key)))
        return list(found)


class _Measuring:
    """pytest plugin: a context of coverage.py for each test, its time and its outcome."""

    def __init__(self, coverage: Any) -> None:
        self.coverage = coverage
        self.seconds: dict[str, float] = {}
        self.failed: set[str] = set()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        self.coverage.switch_context(item.nodeid)
        began = time.process_time()
        result = yield
        self.seconds[item.nodeid] = time.process_time() - began
        self.coverage.switch_context("")
        return result

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if not report.passed:
            self.failed.add(report.nodeid)


def measure(arguments: Sequence[str]) -> SeenBy:
    """Run the tests under coverage.py. The process has imported nothing of dpstack before."""
    import coverage

    CACHE.mkdir(parents=True, exist_ok=True)
    data_file = CACHE / f"contexts-{os.getpid()}"
    measured = coverage.Coverage(data_file=str(data_file), include=[f"{ROOT}/dpstack/*"], config_file=False)
    plugin = _Measuring(measured)
    measured.start()
    pytest.main([*arguments, *trial.OPTIONS], plugins=[plugin])
    measured.stop()
    data = measured.get_data()
    tests = [test for test in plugin.seconds if test not in plugin.failed]
    number = {test: index for index, test in enumerate(tests)}
    lines: dict[str, dict[int, int]] = {}
    imported: dict[str, set[int]] = {}
    for file in data.measured_files():
        path = str(Path(file).relative_to(ROOT))
        of_file, at_import = lines.setdefault(path, {}), imported.setdefault(path, set())
        for line, contexts in data.contexts_by_lineno(file).items():
            if "" in contexts:
                at_import.add(line)
            of_file[line] = _bits(number[test] for test in contexts if test in number)
    data_file.unlink(missing_ok=True)
    return SeenBy(tests, [plugin.seconds[test] for test in tests], lines, imported)


def _lines_of(path: str) -> list[str]:
    file = ROOT / path
    return file.read_text(encoding="utf-8").splitlines() if file.exists() else []


@cache
def _functions_of(path: str) -> dict[str, str]:
    """The functions of a file of tests, with the decorators before them."""
    parts = re.split(r"^(?=@|(?:async )?def |class |    (?:@|(?:async )?def ))", "\n".join(_lines_of(path)), flags=re.M)
    found: dict[str, str] = {}
    before = ""
    for part in parts:
        named = re.match(r" *(?:async )?def (\w+)", part)
        if named:
            found[named[1]] = before + part
        before = before + part if part.lstrip().startswith("@") else ""
    return found


def _source_of(test: str) -> str:
    """The source of the test with this id."""
    path, _, name = test.partition("::")
    return _functions_of(path).get(name.split("::")[-1].split("[")[0], "")


def _numbers(bits: int) -> list[int]:
    return [index for index, bit in enumerate(reversed(f"{bits:b}")) if bit == "1"]


def _bits(numbers: Iterable[int]) -> int:
    octets = bytearray()
    for number in numbers:
        octets.extend(bytes(max(0, (number >> 3) + 1 - len(octets))))
        octets[number >> 3] |= 1 << (number & 7)
    return int.from_bytes(octets, "little")


def load(selection: Sequence[str], options: Sequence[str], *, anew: bool) -> SeenBy:
    """The map of the present sources and tests.

    Made once for each checkout (another checkout's newest one is a beginning). Files of tests that changed since are
    measured again; sources that changed keep the tests of the lines that stayed. ``anew``: measure everything.
    """
    CACHE.mkdir(parents=True, exist_ok=True)
    kept = CACHE / f"seen-by-{hashlib.sha256(str(ROOT).encode()).hexdigest()[:8]}.pickle"
    others = sorted(CACHE.glob("seen-by-*.pickle"), key=lambda path: path.stat().st_mtime)
    source = kept if kept.exists() else others[-1] if others else None
    seen: SeenBy | None = pickle.loads(source.read_bytes()) if source and not anew else None
    files = {
        str(file.relative_to(ROOT)): hashlib.sha256(file.read_bytes()).hexdigest()
        for path in selection
        for file in ([ROOT / path] if path.endswith(".py") else sorted((ROOT / path).rglob("test_*.py")))
    }
    if seen is None:
        seen = SeenBy([], [], {}, {})
    seen.follow_sources()
    changed = [file for file, digest in files.items() if seen.files.get(file) != digest]
    gone = {file for file in seen.files if not (ROOT / file).exists()}
    seen = seen.without(gone | set(changed))
    for at in range(0, len(changed), _TOGETHER):
        some = changed[at : at + _TOGETHER]
        print(f"measuring which lines the tests execute: {at} of {len(changed)} files", flush=True)
        seen = seen.with_part(_measured_apart([*options, *some]))
        seen.files |= {file: files[file] for file in some}
        seen.keep(kept)  # a run that is stopped goes on here
    seen.keep(kept)
    return seen


def _measured_apart(arguments: Sequence[str]) -> SeenBy:
    """Measure in a process of its own."""
    reader, writer = os.pipe()
    child = os.fork()
    if not child:
        code = 1
        try:
            os.close(reader)
            with os.fdopen(writer, "wb") as file:
                pickle.dump(measure(arguments), file)
            code = 0
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)
    os.close(writer)
    with os.fdopen(reader, "rb") as file:
        octets = file.read()
    if os.waitpid(child, 0)[1]:
        raise SystemExit("the tests could not be measured")
    part: SeenBy = pickle.loads(octets)
    return part
