"""Frame of the fuzzing: a target, how it is found, run once, and fed by mutation where atheris is not installed.

A target is a module of ``tests/fuzz/targets``: its file name is the target's name, its ``TARGET`` the :class:`Target`.
Such a module imports the product at its top. This module does not, so that ``tools.fuzz`` can count the coverage.
``tests/fuzz/corpus/TARGET`` holds inputs to begin with, each below 1 kB.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import random
import time
import traceback
import zlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, TypeVar

T = TypeVar("T")
HERE: Final = Path(__file__).resolve().parent
CORPUS: Final = HERE / "corpus"
#: most octets of an input, where the target says nothing else
MAX_LEN: Final = 300
#: an input that takes longer than this, in seconds of the processor, is a find, where the target says nothing else
SLOW_S: Final = 1.0
#: of ten mutations so many are repaired
_REPAIRED_OF_TEN: Final = 8
#: distinct finds that one run keeps
MOST_FINDS: Final = 20


@dataclass(frozen=True)
class Target:
    """One target.

    ``run``: judges one input; an exception is a find, unless it is one of ``allowed`` (the product's own errors only).
    ``covers``: packages and modules of the product, for instance ``dpstack.gsd``, whose coverage counts.
    ``executions``: at least so many are due for a figure. ``max_len``: most octets of an input. ``repair``: gives a
    mutated input the right FCS, LE and the like, so that it gets deeper; two of ten mutations are left as they are.
    ``words``: octets that mutations insert. ``slow_s``: seconds of the processor, of which no input may take more.
    ``compares``: atheris also follows comparisons, which finds constants of a format but takes up to a third more time.
    """

    run: Callable[[bytes], object]
    covers: tuple[str, ...]
    executions: int = 1_000_000
    max_len: int = MAX_LEN
    allowed: tuple[type[Exception], ...] = ()
    repair: Callable[[bytes], bytes] | None = None
    words: tuple[bytes, ...] = ()
    slow_s: float = SLOW_S
    compares: bool = True

    def once(self, octets: bytes) -> None:
        """Judge one input. Raises what the product must not raise, and :class:`TooSlowError`."""
        begun = time.monotonic()
        with contextlib.suppress(*self.allowed):
            self.run(octets)
        if time.monotonic() - begun <= self.slow_s:
            return
        # once more: to ask for the time of the processor takes longer than many an input
        spent = time.process_time()
        with contextlib.suppress(*self.allowed):
            self.run(octets)
        took = time.process_time() - spent
        if took > self.slow_s:
            raise TooSlowError(
                f"{took:.1f} s of the processor for {len(octets)} octets, at most {self.slow_s:g} s are allowed"
            )

    def mended(self, octets: bytes, chance: random.Random) -> bytes:
        """A mutated input, mostly repaired, no longer than ``max_len``."""
        if self.repair is not None and chance.randrange(10) < _REPAIRED_OF_TEN:
            octets = self.repair(octets)
        return octets[: self.max_len]


class TooSlowError(AssertionError):
    """An input that takes too long."""


def names() -> list[str]:
    """The targets that are there."""
    return sorted(path.stem for path in (HERE / "targets").glob("*.py") if path.stem != "__init__")


def load(name: str) -> Target:
    """Import the target ``name``. Raises LookupError where there is none."""
    if name not in names():
        raise LookupError(f"there is no target {name!r}; there are: {', '.join(names())}")
    target = importlib.import_module(f"tests.fuzz.targets.{name}").TARGET
    assert isinstance(target, Target)
    return target


def corpus(name: str) -> list[Path]:
    """The files of the target's corpus, by name."""
    return sorted(path for path in (CORPUS / name).glob("*") if path.is_file())


def words(name: str) -> tuple[bytes, ...]:
    """The lines of ``tests/fuzz/words/NAME.txt``, each with its line feed."""
    return tuple((HERE / "words" / f"{name}.txt").read_bytes().splitlines(keepends=True))


@dataclass
class Finds:
    """Writes each distinct find into a file of ``folder``: its name has the target and the exception."""

    name: str
    folder: Path
    files: list[Path] = field(default_factory=list)
    _seen: set[tuple[str, str, int]] = field(default_factory=set)

    def add(self, octets: bytes, error: BaseException) -> Path | None:
        """The file of a find that is new: another exception, or one raised at another place. None for known ones."""
        last = traceback.extract_tb(error.__traceback__)[-1]
        where = (type(error).__name__, last.filename, last.lineno or 0)
        if where in self._seen or len(self.files) >= MOST_FINDS:
            return None
        self._seen.add(where)
        digest = hashlib.sha1(octets, usedforsecurity=False).hexdigest()[:10]
        path = self.folder / f"{self.name}-{type(error).__name__}-{digest}"
        self.folder.mkdir(parents=True, exist_ok=True)
        path.write_bytes(octets)
        self.files.append(path)
        return path


def judged(target: Target, finds: Finds) -> Callable[[bytes], None]:
    """``target`` as a function that writes its finds instead of raising them, each with its traceback on stdout."""

    def judge(octets: bytes) -> None:
        try:
            target.once(octets)
        except Exception as error:
            if (path := finds.add(octets, error)) is not None:
                text = "".join(traceback.format_exception(error))
                print(f"find {path}\n{text.encode('ascii', 'backslashreplace').decode()}", flush=True)

    return judge


# --- mutation by hand ------------------------------------------------------------------------------------------------
@dataclass
class Report:
    """Result of one run; ``edges`` and ``grown_at`` are None where coverage was not counted.

    ``executions``; ``seconds`` of the clock; ``grown_at``: the execution that added the last edge.
    """

    executions: int
    seconds: float
    edges: int | None = None
    grown_at: int | None = None


def by_hand(
    target: Target, finds: Finds, seeds: Iterable[bytes], *, executions: int, seconds: float, seed: int
) -> Report:
    """Feed mutations of ``seeds`` to ``target`` until ``executions`` or ``seconds`` of the clock are over."""
    judge = judged(target, finds)
    chance = random.Random(seed)
    kept = list(seeds) or [b""]
    begun = time.monotonic()
    done = 0
    for octets in kept:
        judge(octets)
        done += 1
    while done < executions and (done % 64 or time.monotonic() - begun < seconds):
        judge(target.mended(mutated(chance.choice(kept), kept, target.words, chance), chance))
        done += 1
    return Report(done, time.monotonic() - begun)


def mutated(octets: bytes, others: list[bytes], words: tuple[bytes, ...], chance: random.Random) -> bytes:
    """``octets`` with one to six changes: octets changed, cut, doubled and inserted, words, and parts of ``others``."""
    out = bytearray(octets)
    for _ in range(chance.choice((1, 1, 1, 2, 3, 6))):
        _change(out, others, words, chance)
    return bytes(out)


def _change(out: bytearray, others: list[bytes], words: tuple[bytes, ...], chance: random.Random) -> None:
    at = chance.randrange(len(out) + 1)
    stop = min(len(out), at + chance.choice((1, 1, 2, 4, 16, 64)))
    kind = chance.randrange(8)
    if kind == 0 and at < len(out):
        out[at] ^= 1 << chance.randrange(8)
    elif kind == 1 and at < len(out):
        out[at] = chance.choice(
            (0, 1, 0x7F, 0x80, 0xFF, chance.randrange(256), (out[at] + 1) & 0xFF, (out[at] - 1) & 0xFF)
        )
    elif kind == 2:
        del out[at:stop]
    elif kind == 3:
        out[at:at] = out[at:stop] * chance.choice((1, 1, 2, 8))
    elif kind == 4:
        out[at:at] = chance.randbytes(stop - at or 1)
    elif kind == 5 and words:
        out[at : at + chance.choice((0, 1, len(out)))] = chance.choice(words)
    elif kind == 6:
        other = chance.choice(others)
        begin = chance.randrange(len(other) + 1)
        out[at:stop] = other[begin : begin + chance.choice((1, 4, 16, 64, 256))]
    else:
        del out[at:]


# --- helpers of targets ----------------------------------------------------------------------------------------------
def assert_plain(text: str, *, lines: bool = False) -> None:
    """Raise AssertionError where ``text`` has a character that no terminal must get; ``lines``: also several lines."""
    for line in text.split("\n") if lines else (text,):
        if not line.isprintable():
            bad = [letter for letter in line if not (letter.isprintable() or letter in "\u00a0\u3000")]
            assert not bad, f"{bad[0]!r} in {line!r}"


def parsed(parse: Callable[[bytes], T], octets: bytes, *allowed: type[Exception]) -> T | None:
    """The result of ``parse``; None where it raises one of ``allowed``, whose text has to be plain and one line."""
    try:
        return parse(octets)
    except allowed as error:
        assert_plain(str(error))
        return None


def one_in(many: int, octets: bytes) -> bool:
    """Whether the input belongs to the share of one in ``many`` that gets a check that takes long."""
    return zlib.crc32(octets) % many == 0


class Cutter:
    """Takes values off the begin of an input; behind its end they are 0 and empty."""

    def __init__(self, octets: bytes) -> None:
        self.octets = octets
        self.at = 0

    def octet(self) -> int:
        """The next octet, 0 at the end."""
        self.at += 1
        return self.octets[self.at - 1] if self.at <= len(self.octets) else 0

    def word(self) -> int:
        """The next two octets, high octet first."""
        return self.octet() << 8 | self.octet()

    def take(self, count: int) -> bytes:
        """At most ``count`` octets."""
        self.at += count
        return self.octets[self.at - count : self.at]

    def rest(self) -> bytes:
        """All octets that are left."""
        return self.take(max(0, len(self.octets) - self.at))

    def pieces(self) -> Iterator[bytes]:
        """Pieces until the end, each behind an octet that says how long it is."""
        while self.at < len(self.octets):
            yield self.take(self.octet())
