"""Slaves that demand isochronous mode: plan, refusal with the figure of the port, ``why``; blocks in Set_Prm."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest
from api_kit import RAW, bus_of, stack_of

import dpstack
from dpstack.api.bus.compose import plan_bus
from dpstack.api.config.config import make_config
from dpstack.phy.patience import Lateness
from dpstack.units import NS_PER_MS

pytestmark = pytest.mark.virtual_time

#: the block of VPC3+S, figure 7-22, with a DP cycle of 1 ms: T_BASE_DP 1500 (125 us), T_DP 8, T_MAPC 1, T_PLL_W 12
ISOM = {"type": "isochronous", "t_base_dp": 1500, "t_dp": 8, "t_pll_w": 12}
TABLE: dict[str, Any] = {"name": "axis", "address": 9, "ident": 0x1234, "config": "31", "user_prm": "00 00 10"}


def axis(*blocks: dict[str, Any], status_3: str = "10") -> dict[str, Any]:
    return TABLE | {"user_prm": f"80 00 {status_3}", "dpv1": {"blocks": list(blocks)}}


def notes(*slaves: dict[str, Any], port: str = "virtual", **bus: object) -> list[str]:
    return list(plan_bus(make_config(port, 500_000, 2, slaves, bus=bus)).notes)


async def fault_of(bus: dpstack.Bus, kept: Callable[[], bool]) -> str:
    await bus.until(kept, 20)
    fault = bus.slave(9).fault
    assert fault is not None
    assert fault.kind.value == "isochronous"
    return fault.text


async def test_it_is_refused_and_the_others_go_on() -> None:
    told: list[str] = []

    def note(event: dpstack.Event) -> None:
        if isinstance(event, dpstack.events.SlaveFaulted):
            told.append(event.text)

    async with bus_of(axis(ISOM), RAW | {"address": 11}, on_event=note) as bus:
        await bus.operate()
        text = await fault_of(bus, lambda: bus.slave(9).fault is not None)
        assert text == (
            "demands isochronous mode (its Set_Prm has a block of type 4 (isochronous)): its clock telegram may be 1 "
            "us off (T_PLL_W); this bus is simulated, and its master has no such mode either; it needs a master with "
            "isochronous mode, or parameters without it, if the device can work so"
        )
        await bus.slave("raw").ready()
        story = await bus.why("axis")
        assert story.causes[0].cause == "isochronous"
        await asyncio.sleep(3)  # asked again, and reported once
    assert len(told) == 1


async def test_the_port_is_measured_first_and_the_figure_is_in_the_refusal() -> None:
    bus = bus_of(axis(ISOM), baud=19_200)
    context = stack_of(bus).master.context
    late = [Lateness(21 * NS_PER_MS)]
    context.lateness = lambda: late[0]
    faults: list[str] = []
    async with bus:
        await bus.until(lambda: bus.slave(9).state is dpstack.SlaveState.DIAGNOSIS, 5)
        await asyncio.sleep(0.5)
        assert bus.slave(9).state is dpstack.SlaveState.DIAGNOSIS
        late[0] = Lateness(1_300_000, answers=1_000)
        faults.append(await fault_of(bus, lambda: bus.slave(9).fault is not None))
        late[0] = Lateness(1_400_000, answers=9_000)
        await asyncio.sleep(3)
        faults.append(await fault_of(bus, lambda: True))
    assert faults[0] == faults[1]
    assert "this port is up to 1.3 ms late in 999 of 1000 cases (measured of 1000 answers)" in faults[0]


async def test_a_port_that_cannot_be_measured_is_named_by_its_kind() -> None:
    bus = bus_of(axis(ISOM), baud=19_200)
    stack_of(bus).master.context.lateness = lambda: Lateness(21 * NS_PER_MS)
    async with bus:
        text = await fault_of(bus, lambda: bus.slave(9).fault is not None)
        assert "this port is up to 21 ms late in 999 of 1000 cases (not measured: that of its kind)" in text


@pytest.mark.parametrize(
    ("table", "why", "window"),
    [
        (axis(ISOM), "its Set_Prm has a block of type 4 (isochronous)", "1 us"),
        (axis(ISOM | {"t_pll_w": 6}), "its Set_Prm has a block of type 4 (isochronous)", "0.5 us"),
        (TABLE | {"user_prm": "80 00 10", "dpv1": True}, "IsoM_Req is set in its DPV1_Status_3", "1 us"),
    ],
)
async def test_the_plan_says_the_demand(table: dict[str, Any], why: str, window: str) -> None:
    (note,) = [note for note in notes(table) if "it demands" in note]
    assert note.startswith(f"slave 9 (axis): it demands isochronous mode ({why})")
    assert f"may be {window} us off (T_PLL_W)".replace("us us", "us") in note
    assert not [note for note in notes(RAW) if "isochronous" in note]


async def test_a_gsd_file_that_requires_it_demands_it(tmp_path: Any) -> None:
    path = tmp_path / "axis.gsd"
    path.write_text(
        '#Profibus_DP\nGSD_Revision = 4\nVendor_Name = "Maker"\nModel_Name = "Axis"\nRevision = "1"\n'
        "Ident_Number = 0x1234\nProtocol_Ident = 0\nStation_Type = 0\n500_supp = 1\nMaxTsdr_500 = 100\n"
        'Isochron_Mode_supp = 1\nIsochron_Mode_required = 1\nModule = "in" 0x10\n1\nEndModule\n',
        encoding="latin-1",
    )
    table = {"name": "axis", "address": 9, "gsd": str(path), "modules": ["in"]}
    (note,) = [note for note in notes(table) if "it demands" in note]
    assert "its GSD file says Isochron_Mode_required = 1" in note


async def test_wrong_blocks_are_in_the_plan() -> None:
    wrong = axis(
        {"type": "isochronous", "t_base_dp": 1000, "t_dp": 1, "t_mapc": 15, "t_pll_w": 0},
        {"type": "prm_cmd", "function": 0x0C, "properties": 0x10},
        status_3="00",
    )
    said = [note.partition("its Set_Prm: ")[2] for note in notes(wrong) if "its Set_Prm: " in note]
    assert said == [
        "block of type 4 (isochronous): T_BASE_DP 1000: 375, 750, 1500, 3000, 6000, 12000 are possible",
        "block of type 4 (isochronous): a DP cycle (T_DP) of 83.3333 us: 500 us to 32 ms are possible",
        "block of type 4 (isochronous): T_MAPC 15: 1 to 14 DP cycles are possible",
        "block of type 4 (isochronous): T_PLL_W 0: the window of the PLL has 1/12 us at least",
        "block of type 2 (prm_cmd): it starts and stops MS1 at once",
        "block of type 2 (prm_cmd): reserved bits 0x10 in its properties",
        "a block of type 4 (isochronous), but IsoM_Req (DPV1_Status_3, bit 4) is not set",
        "a block of type 2 (prm_cmd), but PrmCmd (DPV1_Status_3, bit 7) is not set",
    ]


def clocked(interval: int) -> dict[str, Any]:
    block = {"type": "time_ar", "clock_sync_interval": interval}
    return TABLE | {"user_prm": "80 00 00", "dpv1": {"blocks": [block]}}


async def test_intervals_of_the_clock_that_do_not_suit() -> None:
    (none,) = notes(clocked(1000))
    assert "expects the time every 10 s, and this master sends none: give clock_sync_s = 10 in [bus]" in none
    (long,) = notes(clocked(500), clock_sync_s=10)
    assert "clock_sync_s = 10 is longer" in long
    assert "give clock_sync_s = 1, or clock_sync_interval = 1000 in its block" in long
    assert notes(clocked(1000), clock_sync_s=10) == []


@pytest.mark.parametrize(
    ("vendor", "interval", "said"),
    [
        ("AUMA Riester", 5, "it accepts the time every 1, 10, 60, 600 s (AUMA AC 01.2 manual, p48)"),
        ("AUMA Riester", 10, ""),
        ("Siemens SIPROTEC", 16, "it accepts the time every 1 to 15, 17 to 20, 26 to 30, 50.05 to 61.95 s"),
        ("Siemens SIPROTEC", 60, ""),
        ("Maker", 16, ""),
    ],
)
async def test_intervals_that_known_devices_accept(tmp_path: Any, vendor: str, interval: int, said: str) -> None:
    path = tmp_path / "one.gsd"
    path.write_text(
        f'#Profibus_DP\nGSD_Revision = 3\nVendor_Name = "{vendor}"\nModel_Name = "One"\nRevision = "1"\n'
        "Ident_Number = 0x1234\nProtocol_Ident = 0\nStation_Type = 0\n500_supp = 1\nMaxTsdr_500 = 100\n"
        'Module = "in" 0x10\n1\nEndModule\n',
        encoding="latin-1",
    )
    table = {"name": "one", "address": 9, "gsd": str(path), "modules": ["in"]}
    found = [note for note in notes(table, clock_sync_s=interval) if "clock_sync_s" in note]
    assert bool(found) is bool(said)
    assert said in "".join(found)
