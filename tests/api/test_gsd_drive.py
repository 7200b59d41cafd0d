"""A drive beside its maker's GSD file: what the file says goes before what the plugin made up."""

from __future__ import annotations

from pathlib import Path

import pytest

import dpstack
from dpstack.api.config import parse_config, slave_config
from dpstack.api.slave_config import SlaveConfig
from dpstack.errors import ConfigError

FRENIC = """#Profibus_DP
GSD_Revision = 3
Vendor_Name = "made up"
Model_Name = "inverter"
Ident_Number = 0x0A1B
500_supp = 1
MaxTsdr_500 = 100
Sync_Mode_supp = 1
Min_Slave_Intervall = 3
Modular_Station = 1
Max_Module = 1
Max_Input_Len = 12
Max_Output_Len = 12
Max_Data_Len = 24
Max_User_Prm_Data_Len = 3
Ext_User_Prm_Data_Const(0) = 0x01,0x02,0x03
Unit_Diag_Bit(0) = "inverter trip"
Module = "PPO type 1" 0xF3,0xF1
EndModule
Module = "PPO type 3" 0xF1
EndModule
Module = "PPO type 4" 0xF5
EndModule
"""
HEAD = '[bus]\nport = "virtual"\nbaud = 500000\n[[slave]]\nname = "fan"\naddress = 4\ndrive = "fuji-frenic"\n'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "frenic.gsd").write_text(FRENIC, encoding="utf-8")
    return tmp_path


def fan(folder: Path, keys: str) -> SlaveConfig:
    return parse_config(HEAD + 'gsd = "frenic.gsd"\n' + keys, str(folder / "plant.toml")).slaves[0]


def test_the_file_goes_before_what_was_made_up(folder: Path) -> None:
    slave = fan(folder, 'telegram = "PPO3"\nsync = true\n')
    assert (slave.ident, slave.config, slave.user_prm) == (0x0A1B, b"\xf1", b"\x01\x02\x03")
    assert (slave.telegram, slave.notes, slave.sync) == ("PPO3", (), True)
    assert (slave.min_slave_interval_ns, slave.setup(500_000).max_tsdr) == (300_000, 100)
    assert slave.texts is not None
    assert slave.texts.unit_diag_texts(b"\x01") == ("inverter trip",)


def test_the_telegram_follows_from_the_modules_where_only_one_fits(folder: Path) -> None:
    assert fan(folder, 'modules = ["PPO type 3"]\n').telegram == "PPO3"
    assert fan(folder, 'modules = ["PPO type 1"]\ntelegram = "PPO1"\n').config == b"\xf3\xf1"


def test_known_identifier_octets_name_the_telegram() -> None:
    table = {"name": "hoist", "address": 3, "drive": "demag-dedrive", "gsd": "demag-dedrive"}
    assert slave_config(table).config == b"\xf3\x71"
    assert slave_config(table | {"modules": ["PPO4 (6 words)"]}).telegram == "PPO4"


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ("", "8: [[slave]] fan: 2 modules have 12 octets of inputs and 12 of outputs; name the one that is plugged: "),
        (
            'modules = ["PPO type 1"]\n',
            "9: [[slave]] fan: the modules F3 F1 have 12 octets of inputs and 12 of outputs: that may be PPO1 or PPO4; "
            'add telegram = "PPO1"',
        ),
        (
            'modules = ["PPO type 3"]\ntelegram = "PPO1"\n',
            "10: [[slave]] fan: the modules F1 have 4 octets of inputs and 4 of outputs, PPO1 has 12 and 12; name the ",
        ),
        ('telegram = "PPO2"\n', "8: [[slave]] fan: no single module has 20 octets of inputs and 20 of outputs; name "),
        ('telegram = "PPO3"\nfreeze = true\n', "10: [[slave]] fan: freeze = true, but its GSD file says Freeze_Mode_"),
        ('telegram = "PPO3"\nconfig = "F1"\n', "10: [[slave]] fan: config beside gsd; leave config out, or gsd"),
        ('telegram = "PPO3"\nuser_prm = "01"\n', "10: [[slave]] fan: user_prm has 1 octets; with these modules 3 are"),
    ],
)
def test_refused(folder: Path, keys: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        fan(folder, keys)
    assert str(caught.value).startswith(f"{folder}/plant.toml:{message}")


async def runs(slave: SlaveConfig) -> float | None:
    async with dpstack.open_bus(port="virtual", baud=500_000, slaves=[slave]) as bus:
        await bus.operate()
        await bus.ready()
        drive = bus.drive("fan")
        await drive.start()
        drive.speed = 0.5
        await drive.reached(timeout=30)
        return drive.status.speed


def test_the_drive_runs_with_it_and_so_does_the_simulated_one(folder: Path) -> None:
    assert dpstack.run_virtual(runs(fan(folder, 'telegram = "PPO3"\n'))) == pytest.approx(0.5, abs=0.01)
