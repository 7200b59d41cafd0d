"""The plan of a configuration: cycle, other masters, GSD facts, and what is refused before the bus is opened."""

from __future__ import annotations

import asyncio
import json
from dataclasses import dataclass
from pathlib import Path

import pytest
from api_kit import HOIST, RAW, bus_of, in_operate, stack_of
from gsd_kit import FILES
from ms1_kit import MS, OctetMs1Slave
from ring_bus import RingBus

import dpstack
from dpstack.api.bus.compose import plan_bus
from dpstack.api.bus.plan_checks import CycleVerdict, cycle_rates
from dpstack.api.config.config import Config, parse_config
from dpstack.cli.main import main
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.master import Master
from dpstack.dp.master.settings import MasterSettings
from dpstack.dp.plan.rotation_time import Case
from dpstack.errors import ConfigError
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.stats import Histogram
from dpstack.units import NS_PER_MS

pytestmark = pytest.mark.virtual_time

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
BUS = '[bus]\nport = "virtual"\nbaud = 500000\n'
SLAVE = '[[slave]]\nname = "raw"\naddress = 9\nident = 0x1234\nconfig = "20 10"\n'


def config(bus: str = "", slave: str = "", *, port: str = "virtual") -> Config:
    return parse_config(BUS.replace("virtual", port) + bus + SLAVE + slave, "plant.toml")


def refused(found: Config) -> str:
    with pytest.raises(ConfigError) as caught:
        dpstack.open_bus(found)
    return str(caught.value)


# --- refused before anything is opened, with file and line -----------------------------------------------------------


def test_a_cycle_shorter_than_possible() -> None:
    # SD2 with one octet each way, T_SDR 11, T_ID1 37; token 33 and T_ID1: 338 bit times
    found = config("cycle_ms = 0.5\n")
    assert refused(found) == (
        "plant.toml:4: [bus]: cycle_ms = 0.5 is shorter than possible: the shortest rotation with 1 slave takes "
        "0.676 ms at 500 kbit/s; take cycle_ms = 0.676 or more, or a faster rate (1.5 Mbit/s would do)"
    )
    assert refused(config("cycle_ms = 0.01\n")).endswith("take cycle_ms = 0.676 or more, or a faster rate")
    (finding, *_) = plan_bus(found).findings
    assert finding.startswith("cycle_ms = 0.5 is shorter than possible: ")


def test_an_interval_and_a_watchdog_that_do_not_fit_name_the_slave() -> None:
    assert refused(config("cycle_ms = 4\n", "min_slave_interval = 100\n")) == (
        "plant.toml:5: slave 9 (raw): its Min_Slave_Interval of 10 ms is longer than cycle_ms = 4; "
        "give it every = 3, or take cycle_ms = 10"
    )
    assert refused(config("cycle_ms = 4\n", "every = 10\nwatchdog_ms = 30\n")) == (
        "plant.toml:5: slave 9 (raw): its watchdog of 30 ms is shorter than cycle_ms = 4 x every = 10 (40 ms): "
        "it would always trip; take watchdog_ms = 120 or more"
    )


async def test_a_slave_without_room_in_the_cycle_is_refused_while_the_bus_runs() -> None:
    long = {"name": "long", "address": 10, "ident": 1, "config": "FF FF"}
    async with bus_of(RAW, cycle_ms=1.0) as bus:
        with pytest.raises(ConfigError, match="cycle_ms = 1 is shorter than possible: the shortest rotation with 2 "):
            await bus.add_slave(long)
        with pytest.raises(ConfigError, match="cycle_ms = 1 is shorter than possible: the shortest rotation with 1 "):
            await bus.slave("raw").reparameterise(config=bytes.fromhex("FF FF"))
        assert [slave.name for slave in bus.slaves] == ["raw"]
        await bus.ready()


