"""DPV1_Status, blocks and the response time-out changed while the bus runs: ``slave.reparameterise(dpv1=...)``."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from api_kit import bus_of, mirror, operating, serving
from support import WorldFactory

import dpstack
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dp.pdu.prm_blocks import PrmBlock
from dpstack.errors import ConfigError, UsageError
from dpstack.sim.world import World
from dpstack.units import NS_PER_MS

pytestmark = pytest.mark.virtual_time

FILES = Path(__file__).parents[2] / "gsd" / "files"


@contextlib.asynccontextmanager
async def rig(world: World, sent: list[str], **keys: Any) -> AsyncIterator[dpstack.Slave]:
    """A slave in data exchange to the end; ``sent`` gets the user parameters of each Set_Prm, as hex."""

    async def read(slot: int, index: int) -> bytes:
        return bytes((slot, index))

    def on_prm(user_prm: bytes) -> None:
        sent.append(user_prm.hex(" "))

    async with serving(mirror(on_read=read, on_prm=on_prm), world, **keys) as (bus, _):
        slave = bus.slave(9)
        slave.outputs = b"\x42"
        yield slave
        assert (slave.ready_now, slave.outputs) == (True, b"\x42")


async def test_dpv1_switched_on_changed_and_switched_off(world: WorldFactory) -> None:
    sent: list[str] = []
    async with rig(world(), sent, dpv1=False) as slave:
        with pytest.raises(UsageError, match="not parameterised for DP-V1"):
            await slave.read(1, 2)
        await slave.reparameterise(dpv1=True)
        assert await slave.read(1, 2) == b"\x01\x02"
        table: Mapping[str, object] = {
            "alarms": ["process", "diagnostic"],
            "alarm_mode": 3,
            "check_cfg_mode": True,
            "prm_cmd": True,
            "response_timeout_ms": 70,
            "blocks": [{"type": 0x81, "slot": 4, "data": "AA BB"}],
        }
        await slave.reparameterise(dpv1=table, watchdog_ms=400)
        assert slave.setup.dpv1 == Dpv1(
            check_cfg_mode=True,
            prm_cmd=True,
            alarms=("process", "diagnostic"),
            alarm_mode=3,
            blocks=(PrmBlock(0x81, 4, b"\xaa\xbb"),),
            c1_response_timeout_ns=70 * NS_PER_MS,
        )
        assert slave.watchdog_ms == 400
        assert await slave.read(3, 4) == b"\x03\x04"
        await slave.reparameterise(dpv1={"alarms": []})  # a table replaces all settings
        assert slave.setup.dpv1 == Dpv1(alarms=())
        await slave.reparameterise(user_prm=b"\x04\x41\x01")
        await slave.reparameterise(dpv1=False)
        with pytest.raises(UsageError, match="not parameterised for DP-V1"):
            await slave.read(1, 2)
        await slave.reparameterise(user_prm=b"\x80\0\0", dpv1=None)  # as if the key were absent
        assert await slave.read(5, 6) == b"\x05\x06"
    assert sent == [
        "00 00 00",
        "80 00 00",
        "80 61 8b 06 81 04 00 aa bb",
        "80 00 00",
        "84 01 01",
        "04 41 01",
        "80 00 00",
    ]


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"alarm_mode": 8}, r"slave 9 \(rig\).*alarm_mode = 8 is outside 0\.\.7"),
        ({"alarm": 1}, "unknown key 'alarm'; did you mean 'alarms'"),
        ({"alarms": ["fire"]}, "it is a list of these: pull_plug, process"),
        ({"blocks": [{"type": 1, "data": "00" * 230}, {"type": 1}]}, "octets of user parameters with its blocks"),
        (1, "dpv1 = 1 is an integer; it must be a table"),
    ],
)
async def test_a_refused_change_changes_nothing(world: WorldFactory, given: Any, text: str) -> None:
    sent: list[str] = []
    async with rig(world(), sent) as slave:
        with pytest.raises(ConfigError, match=text):
            await slave.reparameterise(dpv1=given)
        with pytest.raises(ConfigError, match="three DPV1_Status octets, 1 are there"):
            await slave.reparameterise(dpv1=True, user_prm=b"\0")
        assert slave.setup.dpv1 == Dpv1()
    assert sent == ["80 00 00"]


async def test_a_change_that_the_gsd_file_excludes() -> None:
    async with bus_of({"name": "told", "address": 8, "gsd": str(FILES / "slots.gsd")}) as bus:
        await bus.ready()
        with pytest.raises(ConfigError, match="its GSD file says DPV1_Slave = 0"):
            await bus.slave("told").reparameterise(dpv1=True)


async def test_a_drive_plugin_keeps_its_way_to_the_parameters() -> None:
    pump: dict[str, object] = {"name": "pump", "address": 6, "drive": "ls-s100", "telegram": "ST1"}
    async with operating(pump) as bus:
        slave, drive = bus.slave("pump"), bus.drive("pump")
        with pytest.raises(UsageError, match="remove the slave and add it with another dpv1"):
            await slave.reparameterise(dpv1=False)
        await slave.reparameterise(dpv1={"response_timeout_ms": 700})
        assert await drive.read(965) == 0x0328
