"""``ident = { configured = ..., adapts = true }``: the key, the octets in the plan, a simulated device that adapts."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

import pytest
from api_kit import bench_of, bus_of, in_virtual_time
from gsd_kit import FILES

from dpstack.api.config.config import parse_config
from dpstack.api.config.slave import SlaveConfig
from dpstack.cli.main import main
from dpstack.errors import ConfigError
from dpstack.events import SlaveDiagnosis, SlaveRemark
from dpstack.trace import Event

HEAD = '[bus]\nport = "virtual"\nbaud = 93750\n[[slave]]\nname = "flow"\naddress = 12\n'


def slave(keys: str) -> SlaveConfig:
    return parse_config(HEAD + keys, str(FILES / "plant.toml")).slaves[0]


@pytest.mark.parametrize(
    ("ident", "wanted"),
    [
        ("{ configured = 0x9700, adapts = true }", (0x9700, True)),
        ("{ configured = 0x9700 }", (0x9700, False)),
        ("{ configured = 0x9700, adapts = false }", (0x9700, False)),
        ("0x9700", (0x9700, False)),
    ],
)
def test_the_key(ident: str, wanted: tuple[int, bool]) -> None:
    params = slave(f'ident = {ident}\nconfig = "94"\n').params
    assert (params.ident, params.ident_adapts) == wanted


def test_the_number_of_the_gsd_file_is_the_configured_one() -> None:
    params = slave('gsd = "slots.gsd"\nident = { adapts = true }\n').params
    assert (params.ident, params.ident_adapts) == (0x0FFE, True)


@pytest.mark.parametrize(
    ("ident", "message"),
    [
        ("{ adapts = true }", "a device that adapts its ident number needs one to adapt to: give configured"),
        ("{ configured = 0x19700, adapts = true }", "configured = 104192 is outside 0..65535; an ident number has two"),
        ("{ configured = 1, adapt = true }", "unknown key 'adapt'; did you mean 'adapts'?"),
        ('{ configured = "ask", adapts = true }', "configured = 'ask' is a text; it must be an integer"),
        ("{ configured = 1, adapts = 1 }", "adapts = 1 is an integer; it must be true or false"),
    ],
)
def test_refused(ident: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        slave(f'ident = {ident}\nconfig = "94"\n')
    assert message in str(caught.value)


def test_the_plan_shows_the_configured_number(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "plant.toml"
    path.write_text(HEAD + 'ident = { configured = 0x9700, adapts = true }\nconfig = "94"\nwatchdog_ms = 200\n')
    assert main(["plan", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["slaves"][0]["set_prm"] == "8801140b970000"


@in_virtual_time
async def test_a_simulated_device_that_adapts() -> None:
    """It shows the number of its GSD file until Set_Prm, and again from the loss of its master on."""
    table = {"address": 12, "gsd": str(FILES / "slots.gsd"), "ident": {"configured": 0x9700, "adapts": True}}
    seen: list[int] = []
    remarks: list[str] = []

    def note(event: Event) -> None:
        if isinstance(event, SlaveDiagnosis):
            seen.append(event.diagnosis.ident)
        elif isinstance(event, SlaveRemark):
            remarks.append(event.message)

    async with bus_of(table, on_event=note) as bus:
        await bus.operate()
        meter = bus.slave(12)
        await meter.ready()
        assert (meter.state.value, meter.fault) == ("data_exchange", None)
        assert (seen[0], seen[-1]) == (0x0FFE, 0x9700)
        assert remarks == [
            "its diagnosis shows ident 0x0FFE; Set_Prm goes out once with the configured 0x9700, as its ident number "
            "adapts"
        ]
        bench_of(bus).power(12, on=False)
        await asyncio.sleep(1)
        bench_of(bus).power(12, on=True)
        await meter.ready()
        assert (meter.state.value, 0x0FFE in seen[1:], seen[-1]) == ("data_exchange", True, 0x9700)
