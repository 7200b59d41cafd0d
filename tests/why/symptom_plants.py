"""Plants of docs/how-to/symptoms.md: the trouble of each symptom in virtual time, and the text that dpstack has for it.

``python tests/why symptoms`` writes the texts into the page anew; ``show`` after it prints them.
"""

from __future__ import annotations

import contextlib
import io
import json
import re
import tempfile
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Final

from fake_adapter import plug_in
from faults import devices

import dpstack
from dpstack.api.config.config import slave_config
from dpstack.api.doctor import Computer, Grade, examine
from dpstack.cli.main import main
from dpstack.dp.slave.application import SlaveApp
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.fdl.interface import Reply
from dpstack.fdl.telegram import SAP_SET_PRM, Resp, Telegram
from dpstack.ports.adapters import Abilities
from dpstack.units import BAUD_RATES
from dpstack.why.story import story_lines
from tests.why.fault_plants import TERMINAL, Plant, bring

PAGE: Final = Path(__file__).parents[2] / "docs" / "how-to" / "symptoms.md"
#: mark and text of the blocks that the plants give
BLOCK: Final = re.compile(r"(<!-- symptom: ([\w-]+) -->\n```text\n)(.*?)(?=^```)", re.DOTALL | re.MULTILINE)
GATEWAY: Final = """\
#Profibus_DP
GSD_Revision = 3
Vendor_Name = "Example"
Model_Name = "Gateway"
Revision = "1.0"
Ident_Number = 0x0B69
Protocol_Ident = 0
Station_Type = 0
Hardware_Release = "1"
Software_Release = "1"
FMS_supp = 0
500_supp = 1
MaxTsdr_500 = 100
DPV1_Slave = 1
Modular_Station = 1
Max_Module = 4
Max_Input_Len = 8
Max_Output_Len = 8
Max_Data_Len = 16
Slave_Family = 9
Unit_Diag_Bit(0) = "Host lost"
PrmText = 1
Text(0) = "off"
Text(1) = "on"
EndPrmText
ExtUserPrmData = 1 "Fail safe"
Bit(0) 0 0-1
Prm_Text_Ref = 1
EndExtUserPrmData
ExtUserPrmData = 2 "Mode"
BitArea(0-2) 1 0-3
EndExtUserPrmData
Max_User_Prm_Data_Len = 5
Ext_User_Prm_Data_Const(0) = 0x80,0x00,0x00,0x00,0x00
Ext_User_Prm_Data_Ref(3) = 1
Ext_User_Prm_Data_Ref(4) = 2
Module = "1 Byte In" 0x10
1
EndModule
Module = "1 Byte Out" 0x20
2
EndModule
"""
IO: Final = {"name": "io", "address": 8, "gsd": "io-station"}
VALVES: Final = {"name": "valves", "address": 8, "ident": 0x0A35, "config": "21"}
FLOW: Final = {"name": "flow", "address": 9, "ident": 0x1234, "config": "20 10"}
SECOND: Final = {"name": "mixer", "address": 10, "ident": 0x4321, "config": "21 11"}


def plant_of(*tables: dict[str, object], baud: int = 500_000, there: bool = True) -> Plant:
    """The first table is the slave asked about, the others are healthy; ``there``: so is the first one."""
    plant = Plant("symptom", 1, [], rates=(baud,))
    plant.address = 2
    plant.tables = [dict(table) for table in tables]
    plant.name = str(tables[0]["name"])
    for table in plant.tables[0 if there else 1 :]:
        unit = plant.there(table, t_sdr=20)
        if table is plant.tables[0]:
            plant.asked = unit
    return plant


def is_really(app: SlaveApp | MirrorDevice, *tables: dict[str, object]) -> Plant:
    """The slave asked about, ``tables[0]``, is ``app``."""
    plant = plant_of(*tables, there=False)
    plant.asked_unit(app, t_sdr=20)
    return plant


