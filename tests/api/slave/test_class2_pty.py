"""``bus.class2`` on ptys during data exchange, against slaves of literal octets."""

from __future__ import annotations

from pathlib import Path

import pytest
from support_responder import Responder

import dpstack
from dpstack.drivers.segment.hub import Segment


async def test_reading_beside_data_exchange(tmp_path: Path) -> None:
    valves: dict[str, object] = {
        "name": "valves",
        "address": 4,
        "ident": 0x1234,
        "config": "21 11",
        "inputs": {"level": "i16@0"},
        "outputs": {"target": "i16@0"},
    }
    async with Segment(2, tmp_path / "bus", baud=1_500_000) as segment:
        with Responder(segment.paths[1], ["4:1234:2111:2:2", "7:0696:f3f1:12:12,owner=1", "126:4321:10:1:0"]):
            async with dpstack.open_bus(port=segment.paths[0], baud=1_500_000, slaves=[valves], gap=0) as bus:
                await bus.ready()
                await bus.operate()
                own = bus.slave("valves")
                own["target"] = -1234
                while own["level"] != -1234:
                    await bus.rotated(bus.stats.rotations + 1, 10)
                assert (await bus.class2.inputs(4)).values == {"level": -1234}
                assert (await bus.class2.outputs(4)).values == {"target": -1234}
                assert (await bus.class2.config(4)).octets == b"\x21\x11"
                foreign = await bus.class2.diagnosis(7)
                assert (foreign.ident, foreign.master) == (0x0696, 1)
                assert (await bus.class2.inputs(7)).octets == bytes(12)
                with pytest.raises(dpstack.SlaveFault, match="locked by master 1"):
                    await bus.class2.set_address(7, 8)
                with pytest.raises(dpstack.SlaveTimeout, match="slave 99 does not answer RD_Inp"):
                    await bus.class2.inputs(99)
                assert (await bus.class2.set_address(126, 9, ident=0x4321)).ident == 0x4321
                assert (await bus.class2.diagnosis(9)).ident == 0x4321
                assert own.ready_now
                assert own.fault is None
