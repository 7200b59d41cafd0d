"""A simulated slave of a configuration on a wire of its own, asked by a master in literal octets."""

from __future__ import annotations

from octet_wire import PARAMS, Wire, framed

from dpstack.api.config.config import slave_config
from dpstack.api.slave_side.virtual_bench import SimulatedSlave, VirtualBench
from dpstack.sim.world import World

SC = "E5"
VALVES: dict[str, object] = {
    "name": "valves",
    "address": 8,
    "ident": 0x1234,
    "config": "11 21",  # two octets of inputs, two of outputs
    "inputs": {"limit": "bool@0.3", "level": "u8@1"},
}


class Asked:
    """Master 2 and the simulated slave of ``table`` at address 8, ident number 0x1234, in data exchange."""

    def __init__(self, table: dict[str, object] = VALVES) -> None:
        self.bench = VirtualBench(World(), PARAMS)
        self.bench.add(slave_config(table))
        self.wire = Wire(self.unit.station)
        self.fc = 0x5D
        self.bring_up(str(table.get("config")))

    @property
    def unit(self) -> SimulatedSlave:
        return self.bench.units[8]

    def bring_up(self, config: str = "11 21") -> None:
        self.wire.station = self.unit.station
        assert self.ask("3D 3E 80 00 00 0B 12 34 00") == SC
        assert self.ask(f"3E 3E {config}") == SC

    def ask(self, unit: str) -> str:
        """The answer to a request with SAPs."""
        return self.wire.ask(framed(0x88, 0x82, self._next_fc(), unit))

    def exchange(self, outputs: str) -> str:
        """The whole answer to Data_Exchange."""
        return self.wire.ask(framed(8, 2, self._next_fc(), outputs))

    def inputs(self, outputs: str = "00 00") -> str:
        """The inputs in the answer to Data_Exchange; "" where it is none with data."""
        answer = self.exchange(outputs).split()
        return " ".join(answer[7:-2]) if answer[6:7] in (["08"], ["0A"]) else ""

    def _next_fc(self) -> int:
        self.fc ^= 0x20
        return self.fc
