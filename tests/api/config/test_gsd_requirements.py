"""Notes about requirements of a GSD file that a configuration switches off; services that the file excludes."""

from __future__ import annotations

from pathlib import Path

import pytest
from api_kit import RAW, bus_of, slave_in

import dpstack
from dpstack import UsageError
from dpstack.api.config.config import parse_config
from dpstack.dp.pdu.diag_blocks import UserDiag, channel_block, device_block
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.errors import ConfigError

pytestmark = pytest.mark.virtual_time

GSD = """#Profibus_DP
GSD_Revision = 5
Model_Name = "rig"
Ident_Number = 0x1234
500_supp = 1
MaxTsdr_500 = 100
Max_Diag_Data_Len = 64
User_Prm_Data_Len = 3
User_Prm_Data = 0x00,0x00,0x00
DPV1_Slave = 1
C1_Read_Write_supp = 1
C1_Max_Data_Len = 64
C1_Response_Timeout = 100
Process_Alarm_supp = 1
Unit_Diag_Bit(0) = "fuse blown"
Channel_Diag(17) = "sensor missing"
Module = "io" 0x20, 0x10
EndModule
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "rig.gsd").write_text(GSD, encoding="ascii")
    return tmp_path


def notes(folder: Path, keywords: str, keys: str) -> list[str]:
    """The notes about slave 8, whose GSD file has the ``keywords`` too."""
    (folder / "rig.gsd").write_text(GSD.replace("Module =", f"{keywords}\nModule =", 1), encoding="ascii")
    table = f'[[slave]]\nname = "rig"\naddress = 8\ngsd = "rig.gsd"\n{keys}\n'
    config = parse_config(f'[bus]\nport = "virtual"\nbaud = 500000\n{table}', str(folder / "plant.toml"))
    bus = dpstack.open_bus(config)
    return [note.removeprefix("slave 8 (rig): ") for note in bus.plan.notes if note.startswith("slave 8 (rig): ")]


EXTRA = (
    "extra_alarm_sap = true, but its GSD file does not say Extra_Alarm_SAP_supp = 1: alarms are acknowledged at SAP 50"
)


@pytest.mark.parametrize(
    ("keywords", "keys", "text"),
    [
        (
            "C1_Read_Write_required = 1",
            "dpv1 = false",
            "C1_Read_Write_required = 1: it counts on Read and Write; leave dpv1",
        ),
        (
            "Process_Alarm_required = 1",
            "dpv1 = false",
            "says Process_Alarm_required = 1: it raises no alarms now; leave dpv1",
        ),
        ("", "dpv1 = { extra_alarm_sap = true }", EXTRA),
        ("Isochron_Mode_required = 1", "", "Isochron_Mode_required = 1, and dpstack has no isochronous mode"),
    ],
)
def test_requirements_that_the_configuration_switches_off_get_a_note(
    folder: Path, keywords: str, keys: str, text: str
) -> None:
    (note,) = notes(folder, keywords, keys)
    assert text in note


@pytest.mark.parametrize(
    ("keywords", "keys"),
    [
        ("C1_Read_Write_required = 1\nProcess_Alarm_required = 1", ""),
        ("C1_Read_Write_required = 1", "dpv1 = true"),
        ("", "dpv1 = false"),
        ("C2_Read_Write_supp = 1\nC2_Read_Write_required = 1", "dpv1 = false"),  # class 2 is no matter of this master
        ("Extra_Alarm_SAP_supp = 1", "dpv1 = { extra_alarm_sap = true }"),
        ("Extra_Alarm_SAP_supp = 1", "dpv1 = { extra_alarm_sap = false }"),  # SAP 51 works, too
    ],
)
def test_configurations_without_a_note(folder: Path, keywords: str, keys: str) -> None:
    assert notes(folder, keywords, keys) == []


def test_a_required_alarm_without_its_supp_keyword_can_be_enabled(folder: Path) -> None:
    required = "Update_Alarm_required = 1"
    assert notes(folder, required, 'dpv1 = { alarms = ["update"] }') == []
    with pytest.raises(ConfigError, match="Update_Alarm_required = 1"):
        notes(folder, required, 'dpv1 = { alarms = ["process"] }')


# --- Set_Slave_Add ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "ident"),
    [(9, 10, None), (126, 9, None), (126, 10, 0x1234)],
)
async def test_set_slave_add_is_refused_where_the_file_excludes_it(
    folder: Path, old: int, new: int, ident: int | None
) -> None:
    table = {"name": "rig", "address": 9, "gsd": str(folder / "rig.gsd")}
    async with bus_of(table, world=dpstack.World()) as bus:
        with pytest.raises(UsageError) as caught:
            await bus.class2.set_address(old, new, ident=ident)
        assert str(caught.value) == (
            "slave 9 (rig): its GSD file does not say Set_Slave_Add_supp = 1: its address is set at the device "
            "(switches, its keypad); force=True asks it all the same"
        )
        with pytest.raises(dpstack.SlaveTimeout):  # nobody is there
            await bus.class2.set_address(old, new, ident=ident, force=True)


@pytest.mark.parametrize("says", ["Set_Slave_Add_supp = 1", None])
async def test_set_slave_add_where_the_file_allows_it_or_there_is_none(folder: Path, says: str | None) -> None:
    (folder / "rig.gsd").write_text(f"{GSD}{says}\n", encoding="ascii")
    table = {"name": "rig", "address": 9, "gsd": str(folder / "rig.gsd")} if says else RAW
    async with bus_of(table, world=dpstack.World()) as bus:
        with pytest.raises(dpstack.SlaveTimeout):
            await bus.class2.set_address(126, 9)


# --- the texts of a diagnosis over class 2 ------------------------------------------------------------------------


class Faulty(MirrorDevice):
    """A device with diagnosis blocks."""

    def user_diag(self) -> UserDiag:
        return UserDiag.of(device_block(b"\x01"), channel_block(0, 3, 17, size=1, input=True))


@pytest.mark.parametrize(("ident", "words"), [(0x1234, True), (0x4321, False)])
async def test_a_diagnosis_over_class_2_has_the_texts_of_the_gsd_file(folder: Path, ident: int, words: bool) -> None:
    """Only for the configured device, not for another one at its address."""
    world = dpstack.World()
    slave_in(world, Faulty(ident, b"\x20\x10"), 9)
    table = {"name": "rig", "address": 9, "gsd": str(folder / "rig.gsd"), "dpv1": False}
    async with bus_of(table, world=world) as bus:
        found = await bus.class2.diagnosis(9)
        assert found.ident == ident
        said = "fuse blown" if words else "device: 01"
        channel = "sensor missing" if words else "bit): error 17"
        assert said in found.diagnosis_texts
        assert any(channel in line for line in found.diagnosis_texts)
        assert found.diagnosis_texts[: len(found.texts)] == found.texts
