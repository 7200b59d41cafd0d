"""Entry points read by ourselves: those that importlib.metadata finds, in the same packages."""

from __future__ import annotations

import sys
import zipfile
from importlib import metadata
from pathlib import Path

import pytest

from dpstack.entry_points import EntryPoint, entry_points

GROUP = "dpstack.drives"


def as_python_has_it(group: str) -> list[tuple[str, str]]:
    return sorted((point.name, point.value) for point in metadata.entry_points(group=group))


@pytest.mark.parametrize("group", ["dpstack.device_files", "dpstack.devices", GROUP, "console_scripts", "pytest11"])
def test_what_is_installed_here(group: str) -> None:
    assert sorted(map(tuple, entry_points(group))) == as_python_has_it(group)


def package(folder: Path, name: str, text: str) -> None:
    info = folder / name
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name.partition('-')[0]}\nVersion: 1\n")
    (info / "entry_points.txt").write_text(text)


def test_the_first_package_of_a_name_counts_and_odd_files_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    odd = f"# remark\n[other]\nx = y:z\n[{GROUP}]\n  a = p.q:A [extra]\n\n# b = gone:B\nc=d\n[ more ]\ne = f:g\n"
    package(first, "odd_one-1.0.dist-info", odd)
    package(second, "Odd.One-2.0.dist-info", f"[{GROUP}]\na = hidden:A\n")
    package(second, "plain.egg-info", f"[{GROUP}]\nplain = plain:P\n")
    (second / "empty-1.dist-info").mkdir()
    monkeypatch.setattr(sys, "path", [str(first), str(tmp_path / "gone"), str(second)])
    found = [("a", "p.q:A [extra]"), ("c", "d"), ("plain", "plain:P")]
    assert sorted(map(tuple, entry_points(GROUP))) == as_python_has_it(GROUP) == found
    with zipfile.ZipFile(tmp_path / "packed.zip", "w") as packed:
        packed.writestr("packed-1.dist-info/METADATA", "Metadata-Version: 2.1\nName: packed\nVersion: 1\n")
        packed.writestr("packed-1.dist-info/entry_points.txt", f"[{GROUP}]\npacked = packed:P\n")
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path / "packed.zip")])
    assert (
        sorted(map(tuple, entry_points(GROUP))) == as_python_has_it(GROUP) == sorted([*found, ("packed", "packed:P")])
    )


def test_the_object_of_an_entry_point() -> None:
    assert EntryPoint("path", "pathlib:Path.cwd [extra]").load() == Path.cwd
    assert EntryPoint("module", "os.path").load() is sys.modules["os.path"]
    with pytest.raises(ImportError):
        EntryPoint("gone", "no_such_package:X").load()
