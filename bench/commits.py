"""Environments of commits: the files of a commit, or of the working tree, with a virtual environment of their own.

Both lie in the user's cache folder: a commit for good, the working tree as a copy that is made anew each time, so that
it may be edited while it is measured. The folder may be removed at any time.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import io
import os
import platform
import shutil
import subprocess
import sys
import tarfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

_ROOT: Final = Path(__file__).resolve().parent.parent
#: written when an environment is complete, with the packages that benchmarks need; holds what it was made from
_MARK: Final = "installed-bench-pytest"
_INSTALL_S: Final = 600
_TOLD: Final = 400


@dataclass(frozen=True, slots=True)
class Side:
    """One of the two that are compared: its files, and the interpreter of its environment."""

    title: str
    root: Path
    python: Path


def cache_folder() -> Path:
    """Where environments are kept: ``dpstack-bench`` in the user's cache folder (XDG_CACHE_HOME)."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "dpstack-bench"


def full_name(commit: str) -> str:
    """The whole number of a commit. Raises ValueError when there is none, RuntimeError without git."""
    words = ("rev-parse", "--verify", "--quiet", "--end-of-options", f"{commit}^{{commit}}")
    try:
        return _git(*words).decode().strip()
    except _GitError:
        _git("rev-parse", "--git-dir")  # says so where this is no checkout
        raise ValueError(f"no commit {commit!r} in this repository") from None


@contextlib.contextmanager
def commit_side(commit: str) -> Iterator[Side]:
    """The environment of a commit. Raises ValueError for an unknown one, RuntimeError when it cannot be made."""
    number = full_name(commit)
    with _environment(number[:12], lambda tree: _extract(number, tree), renew=False) as (tree, python):
        yield Side(number[:12], tree, python)


@contextlib.contextmanager
def tree_side() -> Iterator[Side]:
    """The environment of the working tree as it stands, untracked files included. Raises RuntimeError."""
    name = "tree-" + hashlib.sha256(str(_ROOT).encode()).hexdigest()[:12]
    with _environment(name, _copy, renew=True) as (tree, python):
        yield Side("the tree as it stands", tree, python)


@contextlib.contextmanager
def _environment(name: str, fill: Callable[[Path], None], *, renew: bool) -> Iterator[tuple[Path, Path]]:
    """(files, interpreter). ``renew``: the files are made anew; the packages only when pyproject.toml changed."""
    folder = cache_folder() / f"{name}-py{platform.python_version()}"
    tree, venv, mark = folder / "tree", folder / "venv", folder / _MARK
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # until the comparison is over
        if renew or not mark.exists():
            shutil.rmtree(tree, ignore_errors=True)
            tree.mkdir()
            fill(tree)
        wanted = hashlib.sha256((tree / "pyproject.toml").read_bytes()).hexdigest()
        if not mark.exists() or mark.read_text(encoding="ascii") != wanted:
            mark.unlink(missing_ok=True)
            _install(tree, venv)
            mark.write_text(wanted, encoding="ascii")
        yield tree, venv / "bin" / "python"


def _install(tree: Path, venv: Path) -> None:
    shutil.rmtree(venv, ignore_errors=True)
    _run([sys.executable, "-m", "venv", str(venv)], "no virtual environment could be made")
    pip = [str(venv / "bin" / "python"), "-m", "pip", "--disable-pip-version-check"]
    _run([*pip, "install", "--quiet", "--editable", f"{tree}[bench]", "pytest"], f"pip could not install {tree}")


def _run(words: Sequence[str], failure: str) -> None:
    try:
        subprocess.run(
            words, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=_INSTALL_S, check=True, env=clean()
        )
    except subprocess.CalledProcessError as error:
        raise RuntimeError(f"{failure}: {(error.stderr or error.stdout).strip()[-_TOLD:]}") from None
    except subprocess.TimeoutExpired:
        raise RuntimeError(f"{failure}: it took longer than {_INSTALL_S} s") from None


def packages(side: Side) -> set[str]:
    """Names and versions of what is installed in an environment, dpstack itself left out."""
    folders = side.python.parent.parent.glob("lib/python*/site-packages/*.dist-info")
    return {folder.name.removesuffix(".dist-info") for folder in folders if not folder.name.startswith("dpstack-")}


def clean() -> dict[str, str]:
    """The variables of this process without those that lead Python to other modules."""
    return {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL_ENV"))}


def _extract(number: str, tree: Path) -> None:
    with tarfile.open(fileobj=io.BytesIO(_git("archive", "--format=tar", number))) as archive:
        archive.extractall(tree, filter="data")


def _copy(tree: Path) -> None:
    for name in _git("ls-files", "-z", "--cached", "--others", "--exclude-standard").decode().split("\0"):
        source = _ROOT / name
        if name and source.is_file():
            (tree / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, tree / name)


class _GitError(RuntimeError):
    """git ended with an error."""


def _git(*words: str) -> bytes:
    try:
        return subprocess.run(["git", "-C", str(_ROOT), *words], capture_output=True, check=True).stdout
    except FileNotFoundError:
        raise RuntimeError("git is not installed, which --commit needs") from None
    except subprocess.CalledProcessError as error:
        raise _GitError(f"git {words[0]}: {error.stderr.decode(errors='replace').strip()[-_TOLD:]}") from None
