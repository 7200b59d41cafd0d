"""I&M of simulated devices whose GSD file says Ident_Maintenance_supp."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from api_kit import bench_of, operating
from octet_wire import PARAMS

from dpstack.api.config.config import slave_config
from dpstack.api.slave_side.virtual_bench import SimulatedSlave
from dpstack.dpv1.pdu.im import Im0, Im1
from dpstack.dpv1.slave.user_slave import DpSlave
from dpstack.errors import DpError

pytestmark = pytest.mark.virtual_time

#: OrderNumber = "T8-001", Hardware_Release = "H1.0", Software_Release = "V2;3"
TERMINAL: dict[str, object] = {
    "name": "valves",
    "address": 8,
    "gsd": "examples/terminal.gsd",
    "modules": ["8 DO", "8 DI", "", "4 AI"],
}


async def test_a_gsd_device_answers_im_of_station_and_modules() -> None:
    async with operating(TERMINAL, baud=187_500) as bus:
        slave = bus.slave("valves")
        head = await slave.im()
        assert isinstance(head, Im0)
        assert (head.order_id, head.hardware_revision, head.software_revision) == ("T8-001", 1, "V2.3.0")
        modules = [await slave.im(slot=slot) for slot in (1, 2, 4)]
        assert [one.order_id for one in modules if isinstance(one, Im0)] == ["8 DO", "8 DI", "4 AI"]
        with pytest.raises(DpError, match="slot"):
            await slave.im(slot=3)  # an empty one


async def test_a_written_im1_stays_over_power_off() -> None:
    async with operating(TERMINAL, baud=187_500) as bus:
        slave, bench = bus.slave("valves"), bench_of(bus)
        await slave.write_im(Im1("pump 3", "hall 2"))
        bench.power("valves", False)
        await asyncio.sleep(0.3)
        bench.power("valves", True)
        await slave.ready(5)
        assert await slave.im(1) == Im1("pump 3", "hall 2")


def test_without_the_keyword_there_is_none(tmp_path: Path) -> None:
    text = Path("examples/terminal.gsd").read_text(encoding="latin-1")
    (tmp_path / "t.gsd").write_text(text.replace("Ident_Maintenance_supp = 1\n", ""), encoding="latin-1")
    unit = SimulatedSlave(slave_config(TERMINAL | {"gsd": str(tmp_path / "t.gsd")}), PARAMS)
    assert unit.device.records is None


def test_releases_and_names_that_im_cannot_carry_are_cut(tmp_path: Path) -> None:
    text = Path("examples/terminal.gsd").read_text(encoding="latin-1")
    text = text.replace('"H1.0"', '"99999"').replace('"V2;3"        ; the semicolon in the text is none', '"none"')
    text = text.replace('"T8-001"', '"Klemme für acht Ventile, lang"')
    (tmp_path / "t.gsd").write_text(text, encoding="latin-1")
    unit = SimulatedSlave(slave_config(TERMINAL | {"gsd": str(tmp_path / "t.gsd")}), PARAMS)
    assert isinstance(unit.device, DpSlave)
    head = unit.device.im_of(0)[0]
    assert isinstance(head, Im0)
    assert (head.order_id, head.hardware_revision, head.software_revision) == ("Klemme f?r acht Vent", 65535, "V0.0.0")
