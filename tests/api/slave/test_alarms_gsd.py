"""Alarms and the GSD file: its texts in either process, kinds that it excludes, kinds that it requires."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from gsd_kit import device

import dpstack
from dpstack.api.config.config import parse_config
from dpstack.dp.master.slave_reports import SlaveReports
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.master.alarm_handler import AlarmBook, AlarmHandler
from dpstack.dpv1.master.orders import AlarmRaised
from dpstack.drivers.process.client import worded
from dpstack.errors import ConfigError
from dpstack.gsd.diag_texts import DiagTexts

ALL = ("pull_plug", "process", "diagnostic", "manufacturer", "status", "update")


@pytest.mark.parametrize("rest", ["", "42 01 80 40 30"])
def test_the_texts_of_the_gsd_file_in_either_process(rest: str) -> None:
    texts = DiagTexts(device("diagnosis"), [None])
    setup = SlaveParams(
        address=9, name="rig", ident=1, config=b"\x10", user_prm=bytes(3), dpv1=Dpv1(alarms=ALL), texts=texts
    )
    diagnosis = Diagnosis(8, 0x0C, 0, 2, 1, bytes.fromhex("05 21 03 01 01" + rest))
    events: list[dpstack.Event] = []
    for of in (setup, dataclasses.replace(setup, texts=None)):  # the bus process has none
        handler: Any = SimpleNamespace(setup=of, reports=SlaveReports(of, events.append, 2, set()), want_diagnosis=None)
        AlarmHandler(handler, AlarmBook()).read(diagnosis, True, 1, 7)
    own, foreign = events
    assert isinstance(own, AlarmRaised)
    assert own.texts[0] == "fuse blown"
    if rest:
        module, channel = own.texts[-2:]
        assert module == "slots with a diagnosis: 1"
        assert channel == "slot 1, input channel 0 (bit): sensor missing (plug it in)"
    assert isinstance(foreign, AlarmRaised)
    assert worded(foreign, setup) == own


GSD = """#Profibus_DP
GSD_Revision = 5
Vendor_Name = "none"
Model_Name = "rig"
Revision = "1"
Ident_Number = 0x1234
Protocol_Ident = 0
Station_Type = 0
Hardware_Release = "1"
Software_Release = "1"
500_supp = 1
MaxTsdr_500 = 100
Slave_Family = 0
Max_Diag_Data_Len = 64
User_Prm_Data_Len = 3
User_Prm_Data = 0x00,0x08,0x00
Modular_Station = 0
DPV1_Slave = 1
C1_Read_Write_supp = 1
C1_Max_Data_Len = 64
C1_Response_Timeout = 100
Diagnostic_Alarm_supp = 1
Process_Alarm_supp = 1
Process_Alarm_required = 1
Status_Alarm_supp = 1
Extra_Alarm_SAP_supp = 1
Alarm_Sequence_Mode_Count = 4
Module = "io" 0x20, 0x10
EndModule
"""


def setup_of(folder: Path, dpv1: str) -> SlaveParams:
    """The parameters of a slave with the GSD file above and the key ``dpv1``."""
    (folder / "rig.gsd").write_text(GSD, encoding="latin-1")
    table = f'name = "rig"\naddress = 9\ngsd = "rig.gsd"\nmodules = ["io"]\ndpv1 = {dpv1}\n'
    text = f'[bus]\nport = "virtual"\nbaud = 500000\n[[slave]]\n{table}'
    return parse_config(text, str(folder / "plant.toml")).slaves[0].params


@pytest.mark.parametrize(
    ("dpv1", "message"),
    [
        (
            '{ alarms = ["diagnostic"] }',
            "alarms lacks process, but its GSD file says Process_Alarm_required = 1; add it",
        ),
        ('{ alarms = ["update", "process"] }', "alarms holds update, but its GSD file says Update_Alarm_supp = 0"),
        ("{ alarm_mode = 3 }", "alarm_mode 3 is 8 alarms at a time, its GSD file says Alarm_Sequence_Mode_Count = 4"),
    ],
)
def test_alarms_that_the_gsd_file_excludes(tmp_path: Path, dpv1: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message.replace(".", r"\.")):
        setup_of(tmp_path, dpv1)


@pytest.mark.parametrize(
    ("dpv1", "sent"),
    [
        ("true", "80 48 00"),  # kinds that it requires, and kinds that its parameters enable
        ('{ alarms = ["process", "diagnostic"], alarm_mode = 2 }', "80 60 02"),
    ],
)
def test_enabled_alarms_in_dpv1_status(tmp_path: Path, dpv1: str, sent: str) -> None:
    setup = setup_of(tmp_path, dpv1)
    assert setup.user_octets(None).hex(" ") == sent
    assert setup.dpv1 is not None
    assert setup.dpv1.extra_alarm_sap
