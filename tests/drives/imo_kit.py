"""An IMO's card as literal octets, and the plugin in front of it."""

from __future__ import annotations

from typing import Any

from drive_bench import ALONE, PluginBench

from dpstack_drives.imo import DRIVE

NOTHING = "00 " * 22
#: SW: stopped, bus voltage up, the bus commands
READY = "41 03 "


class Card(PluginBench):
    """Answers reads of P15 as table 2-9 says, and writes with what was written; SW and PZD are what the test says."""

    def __init__(self, p15: dict[int, int], sw: str = READY, pzd: str = NOTHING, **options: Any) -> None:
        self.p15 = p15
        self.seen: list[str] = []
        super().__init__(DRIVE.core("pump", options={**ALONE, **options}), "00 " * 8 + sw + pzd)
        self.show(sw, pzd)

    def show(self, sw: str, pzd: str = NOTHING, rotations: int = 120) -> str:
        """SW and PZD2 to PZD12 from now on; CW and PZD sent in the end, in hex."""
        self._process = bytes.fromhex(sw + pzd)
        for _ in range(rotations):
            out = self.run()
            request = out[:8].hex(" ").upper()
            if not self.seen or self.seen[-1] != request:
                self.seen.append(request)
            reply = bytes(8)
            if out[1] in (1, 4):
                assert out[2] == 15
                if out[1] == 4:
                    assert out[8] & 1, "CW bit 8"
                    self.p15[out[3]] = out[7]
                reply = bytes([0, 1, 15, out[3], 0, 0, 0, self.p15.get(out[3], 0)])
            self.inputs = reply + self._process
        return out[8:].hex(" ").upper()

    def do(self, op: str, **args: object) -> dict[str, object]:
        """An order and its result."""
        token = self.order(op, **args)
        for _ in range(5):
            self.show(self._process[:2].hex(), self._process[2:].hex())
            if self.result(token) is not None:
                break
        return self.done(token)


RUNS = {2: 1, 13: 1, 14: 5, 15: 6, 16: 11}
