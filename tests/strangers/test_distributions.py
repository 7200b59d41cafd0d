"""Wheel and source archive: built twice from files with other times and modes, installed by every Python that is found.

The last test prints which versions of Python ran. mypy checks the source for the others.
"""

from __future__ import annotations

import functools
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import pytest
from programs import plant_of

from dpstack.cli.assistants import docs_search

pytestmark = pytest.mark.strangers

ROOT: Final = Path(__file__).resolve().parents[2]
#: minor versions of Python 3 that the project names in its classifiers
VERSIONS: Final = (11, 12, 13, 14)
_EPOCH: Final = "1700000000"
_LIMIT_S: Final = 600


def run(command: Sequence[str | Path], folder: Path, **more: str) -> str:
    """The output of a program that ends with 0."""
    hidden = ("PYTHONPATH", "PYENV_VERSION", "VIRTUAL_ENV")
    environment = {name: value for name, value in os.environ.items() if name not in hidden} | more
    done = subprocess.run(
        list(map(str, command)),
        cwd=folder, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=_LIMIT_S,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, f"{command}: {done.stdout[-3000:]}{done.stderr[-3000:]}"
    return done.stdout


def tracked(*under: str) -> list[str]:
    return [
        name
        for name in run(["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z", *under], ROOT).split(
            "\0"
        )
        if name
    ]


def copied(names: Sequence[str], folder: Path) -> Path:
    """The files of the project as they are now, in ``folder``."""
    for name in names:
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / name, target)
    return folder


def built(source: Path, folder: Path) -> list[Path]:
    """Source archive and wheel."""
    run([sys.executable, "-m", "build", "--outdir", folder, source], source, SOURCE_DATE_EPOCH=_EPOCH)
    return [*folder.glob("*.tar.gz"), *folder.glob("*.whl")]


@pytest.fixture(scope="module")
def distributions(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("first")
    return built(copied(tracked(), folder / "source"), folder / "dist")


@pytest.fixture(scope="module")
def wheel(distributions: list[Path]) -> Path:
    (path,) = (path for path in distributions if path.suffix == ".whl")
    return path


def digests(paths: Sequence[Path]) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}


def test_a_second_build_gives_the_same_octets(distributions: list[Path], tmp_path: Path) -> None:
    """From files with other times and modes, in another folder."""
    source = copied(tracked(), tmp_path / "elsewhere" / "copy")
    for number, path in enumerate(path for path in source.rglob("*") if path.is_file()):
        path.chmod(0o600 if number % 2 else 0o664)
        os.utime(path, (1_000_000_000 + number, 1_000_000_000 + number))
    assert digests(built(source, tmp_path / "dist")) == digests(distributions)


def test_every_file_of_the_packages_is_in_both(distributions: list[Path]) -> None:
    with tarfile.open(distributions[0]) as archive:
        packed = {name.partition("/")[2] for name in archive.getnames()}
    with zipfile.ZipFile(distributions[1]) as archive:
        installed = set(archive.namelist())
    names = tracked("dpstack", "drives/dpstack_drives")
    assert len(names) > 400
    assert set(names) <= packed
    assert {name.removeprefix("drives/") for name in names} <= installed
    assert {"dpstack/service/setup_adapter.sh", "dpstack/service/99-dpstack.rules"} <= installed
    assert not [name for name in packed | installed if name.startswith(("tests/", "bench/", "docs/development"))]
    pages = tracked(*(f"docs/{name}" for name in docs_search.SHIPPED))
    assert {name for name in pages if name.endswith(".md")} <= packed
    shipped = {name.partition("/data/share/dpstack/")[2] for name in installed if name.endswith(".md")}
    assert {name for name in pages if name.endswith(".md")} == shipped - {""}


