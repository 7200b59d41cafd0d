"""A drive with its maker's GSD file: the file has priority over the data of the plugin."""

from __future__ import annotations

from pathlib import Path

import pytest
from api_kit import operating, running

from dpstack.api.config.config import parse_config, slave_config
from dpstack.api.config.slave import SlaveConfig
from dpstack.errors import ConfigError

pytestmark = pytest.mark.virtual_time

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


def test_the_note_about_the_other_reading_of_the_file(folder: Path) -> None:
    contradicting = 'ExtUserPrmData = 1 "Ramp"\nUnsigned8 7 0-255\nEndExtUserPrmData\nExt_User_Prm_Data_Ref(2) = 1\n'
    text = FRENIC.replace("Unit_Diag_Bit", contradicting + "Unit_Diag_Bit", 1)
    (folder / "frenic.gsd").write_text(text, encoding="utf-8")
    params = fan(folder, 'telegram = "PPO3"\n').params
    assert params.user_prm == b"\x01\x02\x07"
    assert params.prm_note.startswith(
        "in its GSD file defaults and constants contradict each other (octet 10 of Set_Prm)"
    )
    assert fan(folder, 'telegram = "PPO3"\nuser_prm = "01 02 03"\n').params.prm_note == ""


def test_the_file_has_priority_over_the_plugin(folder: Path) -> None:
    slave = fan(folder, 'telegram = "PPO3"\nsync = true\n')
    assert (slave.params.ident, slave.params.config, slave.params.user_prm) == (0x0A1B, b"\xf1", b"\x01\x02\x03")
    assert (slave.telegram, slave.notes, slave.params.sync) == ("PPO3", (), True)
    assert (slave.params.min_slave_interval_ns, slave.params.max_tsdr[500_000]) == (300_000, 100)
    assert slave.params.texts is not None
    assert [found.text for found in slave.params.texts.unit_diag_texts(b"\x01")] == ["inverter trip"]


def test_the_telegram_follows_from_the_modules_where_only_one_fits(folder: Path) -> None:
    assert fan(folder, 'modules = ["PPO type 3"]\n').telegram == "PPO3"
    assert fan(folder, 'modules = ["PPO type 1"]\ntelegram = "PPO1"\n').params.config == b"\xf3\xf1"


def test_known_identifier_octets_name_the_telegram() -> None:
    table = {"name": "hoist", "address": 3, "drive": "demag-dedrive", "gsd": "demag-dedrive"}
    assert slave_config(table).params.config == b"\xf3\x71"
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
    ],
)
def test_refused(folder: Path, keys: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        fan(folder, keys)
    assert str(caught.value).startswith(f"{folder}/plant.toml:{message}")


async def test_the_drive_runs_with_its_file(folder: Path) -> None:
    async with operating(fan(folder, 'telegram = "PPO3"\n')) as bus:
        drive = bus.drive("fan")
        await drive.start()
        drive.speed = 0.5
        await drive.reached(timeout=30)
        assert drive.status.speed == pytest.approx(0.5, abs=0.01)


#: identifier octets and ident number that no plugin has
HD2 = """#Profibus_DP
GSD_Revision = 3
Vendor_Name = "made up"
Model_Name = "HD2"
Ident_Number = 0x0C2D
1.5M_supp = 1
MaxTsdr_1.5M = 150
Modular_Station = 0
Module = "one frame" 0xF3,0xFB
EndModule
"""


@pytest.mark.parametrize(
    ("table", "text", "config"),
    [
        ({"drive": "ls-s100", "gsd": "ls-s100", "modules": ["PPO2"]}, "", "f375"),
        ({"drive": "ls-s100", "gsd": "ls-s100", "modules": ["Standard telegram 1"]}, "", "f1"),
        (
            {"drive": "keb-f5", "gsd": "keb-f5", "modules": ["Parameter channel", "Outputs 4 byte", "Inputs 4 byte"]},
            "",
            "b7a393",
        ),
        ({"drive": "imo-hd2", "gsd": "hd2.gsd", "options": {"set_map": True}}, HD2, "f3fb"),
    ],
    ids=lambda value: str(value)[:40],
)
async def test_other_drives_run_as_their_files_say(
    tmp_path: Path, table: dict[str, object], text: str, config: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Identifier octets and ident number of the file at both ends: data exchange, and the drive runs."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hd2.gsd").write_text(text, encoding="utf-8")
    slave = {"name": "it", "address": 5, **table}
    found = slave_config(slave)
    assert found.params.config.hex() == config
    assert not any("made up" in note for note in found.notes)
    async with running(slave, 1_500_000) as (_, it):
        it.speed = 0.25
        await it.start()
        await it.reached()
        assert it.status.speed == pytest.approx(0.25, abs=0.01)