def test_a_usb_adapter_makes_cycles_longer() -> None:
    notes = plan_bus(config("cycle_ms = 2\n", port="/dev/ttyUSB7")).notes
    assert (
        "over a USB adapter with a latency timer of 1 ms an exchange takes 2 ms or so at any rate, a round of 1 slave "
        "3 ms: longer than cycle_ms = 2; a UART of the computer's own has no such delay" in notes
    )
    for bus, port in (("cycle_ms = 3\n", "/dev/ttyUSB7"), ("", "/dev/ttyUSB7"), ("cycle_ms = 2\n", "virtual")):
        assert not any("USB adapter" in note for note in plan_bus(config(bus, port=port)).notes)


# --- other masters ---------------------------------------------------------------------------------------------------


def test_other_masters_in_the_plan() -> None:
    alone = plan_bus(config())
    alike = plan_bus(config("other_masters = 2\n"))
    assert alike.rotations[Case.TYPICAL].bits == 3 * alone.rotations[Case.TYPICAL].bits
    listed = plan_bus(config("other_masters = [4.0, 1.5]\n"))
    assert listed.rotations[Case.SHORTEST].bits == alone.rotations[Case.SHORTEST].bits + 2000 + 750
    # what they need in bit times they need at another rate too
    faster = plan_bus(config("other_masters = [4.0, 1.5]\n"), 1_500_000)
    assert faster.rotations[Case.SHORTEST].others == 2750
    assert listed.as_dict()["masters"] == {"others": 2, "t_tr_needed": listed.figures.t_tr_needed}


def test_a_t_tr_that_is_too_small_for_all_masters() -> None:
    needed = plan_bus(config("other_masters = [4.0]\n")).figures.t_tr_needed
    assert plan_bus(config(f"other_masters = [4.0]\nt_tr = {needed}\n")).findings == ()
    (finding,) = plan_bus(config(f"other_masters = [4.0]\nt_tr = {needed - 1}\n")).findings
    assert finding.startswith(f"t_tr = {needed - 1} is too small: the longest normal round and one acyclic service ")
    assert "with 1 other master, and T_TH = T_TR - T_RR" in finding
    assert finding.endswith(f"leave t_tr out, or set it to {needed} or more on all masters")


def test_the_preset_of_t_tr_has_room_for_all_masters() -> None:
    found = config("other_masters = [300.0, 200.0]\n")
    plan = plan_bus(found)
    assert plan.params.t_tr == plan.figures.t_tr_needed > 2 * 150_000 + 100_000
    assert plan.findings == ()


# --- what a GSD file says --------------------------------------------------------------------------------------------


def test_an_interval_shorter_than_the_slave_needs_is_told() -> None:
    text = BUS + '[[slave]]\nname = "hoist"\naddress = 3\ndrive = "demag-dedrive"\nmin_slave_interval = 0\n'
    assert plan_bus(parse_config(text)).notes == (
        "slave 3 (hoist): min_slave_interval = 0 (0 ms) is shorter than the 0.1 ms of demag-dedrive "
        "(Min_Slave_Intervall): it may not follow; leave it out",
    )
    assert plan_bus(parse_config(text.replace("= 0\n", "= 1\n"))).notes == ()


def test_facts_of_the_gsd_file(tmp_path: Path) -> None:
    gsd = tmp_path / "io.gsd"
    gsd.write_text(
        '#Profibus_DP\nGSD_Revision = 1\nIdent_Number = 0x1234\nModel_Name = "IO"\nVendor_Name = "X"\n'
        "500_supp = 1\nMaxTsdr_500 = 100\nMin_Slave_Intervall = 20\nMax_Diag_Data_Len = 8\n"
        'Modular_Station = 0\nModule = "all" 0x10, 0x20\nEndModule\n',
        encoding="utf-8",
    )
    slave = f'[[slave]]\nname = "io"\naddress = 8\ngsd = "{gsd}"\n'
    plan = plan_bus(parse_config(BUS + slave))
    (planned,) = plan.slaves
    assert (planned.setup.max_diag_len, planned.setup.min_slave_interval_ns) == (8, 2 * NS_PER_MS)
    # the same slave without the file: its diagnosis may have 244 octets
    raw = plan_bus(parse_config(BUS + SLAVE))
    assert raw.rotations[Case.LONGEST].work - plan.rotations[Case.LONGEST].work == (244 - 8) * 11
    hurried = plan_bus(parse_config(BUS + slave + "min_slave_interval = 5\n"))
    assert any("min_slave_interval = 5 (0.5 ms) is shorter than the 2 ms of its GSD file" in n for n in hurried.notes)


