"""The octets of Set_Prm and Chk_Cfg that ``plan`` tells are those that a slave of octets receives on the wire."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import pytest
from gsd_kit import FILES
from ms1_kit import MS, OctetMs1Slave
from ring_bus import RingBus

from dpstack.api.bus.compose import plan_bus
from dpstack.api.config.config import parse_config
from dpstack.cli.main import main
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.master import Master
from dpstack.dp.master.settings import MasterSettings
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline

PLANT = f"""
[bus]
port = "virtual"
baud = 500000
[[slave]]
name = "io"
address = 8
gsd = "{FILES}/whole.gsd"
modules = ["8 DI", "8 DO"]
parameters = {{ "Delay" = 51 }}
watchdog_ms = 45
groups = [1, 8]
sync = true
[[slave]]
name = "rack"
address = 5
gsd = "{FILES}/rack.gsd"
modules = ["6ES7 321-1BH00-0AA0 16DI", "", 10]
watchdog_ms = 0
[[slave]]
name = "hoist"
address = 3
drive = "demag-dedrive"
[[slave]]
name = "asked"
address = 4
ident = "ask"
config = "10 20"
user_prm = "00 FF"
watchdog_ms = 0
"""


@dataclass
class Received(OctetMs1Slave):
    """Keeps Chk_Cfg, too."""

    cfg: bytes = b""

    def service(self, octets: bytes) -> bytes | None:
        if octets[7] == 62:
            self.cfg = octets[9:-2]
        return super().service(octets)


def test_the_plan_tells_the_octets_that_slaves_receive() -> None:
    config = parse_config(PLANT, "plant.toml")
    plan = plan_bus(config)
    told = {slave.setup.address: (slave.set_prm, slave.chk_cfg) for slave in plan.slaves}
    bus = RingBus(500_000, "whole")
    slaves = {
        address: Received(bus, address, ident=bytes.fromhex(ident))
        for address, ident in ((8, "1A2B"), (3, "0696"), (4, "BEEF"), (5, "0FFE"))
    }
    master = Master(plan.params, config.slave_params, MasterSettings(watchdog_ms=plan.watchdog_ms))
    station = ActiveStation(plan.params, [master])
    bus.stations.append(station)
    bus.command(station, GoOnline())
    for _ in range(3_000):
        if all(slave.cfg for slave in slaves.values()):
            break
        bus.run(MS)
    received = {address: (slave.prm.hex(), slave.cfg.hex()) for address, slave in slaves.items()}
    prm, cfg = told.pop(4)
    assert (prm, cfg) == ("80" + "0101" + "0b" + "...." + "00" + "00ff", "1020")
    assert received.pop(4) == (prm.replace("....", "beef"), cfg)
    assert received == told
    # Lock_Req, Sync_Req, WD_On; 1 x 45 of 1 ms; min T_SDR; groups; DPV1_Enable, Fail_Safe, WD_Base_1ms; Process_Alarm
    assert told[8] == ("a8" + "012d" + "0b" + "1a2b" + "81" + "c44000" + "0800" + "010033", "1020")
    # a fixed preset in slot 2; the modules in slots 3 and 5 have the numbers of their slots, then Filter = 3
    assert told[5] == ("80" + "0101" + "0b" + "0ffe" + "00" + "0003" + "0303" + "0503", "00" + "11" + "00" + "11")
    assert all(handler.state is not SlaveState.FAULT for handler in master.handlers.values())


def test_plan_shows_them(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    plant = tmp_path / "plant.toml"
    plant.write_text(PLANT, encoding="utf-8")
    assert main(["plan", str(plant), "--json"]) == 0
    slaves = {slave["address"]: slave for slave in json.loads(capsys.readouterr().out)["slaves"]}
    assert (slaves[4]["set_prm"], slaves[4]["chk_cfg"]) == ("8001010b....0000ff", "1020")
    assert main(["plan", str(plant)]) == 0
    assert "Set_Prm" not in capsys.readouterr().out
    assert main(["plan", str(plant), "--octets"]) == 0
    out = capsys.readouterr().out.splitlines()
    assert "Set_Prm of slave 4 (asked): 80 01 01 0B .. .. 00 00 FF" in out
    assert "Chk_Cfg of slave 8 (io): 10 20" in out
    assert "..: an octet of the ident number, which the slave is asked for" in out
    assert main(["plan", str(plant), "--octets", "--baud", "all"]) in (0, 1)
    assert "1.5 Mbit/s: Chk_Cfg of slave 8 (io): 10 20" in capsys.readouterr().out
