"""The round trip: an export imported, planned, simulated, and a master written from octets that does what the PLC of
the export does; listening to it gives the names of the plant."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from octet_wire import Wire, framed
from step7_kit import PLANT, gsd_folder

from dpstack.api.config.config import Config, load_config
from dpstack.api.listen.names import decode_names
from dpstack.api.slave_side.virtual_bench import SimulatedSlave
from dpstack.capture.transmission import Transmission
from dpstack.cli.main import main
from dpstack.decode.telegram import explain
from dpstack.params import BusParams

#: Set_Prm of the PLC: lock, watchdog 200 ms, min T_SDR 11, ident, groups; then NORMSLAVE_PARAM_DATA of the export
SET_PRM = {
    10: "88 14 01 0B 56 78 03 00 11 22 33 44",
    12: "88 14 01 0B 80 1D 00",
    14: "88 14 01 0B 43 21 00",
}
#: Chk_Cfg: the SLAVE_CFG_DATA of the slots; of Siemens' own slave the identifiers of its GSD file
CHK_CFG = {10: "00 53 10 20", 12: "11 57", 14: "C0 83 85"}
#: process data without a fault: outputs, inputs (a simulated slave sends its outputs back, then zeros)
EXCHANGE = {10: ("81", "81 00 00 00 00 00 00 00 00"), 12: ("", "00 " * 18), 14: ("01 02 03 04", "01 02 03 04 00 00")}


def test_import_plan_sim_and_the_octets_of_the_plc(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    export, plant = tmp_path / "plant.cfg", tmp_path / "plant.toml"
    export.write_bytes(PLANT.encode("cp1252"))
    gsd_folder(tmp_path / "gsd")
    assert main(["import", str(export), "--gsd", str(tmp_path / "gsd"), "--out", str(plant)]) == 0
    capsys.readouterr()
    assert main(["plan", str(plant), "--octets", "--json"]) == 0
    planned = json.loads(capsys.readouterr().out)
    assert {slave["address"]: slave["chk_cfg"] for slave in planned["slaves"]} == {
        address: octets.replace(" ", "").lower() for address, octets in CHK_CFG.items()
    }
    assert planned["slaves"][0]["set_prm"].endswith("56780300112233" + "44")
    config = load_config(plant)
    assert (config.bus.read_only, config.bus.address, config.bus.t_sl) == (True, 3, 300)
    for slave in config.slaves:
        check_slave(SimulatedSlave(slave, BusParams.preset(500_000)), slave.address)
    assert heard_names(config) == {
        10: {"Füllstand": 4660, "H19_N_IST": 0, "NA_INT": True, "NA_EXT": False, "H8_EBE": True, "Horn": True},
        12: {"Tor_zu": True, "T_Lager": 0, "T_Getriebe": -2},
        14: {"Lichtgitter": True},
    }


def test_a_slave_without_its_octets_takes_those_of_the_plc(tmp_path: Path) -> None:
    """Siemens' own slave, no GSD file: ident number and identifiers of the PLC, whose octets must have the lengths."""
    (tmp_path / "plant.cfg").write_bytes(PLANT.encode("cp1252"))
    assert main(["import", str(tmp_path / "plant.cfg"), "--out", str(tmp_path / "plant.toml")]) == 0
    config = load_config(tmp_path / "plant.toml")
    for slave in config.slaves:
        check_slave(SimulatedSlave(slave, BusParams.preset(500_000)), slave.address)
    wire = Wire(SimulatedSlave(config.slaves[1], BusParams.preset(500_000)).station)
    assert wire.ask(framed(0x8C, 0x82, 0x5D, f"3D 3E {SET_PRM[12]}")) == "E5"
    assert wire.ask(framed(0x8C, 0x82, 0x7D, "3C 3E")).split()[13:15] == ["80", "1D"]
    assert wire.ask(framed(0x8C, 0x82, 0x5D, "3E 3E 11 56")) == "E5"  # an octet of inputs less
    assert int(wire.ask(framed(0x8C, 0x82, 0x7D, "3C 3E")).split()[9], 16) & 0x04  # Cfg_Fault


#: what a listener hears between PLC and plant: request, answer
HEARD = {
    10: ("81", "12 34 00 00 00 00 00 00 08"),
    12: ("", "00 02 00 00 00 00 00 00 00 00 00 00 FF FE 00 00 00 00"),
    14: ("00 00 00 00", "01 00 00 00 00 00"),
}


def heard_names(config: Config) -> dict[int, dict[str, object]]:
    """The named values of an exchange with each slave, as monitor, capture and Wireshark explain it."""
    found: dict[int, dict[str, object]] = {}
    for address, (outputs, inputs) in HEARD.items():
        octets = [framed(address, 2, 0x7D, outputs), framed(2, address, 0x08, inputs)]
        line = [Transmission(bytes.fromhex(one), 1_000_000 * n, 1_500_000) for n, one in enumerate(octets, 1)]
        for one in explain(line, decode_names(config)):
            for key in ("inputs", "outputs"):
                named = one.fields.get(key, {})
                assert isinstance(named, dict)
                found.setdefault(address, {}).update(named)
    return found


def check_slave(slave: SimulatedSlave, address: int) -> None:
    wire = Wire(slave.station)
    assert wire.ask(framed(address, 2, 0x6D, "")) != "E5"  # no data exchange yet
    assert wire.ask(framed(0x80 | address, 0x82, 0x5D, f"3D 3E {SET_PRM[address]}")) == "E5"
    assert wire.ask(framed(0x80 | address, 0x82, 0x7D, f"3E 3E {CHK_CFG[address]}")) == "E5"
    diagnosis = wire.ask(framed(0x80 | address, 0x82, 0x5D, "3C 3E"))
    assert diagnosis.split()[9:11] == ["00", "0C"]  # watchdog on, no fault, no wish
    outputs, inputs = EXCHANGE[address]
    wire.ask(framed(address, 2, 0x7D, outputs))
    assert wire.ask(framed(address, 2, 0x5D, outputs)) == framed(2, address, 0x08, inputs).upper()