# --- the rate a cycle needs ------------------------------------------------------------------------------------------


def test_rates_that_a_slave_does_not_know_do_not_count() -> None:
    """The Demag does not know 31.25 kbit/s; raw slaves know all."""
    drive = parse_config(BUS + '[[slave]]\nname = "hoist"\naddress = 3\ndrive = "demag-dedrive"\ntelegram = "PPO3"\n')
    raw = parse_config(BUS + '[[slave]]\nname = "hoist"\naddress = 3\nident = 1\nconfig = "71"\n')
    cycle = 20 * NS_PER_MS
    assert cycle_rates(raw, cycle)[CycleVerdict.POSSIBLE] == 31_250
    assert cycle_rates(drive, cycle)[CycleVerdict.POSSIBLE] == 45_450
    fixed = parse_config(BUS + "t_sl = 100\n" + SLAVE)  # impossible where max T_SDR is longer
    assert cycle_rates(fixed, NS_PER_MS)[CycleVerdict.POSSIBLE] is None
    assert cycle_rates(fixed, 5 * NS_PER_MS)[CycleVerdict.POSSIBLE] == 93_750


# --- the manual's 1 to 2 ms ------------------------------------------------------------------------------------------


async def test_the_manuals_rotation_in_virtual_time() -> None:
    async with in_operate(dpstack.open_bus(EXAMPLES / "two_milliseconds.toml")) as bus:
        master = stack_of(bus).master
        master.rotation = Histogram()
        await asyncio.sleep(0.5)
        seen = master.rotation
        assert seen.count > 200
        assert abs(seen.min_ns - bus.plan.rotation_ns(Case.SHORTEST)) <= bus.params.ns(11)
        assert 1_000_000 < seen.min_ns < seen.quantile_ns(0.99) < 2_000_000
        assert [slave.state for slave in bus.slaves] == [dpstack.SlaveState.DATA_EXCHANGE] * 5
        assert bus.stats.bad == {}


async def test_a_hoist_on_a_bus_with_a_cycle_is_planned_like_any_other() -> None:
    async with bus_of(HOIST, cycle_ms=20.0) as bus:
        assert bus.plan.cycle is not None
        assert bus.plan.cycle.verdict is CycleVerdict.UNDISTURBED


def test_a_gsd_file_beside_the_drive_shortens_the_worst_case_by_its_diagnosis() -> None:
    """The file that comes with the plugin says Max_Diag_Data_Len; without one 244 octets are counted."""
    drive = BUS + '[[slave]]\nname = "hoist"\naddress = 3\ndrive = "demag-dedrive"\n'
    alone, beside = (plan_bus(parse_config(drive + more)) for more in ("", 'gsd = "demag-dedrive"\n'))
    said = beside.slaves[0].setup.max_diag_len
    assert (alone.slaves[0].setup.max_diag_len, said) == (None, 6)
    assert said is not None
    assert alone.rotations[Case.SHORTEST] == beside.rotations[Case.SHORTEST]
    saved = alone.rotations[Case.LONGEST].bits - beside.rotations[Case.LONGEST].bits
    assert saved == (244 - said) * 11
    assert beside.slaves[0].setup.config == alone.slaves[0].setup.config


# --- The octets of Set_Prm and Chk_Cfg that ``plan`` tells are those that a slave of octets receives on the wire ----


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