def test_the_containerfile_copies_what_a_build_needs(wheel: Path, tmp_path: Path) -> None:
    text = (ROOT / "Containerfile").read_text(encoding="utf-8")
    words = [line.split()[1:-1] for line in text.splitlines() if line.startswith("COPY ") and "--from" not in line]
    source = copied(tracked(*(word for line in words for word in line)), tmp_path / "source")
    out = tmp_path / "wheels"
    run([sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--wheel-dir", out, source], tmp_path)
    (made,) = out.iterdir()
    with zipfile.ZipFile(made) as mine, zipfile.ZipFile(wheel) as whole:
        assert set(mine.namelist()) == set(whole.namelist())


def test_indexes_know_the_classifiers() -> None:
    from trove_classifiers import classifiers

    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert set(project["classifiers"]) <= classifiers
    named = {int(found[1]) for one in project["classifiers"] if (found := re.search(r":: 3\.(\d+)$", one))}
    assert named == set(VERSIONS)


@functools.cache
def interpreter(minor: int) -> tuple[str, str] | None:
    """Path and version of a Python 3.``minor`` that runs: on PATH, or in the folder of pyenv."""
    versions = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    candidates = [shutil.which(f"python3.{minor}"), *map(str, sorted(versions.glob(f"3.{minor}.*/bin/python")))]
    for path in filter(None, candidates):
        done = subprocess.run(
            [path, "-c", "import platform, venv; print(platform.python_version())"],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        if done.returncode == 0 and done.stdout.startswith(f"3.{minor}."):
            return path, done.stdout.strip()
    return None


@pytest.mark.parametrize("minor", [minor for minor in VERSIONS if interpreter(minor)])
def test_the_wheel_in_a_clean_environment(minor: int, wheel: Path, tmp_path: Path) -> None:
    """Its names, its data files and a short run of a simulated plant, with warnings as errors."""
    found = interpreter(minor)
    assert found is not None
    environment = tmp_path / "venv"
    run([found[0], "-m", "venv", environment], tmp_path)
    python, program = environment / "bin" / "python", environment / "bin" / "dpstack"
    run([python, "-m", "pip", "install", "-q", "--disable-pip-version-check", wheel], tmp_path)
    assert run([program, "--version"], tmp_path) == "dpstack 0.1.0\n"
    names = "import dpstack; print(*[name for name in dpstack.__all__ if getattr(dpstack, name) is None])"
    assert run([python, "-W", "error", "-P", "-c", names], tmp_path) == "\n"
    plant = str(plant_of(tmp_path))
    plan = json.loads(run([python, "-W", "error", "-P", "-m", "dpstack", "plan", plant, "--json"], tmp_path))
    assert [slave["name"] for slave in plan["slaves"]] == ["hoist", "fan", "raw"]
    lines = run([python, "-W", "error", "-P", "-m", "dpstack", "run", plant, "--seconds", "1", "--json"], tmp_path)
    summary = json.loads(lines.splitlines()[-1])
    assert [slave["state"] for slave in summary["slaves"].values()] == ["data_exchange"] * 3
    # the pages of `dpstack mcp` are found where the wheel has put them
    search = "from dpstack.cli.assistants.docs_search import SearchDocs, docs_folder, search_docs"
    found_pages = "print(len(search_docs(SearchDocs(words='termination')).passages), docs_folder())"
    pages = run([python, "-W", "error", "-P", "-c", f"{search}; {found_pages}"], tmp_path)
    assert pages.split() == ["6", str(environment.resolve() / "share/dpstack/docs")]
    # the script of the set-up is where the program looks for it
    run([program, "doctor", "--fix", "--yes"], tmp_path, DESTDIR=str(tmp_path / "root"))
    unit = (tmp_path / "root/etc/systemd/system/dpstack@.service").read_text(encoding="utf-8")
    assert f"ExecStart={program} run" in unit


@pytest.mark.parametrize("minor", [minor for minor in VERSIONS if not interpreter(minor)] or [VERSIONS[-1]])
def test_types_for_the_versions_that_are_not_here(minor: int) -> None:
    """mypy takes the standard library's types of that version."""
    assert minor > sys.version_info.minor
    run([sys.executable, "-m", "mypy", "--python-version", f"3.{minor}", "dpstack", "drives"], ROOT)


def test_at_least_one_python_ran(capsys: pytest.CaptureFixture[str]) -> None:
    ran = [found[1] for minor in VERSIONS if (found := interpreter(minor))]
    missing = [f"3.{minor}" for minor in VERSIONS if not interpreter(minor)]
    with capsys.disabled():
        print(f"\nwheel: ran with Python {', '.join(ran)}; types only: {', '.join(missing) or 'none'}")
    assert ran
