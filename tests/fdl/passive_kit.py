"""Test bench for passive stations: requests of master 2 to station 3 in literal octets, at times of the test."""

from __future__ import annotations

from collections.abc import Iterable

from dpstack.fdl.codec import decode
from dpstack.fdl.interface import BusStation, Reply, StationControl
from dpstack.fdl.passive.multi_station import Multidrop
from dpstack.fdl.passive.station import PassiveStation
from dpstack.fdl.telegram import Resp, Telegram
from dpstack.machine import pump
from dpstack.params import BusParams
from dpstack.phy.patience import EXACT, Patience
from dpstack.trace import Event
from dpstack.units import NEVER

BAUD = 500_000
BIT = 2_000  # ns at 500 kbit/s

# master 2 to station 3, by hand: DX with one octet, FC 6D first request, then 5D / 7D
DX_FIRST = "68 04 04 68 03 02 6D 11 83 16"
DX_5D = "68 04 04 68 03 02 5D 11 73 16"
DX_7D = "68 04 04 68 03 02 7D 11 93 16"
DX_TO_5 = "68 04 04 68 05 02 5D 11 75 16"
DX_ANSWER = "68 04 04 68 02 03 08 99 A6 16"
DIAG_FIRST = "68 05 05 68 83 82 6D 3C 3E EC 16"
GC_ALL = "68 07 07 68 FF 82 46 3A 3E 02 00 41 16"
STATUS = "10 03 02 49 4E 16"
TOKEN = "DC 04 02"
SC = "E5"


class Application:
    """Answers from a table and writes down what it was asked."""

    def __init__(self, replies: Iterable[Reply | None] = ()) -> None:
        self.replies = list(replies)
        self.served: list[Telegram] = []
        self.indicated: list[Telegram] = []
        self.ticks: list[int] = []
        self.due = NEVER
        self.station: StationControl | None = None
        self.events: list[Event] = []
        self.move_to: int | None = None

    def attached(self, station: StationControl) -> None:
        self.station = station

    def serve(self, request: Telegram, now: int) -> Reply | None:
        self.served.append(request)
        if self.move_to is not None and self.station is not None:
            self.station.set_address(self.move_to)
        return self.replies.pop(0) if self.replies else Reply(Resp.DL, b"\x99")

    def indicate(self, telegram: Telegram, now: int) -> None:
        self.indicated.append(telegram)

    def wake_at(self) -> int:
        return self.due

    def tick(self, now: int) -> None:
        self.ticks.append(now)
        self.due = NEVER

    def take_events(self) -> list[Event]:
        events, self.events = self.events, []
        return events


class Bench:
    """Delivers requests to ``port`` at chosen times and pumps between them; ``sent`` are (start in ns, hex)."""

    def __init__(self, port: PassiveStation | Multidrop, how: str) -> None:
        self.port = port
        self.station = port if isinstance(port, PassiveStation) else port.stations[0]
        self.how = how
        self.now = 0
        self.sent: list[tuple[int, str]] = []
        self.octet_ns = port.line.t_stall_ns // 3

    def _transmit(self, octets: bytes, now: int) -> int:
        self.sent.append((now, octets.hex(" ").upper()))
        return now + len(octets) * self.octet_ns

    def _pump(self, chunk: bytes, now: int) -> None:
        deadline = pump(self.port, chunk, now, self._transmit)
        while deadline <= now:
            deadline = pump(self.port, b"", now, self._transmit)

    def poke(self) -> None:
        """A deadline changed from outside."""
        self.port.poke()

    def run_until(self, at: int) -> None:
        while (deadline := self.port.wake_at()) <= at:
            self.now = max(self.now, deadline)
            self._pump(b"", self.now)
        self.now = at

    def say(self, octets: str, at: int) -> None:
        """``octets`` whose last bit is on the line at ``at``."""
        raw = bytes.fromhex(octets)
        if self.how == "telegram":
            telegram = decode(raw)
            assert telegram is not None
            self.run_until(at)
            self.station.telegram(telegram, at)
            self._pump(b"", at)
        elif self.how == "octets":
            self.run_until(at)
            self._pump(raw, at)
        else:
            for left in range(len(raw) - 1, -1, -1):
                when = at - left * self.octet_ns
                self.run_until(when)
                self._pump(raw[len(raw) - 1 - left :][:1], when)

    def answers(self, octets: str, at: int, until: int | None = None) -> list[str]:
        """The telegrams after ``octets`` until the line has been quiet for a long time."""
        before = len(self.sent)
        self.say(octets, at)
        self.run_until(at + 10_000 * BIT if until is None else until)
        return [text for _, text in self.sent[before:]]


#: the ways to a station: octets in one chunk or one by one, whole telegrams, one by one through a port of several
HOWS = ["octets", "bytewise", "telegram", "multidrop"]


def build(
    how: str,
    replies: Iterable[Reply | None] = (),
    *,
    t_sdr: int | None = None,
    baud: int = BAUD,
    patience: Patience = EXACT,
) -> tuple[Bench, Application]:
    application = Application(replies)
    params = BusParams.preset(baud)
    station = PassiveStation(3, application, params, t_sdr=t_sdr, patience=patience)
    bus_station: BusStation = station  # the contract holds
    assert bus_station.address == 3
    port = Multidrop([station], params, patience=patience) if how == "multidrop" else station
    return Bench(port, how), application


def times(start: int = 100_000) -> Iterable[int]:
    while True:
        start += 20_000 * BIT
        yield start
