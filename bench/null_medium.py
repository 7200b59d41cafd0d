"""A medium that costs next to nothing: a master's machine alone, pumped by hand, its slaves a table of octets.

Time is virtual: a telegram takes its time on the wire, an answer comes 11 bit times after its request. What is left is
the master's own work.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Final

from dpstack.dp.master.commands import Mode, SetMode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.master import Master
from dpstack.dp.master.settings import MasterSettings
from dpstack.dp.slave_params import SlaveParams
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.machine import pump
from dpstack.params import BusParams
from dpstack.phy.patience import HOST
from dpstack.units import NEVER, NS_PER_S

_TESTS: Final = Path(__file__).resolve().parent.parent / "tests" / "kits"
#: T_SDR of every slave in bit times
_T_SDR: Final = 11
_SD2: Final = 0x68
_PPO1: Final = bytes((0xF3, 0xF1))
_FIRST: Final = 3
_BRING_UP: Final = 60 * NS_PER_S


class NullBus:
    """A master with ``slaves`` PPO1 slaves (1 to 122), in data exchange and Operate after :meth:`bring_up`.

    ``exchanges``: how many Data_Exchange were answered. ``changing``: the outputs are other ones in every round.
    """

    def __init__(self, slaves: int, baud: int = 500_000, *, changing: bool = True) -> None:
        if not 1 <= slaves <= 122:
            raise ValueError(f"{slaves} slaves: 1 to 122 are possible beside the master")
        sys.path.insert(0, str(_TESTS))
        try:
            from support_responder import Slave
        finally:
            sys.path.remove(str(_TESTS))
        params = BusParams.preset(baud, address=2, gap=0)
        addresses = range(_FIRST, _FIRST + slaves)
        setups = [SlaveParams(address=a, name=f"s{a}", ident=0x0696, config=_PPO1) for a in addresses]
        self._slaves = {a: Slave(a, b"\x06\x96", _PPO1, 12, 12, fixed=f"{a:02x}" * 12) for a in addresses}
        self.master = Master(params, setups, MasterSettings(watchdog_ms=1000))
        self.master.on_round = self._round if changing else None
        self.station = ActiveStation(params, [self.master], patience=HOST)
        self.exchanges = 0
        self._pictures = [bytes((n,) * 12) for n in range(256)]
        self._images = list(self.master.images.values())
        #: answers to Data_Exchange, once everybody is there
        self._table: list[bytes] = [b""] * 256
        self._wire_ns = [params.ns(11 * n) for n in range(256)]
        self._t_sdr_ns = params.ns(_T_SDR)
        self._answer = b""
        self._answer_at = NEVER
        self._now = 0

    def bring_up(self) -> None:
        """All slaves to data exchange. Raises RuntimeError when that takes a minute of the bus."""
        self.station.command(GoOnline(), self._now)
        self.station.command(SetMode(Mode.OPERATE), self._now)
        handlers = self.master.handlers.values()
        while not all(h.state is SlaveState.DATA_EXCHANGE for h in handlers):
            self.run(1)
            if self._now > _BRING_UP:
                raise RuntimeError("not every slave came into data exchange")
        self.run(2 * len(self._slaves))
        for address, slave in self._slaves.items():
            self._table[address] = slave.serve(2, b"", bytes(12))

    def measure(self, exchanges: int) -> float:
        """CPU time in ns of one exchange, mean of ``exchanges`` (with the tokens and Global_Controls between them)."""
        begin = time.process_time_ns()
        self.run(exchanges)
        return (time.process_time_ns() - begin) / exchanges

    def run(self, exchanges: int) -> None:
        """Run until ``exchanges`` more Data_Exchange were answered."""
        station = self.station
        transmit = self._transmit
        until = self.exchanges + exchanges
        deadline = station.wake_at()
        while self.exchanges < until:
            if self._answer_at <= deadline:
                self._now = max(self._now, self._answer_at)
                answer, self._answer_at = self._answer, NEVER
                deadline = pump(station, answer, self._now, transmit)
            else:
                if deadline > self._now:
                    self._now = deadline
                deadline = pump(station, b"", self._now, transmit)
            station.take_events()

    def _transmit(self, octets: bytes, now: int) -> int:
        end = now + self._wire_ns[len(octets)]
        answer = b""
        if octets[0] == _SD2 and octets[4] < 0x80:
            self.exchanges += 1
            answer = self._table[octets[4]]
        answer = answer or self._serve(octets)
        if answer:
            self._answer = answer
            self._answer_at = end + self._t_sdr_ns + self._wire_ns[len(answer)]
        return end

    def _serve(self, octets: bytes) -> bytes:
        """A slave's answer by its own rules: bring-up, diagnosis; b"" to everything that has none."""
        if octets[0] != _SD2 or octets[4] & 0x7F not in self._slaves:
            return b""
        da, sa, fc = octets[4:7]
        saps, data = (octets[7:9], octets[9:-2]) if da & 0x80 else (b"", octets[7:-2])
        return self._slaves[da & 0x7F].answer(sa & 0x7F, fc, saps, data)

    def _round(self, now: int) -> None:
        picture = self._pictures[self.master.rounds & 0xFF]
        for image in self._images:
            image.outputs = picture