def rack(*modules: str, configured: tuple[str, ...]) -> Plant:
    there = slave_config({**IO, "modules": list(modules)}).params
    return is_really(MirrorDevice(there.ident or 0, there.config), {**IO, "modules": list(configured)}, FLOW)


def no_dpv1() -> Plant:
    """The GSD file asks for DP-V1, and the parameters do not have it."""
    table = {"name": "gate", "address": 8, "gsd": TERMINAL, "modules": ["8 DI", "8 DO"]}
    octets = bytearray(slave_config(table).params.user_prm)
    octets[0] &= 0x7F
    params = slave_config(table).params
    device = devices.NeedsDpV1(params.ident or 0, params.config)
    return is_really(device, {**table, "user_prm": octets.hex(" "), "dpv1": False}, FLOW)


class NoResources(SlaveApp):
    """Answers Data_Exchange with RR."""

    def serve(self, request: Telegram, now: int) -> Reply | None:
        reply = super().serve(request, now)
        return Reply(Resp.RR) if request.dsap is None and reply is not None else reply


def watchdog_short() -> Plant:
    big = [{"name": f"rack {at}", "address": at, "ident": 0x2000 + at, "config": "3F 3F"} for at in range(20, 26)]
    plant = plant_of({**VALVES, "watchdog_ms": 20}, *big, baud=93_750)
    plant.least_s = 4.0
    return plant


def wrong_rate() -> Plant:
    plant = plant_of(FLOW, SECOND, baud=45_450, there=False)
    for unit in list(plant.units):
        plant.unplug(unit)
    for table in plant.tables:
        plant.there(table, baud=93_750)
    return plant


def other_address() -> Plant:
    plant = plant_of(FLOW, SECOND, there=False)
    plant.real({**FLOW, "address": 19}, t_sdr=20)
    return plant


def two_at_one_address() -> Plant:
    plant = plant_of(FLOW, SECOND)
    plant.unit(MirrorDevice(0x1234, bytes.fromhex("2010")), 9, t_sdr=35, label="twin")
    plant.stretch = 2
    return plant


def noise_on_stub() -> Plant:
    plant = plant_of(FLOW, SECOND, VALVES)
    plant.world.faults.damage(devices.Share(plant.rng, 0.4, 9), times=None, flips=0x006)
    plant.stretch = 2
    return plant


def noise_on_segment() -> Plant:
    plant = plant_of(FLOW, SECOND, VALVES)
    plant.world.faults.noise(2e-3)
    plant.stretch = 2
    return plant


def locked() -> Plant:
    plant = plant_of(FLOW, SECOND)
    plant.other_master(plant.slave.params, address=1)
    plant.until_taken()
    return plant


def low_hsa() -> Plant:
    plant = plant_of(FLOW, SECOND)
    plant.address = 7
    plant.other_master(address=1, hsa=5)
    plant.run(200)
    return plant


def late_answers() -> Plant:
    plant = plant_of(FLOW, SECOND)
    plant.bus_keys |= {"t_sl": 600, "hsa": 126, "gap": 1}
    params = plant.open().params
    plant.world.faults.delay(devices.Share(plant.rng, 0.6, 9), params.ns(round(params.t_sl * 1.1)), times=None)
    plant.stretch = 9
    return plant


PLANTS: Final[dict[str, Callable[[], Plant]]] = {
    "module-missing": lambda: rack("8 DI", "8 DO", configured=("8 DI", "16 DI", "8 DO")),
    "module-order": lambda: rack("8 DO", "8 DI", configured=("8 DI", "8 DO")),
    "ident": lambda: is_really(MirrorDevice(0x80E0, b"\x20\x10"), FLOW, SECOND),
    "parameter": lambda: is_really(
        devices.Picky(0x1234, b"\x20\x10", b"\0\1"), {**FLOW, "user_prm": "00 00 00"}, SECOND
    ),
    "dpv1": no_dpv1,
    "outputs-only": lambda: plant_of(VALVES, FLOW),
    "no-resources": lambda: is_really(NoResources(MirrorDevice(0x1234, b"\x20\x10")), FLOW, SECOND),
    "service-refused": lambda: is_really(
        devices.RefusesService(MirrorDevice(0x1234, b"\x20\x10"), SAP_SET_PRM), FLOW, SECOND
    ),
    "watchdog": watchdog_short,
    "rate": wrong_rate,
    "not-there": lambda: plant_of(FLOW, SECOND, there=False),
    "other-address": other_address,
    "twin": two_at_one_address,
    "stub": noise_on_stub,
    "segment": noise_on_segment,
    "locked": locked,
    "low-hsa": low_hsa,
    "late": late_answers,
}


