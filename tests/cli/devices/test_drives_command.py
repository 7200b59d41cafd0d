"""``dpstack drives``: the drives and devices that are known here, with the package that brings each."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from cli_kit import Cli

from dpstack import __version__
from dpstack.profile import registry

EXAMPLE = Path(__file__).resolve().parents[3] / "examples" / "thirdparty_drive"


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Two packages as ``pip install`` leaves them: the example's, and one that is broken."""
    for package, point in (
        ("acme_drive", "acme-a300 = acme_drive:DRIVE"),
        ("broken", "nowhere = no_such_module:DRIVE"),
    ):
        info = tmp_path / f"{package}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: dpstack-{package}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[dpstack.drives]\n{point}\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.syspath_prepend(str(EXAMPLE))
    registry.refresh()
    yield
    registry.refresh()


def test_drives_and_devices_that_come_with_dpstack(cli: Cli) -> None:
    found = cli.json("drives")
    names = {one["name"] for one in found["drives"]}
    assert names >= {"demag-dedrive", "fuji-frenic", "imo-hd2", "keb-f5", "ls-s100", "profidrive"}
    assert {one["origin"] for one in found["drives"] + found["devices"]} == {f"dpstack {__version__}"}
    demag, fuji = (one for one in found["drives"] if one["name"] in ("demag-dedrive", "fuji-frenic"))
    assert (demag["ident"], demag["telegrams"]) == ("0x0696", ["PPO1", "PPO2", "PPO3", "PPO4"])
    assert (demag["telegram"], demag["gsd"], Path(demag["place"]).name) == ("PPO1", True, "demag-dedrive.toml")
    assert "set_412" in demag["options"]
    assert (fuji["ident"], fuji["gsd"]) == (None, False)  # its ident number is in no manual
    devices = {one["name"]: (one["key"], one["ident"]) for one in found["devices"]}
    assert devices["io-station"] == ("gsd", "0x10D5")
    assert devices["simodrive-sensor"] == ("device", "0x0024")
    assert found["broken"] == []
    lines = [line.split() for line in cli.out("drives").splitlines()]
    assert [
        "fuji-frenic",
        "Fuji",
        "FRENIC-Multi,",
        "OPC-E1-PDP",
        "ask",
        *fuji["telegrams"],
        "dpstack",
        __version__,
    ] in lines
    assert lines[-1][:1] == ["io-station"]


def test_drives_of_other_packages(cli: Cli, install: None) -> None:
    found = cli.json("drives", code=1)
    (acme,) = (one for one in found["drives"] if one["name"] == "acme-a300")
    assert (acme["origin"], acme["place"]) == ("dpstack-acme_drive 1.0", "acme_drive:DRIVE")
    assert [one["name"] for one in found["broken"]] == ["nowhere"]
    assert "acme-a300 is a plugin of a Python package, not a device file" in cli.err("device", "show", "acme-a300")
    listed = {one["name"]: one["base"] for one in cli.json("device", "list", code=1)["devices"]}
    assert (listed["acme-a300"], listed["keb-f5"]) == ("python", "bits")
    out, err = cli("drives", code=1)
    assert "dpstack-acme_drive 1.0" in out
    assert err == (
        "dpstack: drive nowhere cannot be loaded: no_such_module:DRIVE: ModuleNotFoundError: No module named "
        "'no_such_module'; repair or uninstall that package\n"
    )
