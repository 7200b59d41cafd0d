"""Drives by entry point: found, nearest names, and third-party packages that are broken."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from dpstack import profile
from dpstack.devices.finding import find
from dpstack.devices.profiles import DevicePython
from dpstack.entry_points import EntryPoint
from dpstack.errors import ConfigError
from dpstack.profile import registry
from dpstack_drives.demag import DRIVE as DEMAG
from dpstack_drives.fuji import DRIVE as FUJI
from dpstack_drives.imo import DRIVE as IMO
from dpstack_drives.keb import DRIVE as KEB

FIVE = ("demag-dedrive", "fuji-frenic", "imo-hd2", "keb-f5", "ls-s100")
GOOD = [
    EntryPoint("demag-dedrive", "dpstack_drives.demag:DRIVE"),
    EntryPoint("fuji-frenic", "dpstack_drives.fuji:DRIVE"),
]
BAD = [
    EntryPoint("gone", "no_such_package.drive:DRIVE"),
    EntryPoint("other", "dpstack_drives.demag:DRIVE"),
    EntryPoint("path", "pathlib:Path"),
]


@pytest.fixture
def points(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    def entry_points(group: str) -> list[EntryPoint]:
        assert group == "dpstack.drives"
        return [*BAD, *GOOD]

    monkeypatch.setattr(registry, "entry_points", entry_points)
    profile.refresh()
    yield
    profile.refresh()


@pytest.mark.usefixtures("points")
def test_known_drives_in_spite_of_broken_packages() -> None:
    assert profile.known() == {"demag-dedrive": DEMAG, "fuji-frenic": FUJI}
    assert profile.find("fuji-frenic") is FUJI
    broken = profile.broken()
    assert set(broken) == {"gone", "other", "path"}
    assert "no_such_package" in broken["gone"]
    assert "calls itself demag-dedrive" in broken["other"]
    assert "not a DriveProfile" in broken["path"]


@pytest.mark.usefixtures("points")
def test_names_that_are_not_there() -> None:
    with pytest.raises(ConfigError, match="did you mean demag-dedrive"):
        profile.find("Demag-Drive")
    with pytest.raises(ConfigError, match="known: demag-dedrive, fuji-frenic"):
        profile.find("zzz")
    with pytest.raises(ConfigError, match="cannot be loaded: no_such_package"):
        profile.find("gone")


def test_the_entry_points_of_this_project_load() -> None:
    text = (Path(__file__).resolve().parents[2] / "pyproject.toml").read_text()
    groups = tomllib.loads(text)["project"]["entry-points"]
    assert "dpstack.drives" not in groups, "the drives of this project are device files"
    assert set(groups["dpstack.device_files"]) == set(groups["dpstack.devices"]) == set(FIVE)
    for name, value in groups["dpstack.devices"].items():
        python = EntryPoint(name, value).load()
        assert isinstance(python, DevicePython)
        assert value == f"{groups['dpstack.device_files'][name]}:PYTHON"


@pytest.mark.parametrize("name", FIVE)
def test_a_drive_of_this_project_is_a_device_file(name: str) -> None:
    drive = find(name)
    assert drive.name == name
    assert Path(drive.file).name == f"{name}.toml"
    assert type(drive.core("it")).__module__.startswith("dpstack_drives.")
    assert type(drive.device()).__module__.startswith("dpstack_drives.")


def test_every_name_that_the_package_exports_exists() -> None:
    for name in dir(profile):
        assert hasattr(profile, name)


@pytest.mark.parametrize("drive", [DEMAG, FUJI, KEB, IMO])
def test_profiles_are_complete(drive: profile.DriveProfile) -> None:
    assert drive.default_telegram in drive.telegrams
    for name, spec in drive.telegrams.items():
        core = drive.core("it", name)
        assert len(core.safe_outputs) == spec.output_octets
        device = drive.device(name)
        assert device.configs[0] == spec.config
        assert device.ident == drive.ident
    assert drive.device().telegram.name == drive.default_telegram
    assert "Clear" in drive.on_loss