async def why(plant: Plant) -> str:
    """What ``dpstack why`` prints of it, 84 columns wide, without the steps: the likeliest cause."""
    async with bring(plant) as bus:
        story = (await bus.why(plant.name)).as_dict()
    story["causes"] = story["causes"][:1]  # type: ignore[index]
    return "\n".join(story_lines(story, 84, steps=False)) + "\n"


def printed(*words: str) -> str:
    """The output of a command."""
    with contextlib.redirect_stdout(io.StringIO()) as out:
        main(words)
    return out.getvalue()


def checked(driver: str, usb: str, latency: int | None, **can: bool) -> str:
    """The findings of ``dpstack doctor`` at an adapter that can do ``can``, as a user sees them."""
    with tempfile.TemporaryDirectory() as folder:
        port = Path(folder) / "ttyS0"
        port.touch()
        plug_in(Path(folder), port.name, usb, driver, latency)
        computer = Computer(
            platform="linux",
            probe=lambda path: Abilities(**can, low_latency=True, counters=True, marks=True, rates=[*BAUD_RATES]),
            is_root=True,
            access=lambda path, mode: path == str(port),
            sysfs=Path(folder),
            proc=Path(folder),
        )
        checks = [check for check in examine(str(port), computer) if check.level is Grade.FINDING]
    name = "/dev/ttyUSB0" if usb else "/dev/ttyS0"
    return "".join(f"{check.level.value:7}  {name}: {check.text}\n         {check.todo}\n" for check in checks)


def gateway(*words: str) -> str:
    """What ``dpstack gsd`` prints of a file with the lines of the symptom."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        Path("gateway.gsd").write_text(GATEWAY, encoding="latin-1")
        return printed("gsd", *words, "gateway.gsd")


def planned() -> str:
    """The note of ``dpstack plan`` about a USB adapter."""
    lines = ["[bus]", 'port = "/dev/ttyUSB0"', "baud = 6000000", "cycle_ms = 2", "[[slave]]"]
    lines += [f"{key} = {json.dumps(value)}" for key, value in VALVES.items()]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plant.toml"
        path.write_text("\n".join(lines), encoding="utf-8")
        text = printed("plan", str(path))
    note = next(line for line in text.splitlines() if "over a USB adapter" in line)
    return textwrap.fill(note, 84) + "\n"


TEXTS: Final[dict[str, Callable[[], str]]] = {
    "answers": lambda: printed("decode", "E5", "10 02 05 02 09 16", "10 02 08 03 0D 16"),
    "gsd-check": lambda: gateway("check"),
    "gsd-parameters": lambda: gateway("show").partition("Parameters (2)\n")[2].partition("Texts")[0],
    "usb-cycle": planned,
    "latency": lambda: checked("ftdi_sio", "0403:6001", 16, parity=True),
    "no-parity": lambda: checked("bcm2835-aux-uart", "", None, parity=False),
}


def text_of(name: str) -> str:
    return TEXTS[name]() if name in TEXTS else dpstack.run_virtual(why(PLANTS[name]()))


def write(words: list[str]) -> None:
    if words == ["show"]:
        for name in (*PLANTS, *TEXTS):
            print(f"--- {name}\n{text_of(name)}")
    else:
        page = PAGE.read_text(encoding="utf-8")
        PAGE.write_text(BLOCK.sub(lambda match: match[1] + text_of(match[2]), page), encoding="utf-8")
