"""A plugin without a simulated drive works at a real port; commands that simulate say so. Two plugins of one maker."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import pytest
from cli_kit import Cli
from profidrive_kit import DRIVE

from dpstack.api.config.config import load_config, parse_config
from dpstack.cli.commands import demo
from dpstack.devices.finding import find
from dpstack.errors import ConfigError
from dpstack.profile.registry import also

PLANT = '[bus]\nport = "{}"\nbaud = 500000\n[[slave]]\nname = "belt"\naddress = 7\ndrive = "profidrive-kit"\n'
SAYS = "profidrive-kit has no simulated drive: use the drive itself, on a port of this computer"


@pytest.fixture
def real() -> Iterator[None]:
    with also(dataclasses.replace(DRIVE, device_factory=None)):
        yield


@pytest.fixture
def plant(tmp_path: Path, real: None) -> str:
    path = tmp_path / "plant.toml"
    path.write_text(PLANT.format("virtual"))
    return str(path)


def test_it_is_configured_for_a_real_port(real: None) -> None:
    (slave,) = parse_config(PLANT.format("/dev/ttyUSB0")).slaves
    assert slave.profile is not None
    assert slave.profile.core("belt").drive == "profidrive-kit"
    with pytest.raises(ConfigError, match=rf"config:8: .*belt: {SAYS}"):
        parse_config(PLANT.format("/dev/ttyUSB0") + "simulated = { load = 1 }\n")


def test_a_command_that_simulates_says_that_it_cannot(cli: Cli, plant: str) -> None:
    assert load_config(plant).virtual
    for words in (
        ("run", plant, "--seconds", "1"),
        ("plan", plant, "--simulate", "1"),
        ("sim", plant, "--port", "pty"),
        ("sim", "--drive", "profidrive-kit", "--address", "7", "--port", "pty"),
    ):
        assert SAYS in cli.err(*words), words


def test_the_demo_leaves_it_out(real: None) -> None:
    assert "profidrive-kit" not in {slave.params.name for slave in demo.plant(500_000).slaves}
    assert len(demo.plant(500_000).slaves) == 5


def test_the_demo_calls_two_drives_of_one_maker_by_their_full_names() -> None:
    with also(dataclasses.replace(find("keb-f5"), name="keb-g6")):
        names = [slave.name for slave in demo.plant(500_000).slaves]
    assert names == ["demag", "fuji", "imo", "keb-f5", "keb-g6", "ls"]
