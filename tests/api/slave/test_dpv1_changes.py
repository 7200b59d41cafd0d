"""DPV1_Status, blocks and the response time-out changed while the bus runs: ``slave.reparameterise(dpv1=...)``."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Mapping
from pathlib import Path
from typing import Any

import pytest
from api_kit import bus_of, in_virtual_time, virtual
from support import WorldFactory

import dpstack
from dpstack import DpSlave, SlaveDescription
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dp.pdu.prm_blocks import PrmBlock
from dpstack.errors import ConfigError, UsageError
from dpstack.sim.world import World
from dpstack.units import NS_PER_MS

FILES = Path(__file__).parents[2] / "gsd" / "files"
RIG = SlaveDescription.simple(0x1234, inputs=1, outputs=1, name="rig", dpv1=True)


def rig(world: World, program: Callable[[dpstack.Slave], Coroutine[Any, Any, None]], **keys: object) -> list[str]:
    """``program`` with a slave in data exchange; the user parameters that it was sent, as hex."""
    sent: list[str] = []

    async def read(slot: int, index: int) -> bytes:
        return bytes((slot, index))

    def on_prm(user_prm: bytes) -> None:
        sent.append(user_prm.hex(" "))

    async def main() -> None:
        served = DpSlave(RIG, lambda outputs, elapsed: outputs, on_read=read, on_prm=on_prm)
        async with (
            dpstack.serve_slave(served, world=world, address=9),
            bus_of(RIG.table(9) | keys, world=world) as bus,
        ):
            await bus.operate()
            slave = bus.slave(9)
            await slave.ready()
            slave.outputs = b"\x42"
            await program(slave)
            assert slave.ready_now
            assert slave.outputs == b"\x42"

    virtual(main())
    return sent


def test_opened_changed_and_closed_again(world: WorldFactory) -> None:
    async def program(slave: dpstack.Slave) -> None:
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
        await slave.reparameterise(dpv1={"alarms": []})  # a table says all
        assert slave.setup.dpv1 == Dpv1(alarms=())
        await slave.reparameterise(user_prm=b"\x04\x41\x01")
        await slave.reparameterise(dpv1=False)
        with pytest.raises(UsageError, match="not parameterised for DP-V1"):
            await slave.read(1, 2)
        await slave.reparameterise(user_prm=b"\x80\0\0", dpv1=None)  # as if it had never been given
        assert await slave.read(5, 6) == b"\x05\x06"

    assert rig(world(), program, dpv1=False) == [
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
def test_what_cannot_be_changes_nothing(world: WorldFactory, given: Any, text: str) -> None:
    async def program(slave: dpstack.Slave) -> None:
        with pytest.raises(ConfigError, match=text):
            await slave.reparameterise(dpv1=given)
        with pytest.raises(ConfigError, match="three DPV1_Status octets, 1 are there"):
            await slave.reparameterise(dpv1=True, user_prm=b"\0")
        assert slave.setup.dpv1 == Dpv1()

    assert rig(world(), program) == ["80 00 00"]


@in_virtual_time
async def test_the_gsd_file_is_asked(world: WorldFactory) -> None:
    async with bus_of({"name": "told", "address": 8, "gsd": str(FILES / "slots.gsd")}) as bus:
        await bus.ready()
        with pytest.raises(ConfigError, match="its GSD file says DPV1_Slave = 0"):
            await bus.slave("told").reparameterise(dpv1=True)


@in_virtual_time
async def test_a_drive_plugin_keeps_its_way_to_the_parameters() -> None:
    pump: dict[str, object] = {"name": "pump", "address": 6, "drive": "ls-s100", "telegram": "ST1"}
    async with bus_of(pump) as bus:
        await bus.operate()
        await bus.ready()
        slave, drive = bus.slave("pump"), bus.drive("pump")
        with pytest.raises(UsageError, match="remove the slave and add it with another dpv1"):
            await slave.reparameterise(dpv1=False)
        await slave.reparameterise(dpv1={"response_timeout_ms": 700})
        assert await drive.read(965) == 0x0328
