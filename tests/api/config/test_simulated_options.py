"""The key ``simulated``: options and parameters of a simulated drive; its address after power-on."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest
from api_kit import bench_of, device_of, running

import dpstack

pytestmark = pytest.mark.virtual_time

BASE = """
[bus]
port = "virtual"
baud = 500000

[[slave]]
name = "hoist"
address = 4
drive = "demag-dedrive"
telegram = "PPO1"
simulated = {table}
"""


async def test_options_and_parameters_of_the_simulated_drive(tmp_path: Path) -> None:
    path = tmp_path / "bus.toml"
    path.write_text(BASE.format(table="{ load = 0.8, 412 = 1, fixed_frequency_1 = 7.5 }"), encoding="utf-8")
    async with dpstack.open_bus(path) as bus:
        await bus.operate()
        hoist = bus.drive("hoist")
        await hoist.start()
        assert await hoist.read("fixed_frequency_1", data_set=1) == 7.5
        assert device_of(bus, 4).motor.load == 0.8


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ("{ loud = 1 }", "there is no option or parameter 'loud'"),
        ("{ load = 3 }", r"load = 3 is outside 0\.\.2"),
        ("{ 412 = 45 }", r"412 .* outside 0\.\.44"),
        ("5", "simulated"),
    ],
)
def test_unknown_options_are_refused_with_the_key(tmp_path: Path, table: str, says: str) -> None:
    path = tmp_path / "bus.toml"
    path.write_text(BASE.format(table=table), encoding="utf-8")
    with pytest.raises(dpstack.ConfigError, match=says) as error:
        dpstack.load_config(path)
    assert "simulated" in str(error.value)


DRIVES: list[tuple[Mapping[str, object], str | int]] = [
    ({"drive": "demag-dedrive", "telegram": "PPO1"}, 391),
    ({"drive": "keb-f5", "telegram": "PCH+4/4"}, "sy.06"),
    ({"drive": "imo-hd2"}, "P15.01"),
    ({"drive": "ls-s100", "telegram": "PPO1"}, "COM-07"),
    ({"drive": "fuji-frenic", "telegram": "PPO1", "simulated": {"switches": 0}}, "o31"),
]


@pytest.mark.parametrize(("table", "parameter"), DRIVES, ids=lambda value: str(value)[:30])
async def test_a_new_address_acts_from_the_next_power_on(table: Mapping[str, object], parameter: str | int) -> None:
    """Until then it keeps the old address (for one drive: docs/reference/drives/demag.md#address)."""
    async with running({"name": "it", "address": 4, **table}, 1_500_000) as (bus, drive):
        assert await drive.read(parameter) == 4
        await drive.write(parameter, 9)
        bench = bench_of(bus)
        bench.power(4, False)
        bench.power(4, True)
        found = await bus.scan()
        assert {station.address for station in found if station.ident is not None} == {9}
