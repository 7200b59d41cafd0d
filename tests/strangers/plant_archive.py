"""Captures of a hundred segments over four weeks, with what is in them: docs/how-to/many-captures.md asks for it.

Made time: in each week a capture of two minutes of each segment, a round of its master every five seconds.
"""

from __future__ import annotations

from collections import Counter
from datetime import UTC, datetime
from pathlib import Path
from typing import Final, NamedTuple

from dpstack.capture.pcapng import Writer
from dpstack.fdl.codec import encode_sd2, encode_token
from dpstack.units import NS_PER_MS, NS_PER_S, NS_PER_US, chars_to_ns

BAUD: Final = 500_000
WEEKS: Final = 4
#: 2026-01-05T08:00:00Z, a Monday
BEGIN: Final = 1_767_600_000 * NS_PER_S
WEEK: Final = 7 * 86_400 * NS_PER_S
ROUND: Final = 5 * NS_PER_S
ROUNDS: Final = 24
#: names with digits only, and with letters that no path has
SEGMENTS: Final = (*(f"line-{number:02}" for number in range(1, 99)), "007", "press/north=2")
#: its captures begin 20 s before the hour
OVER_THE_HOUR: Final = SEGMENTS[::10]
#: segment and station that answers 3 us later each week, and one that does so up to the third week
LATER: Final = ("line-42", 4)
FOR_A_WHILE: Final = ("line-17", 5)
#: segment and station, with the week and the round in which it does not answer any more
LOST: Final = {("line-03", 5): (0, 15), ("line-77", 3): (2, 20), ("007", 4): (2, 14), ("press/north=2", 4): (3, 23)}
_MASTER: Final = 2
_STATIONS: Final = (3, 4, 5)
#: SRD high, and the same with the frame count bit of a first request
_DE, _FIRST = 0x4D, 0x6D
_FCB, _FCV = 0x20, 0x10


class Loss(NamedTuple):
    """A loss, and the minute before it. ``t_ns``: the master begins anew."""

    segment: str
    station: int
    t_ns: int
    retries: int
    errors: int


class Archive:
    """Makes the captures below ``folder``, in a folder for each segment."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        #: retries by segment, station, date and hour
        self.retries: Counter[tuple[str, int, str, int]] = Counter()
        self.losses: list[Loss] = []
        self.telegrams = 0
        #: captures by segment
        self.captures: dict[str, list[Path]] = {}
        for number, segment in enumerate(SEGMENTS):
            self.captures[segment] = [self._capture(number, segment, week) for week in range(WEEKS)]

    def _capture(self, number: int, segment: str, week: int) -> Path:
        place = self.folder / f"{number:03}"
        place.mkdir(exist_ok=True, parents=True)
        begin = datetime.fromtimestamp((BEGIN + week * WEEK) // NS_PER_S, UTC)
        path = place / f"bus_{week + 1:05}_{begin:%Y%m%dT%H%M%SZ}.pcapng"
        with path.open("wb") as file:
            bus = _Bus(Writer(file, "a test"), self, segment, number, week)
            for step in range(ROUNDS):
                bus.round(step)
        return path


class _Bus:
    """One capture while it is made."""

    def __init__(self, writer: Writer, archive: Archive, segment: str, number: int, week: int) -> None:
        self._writer = writer
        self._interface = writer.interface("/dev/ttyUSB0", BAUD, "")
        self._archive = archive
        self._segment = segment
        self._number = number
        self._week = week
        self._begin = BEGIN + week * WEEK - (20 * NS_PER_S if segment in OVER_THE_HOUR else 0)
        self._now = self._begin
        self._fcb = dict.fromkeys(_STATIONS, 0)
        self._retries: list[tuple[int, int]] = []  # time and station
        self._damaged: list[int] = []

    def round(self, step: int) -> None:
        self._now = self._begin + step * ROUND
        self._send(encode_token(_MASTER, _MASTER))
        for station in _STATIONS:
            lost = LOST.get((self._segment, station))
            if lost == (self._week, step):
                self._lose(station)
                continue
            if lost == (self._week, step - 1):
                self._bring_up(station)
            noisy = (self._number * 7 + self._week * 5 + step * 3 + station) % 97 < 3
            weak = lost is not None and lost[0] == self._week and 0 < lost[1] - step <= 4
            self._exchange(station, retries=noisy + weak)

    def _exchange(self, station: int, retries: int) -> None:
        poll = self._poll(station)
        self._send(poll)
        for _ in range(retries):
            self._retry(poll, station)
        self._now += self._t_sdr_ns(station) - NS_PER_US * 66
        self._send(encode_sd2(_MASTER, station, 0x08, bytes((station, self._week))))

    def _poll(self, station: int) -> bytes:
        self._fcb[station] ^= _FCB
        return encode_sd2(station, _MASTER, _DE | _FCV | self._fcb[station], bytes(2))

    def _retry(self, poll: bytes, station: int) -> None:
        """The answer is damaged, and the request repeated."""
        damaged = bytearray(encode_sd2(_MASTER, station, 0x08, bytes((station, self._week))))
        damaged[-2] ^= 1
        self._damaged.append(self._now)
        self._send(bytes(damaged))
        self._repeat(poll, station)

    def _repeat(self, poll: bytes, station: int) -> None:
        when = datetime.fromtimestamp(self._now // NS_PER_S, UTC)
        self._archive.retries[self._segment, station, f"{when:%Y-%m-%d}", when.hour] += 1
        self._retries.append((self._now, station))
        self._send(poll)

    def _lose(self, station: int) -> None:
        """No answer, one repetition, then a bring-up that begins anew: the frame count bit is not valid."""
        poll = self._poll(station)
        self._send(poll)
        self._now += NS_PER_MS
        self._repeat(poll, station)
        self._now += NS_PER_MS
        since = self._now - 60 * NS_PER_S
        retries = sum(of == station and at >= since for at, of in self._retries)
        errors = sum(at >= since for at in self._damaged)
        self._archive.losses.append(Loss(self._segment, station, self._now, retries, errors))
        for _ in range(3):  # it stays away
            self._send(_slave_diag(station, _FIRST))
            self._now += NS_PER_MS

    def _bring_up(self, station: int) -> None:
        """Slave_Diag, Set_Prm, Chk_Cfg, Slave_Diag, all answered."""
        diagnosis = encode_sd2(_MASTER, station, 0x08, bytes.fromhex("02 05 00 FF 12 34"), dsap=62, ssap=60)
        sc = b"\xe5"
        for octets in (
            *(_slave_diag(station, _FIRST), diagnosis),
            *(encode_sd2(station, _MASTER, _DE | _FCV, bytes.fromhex("88 01 0A 0B 12 34 00"), dsap=61, ssap=62), sc),
            *(encode_sd2(station, _MASTER, _DE | _FCV | _FCB, b"\x11", dsap=62, ssap=62), sc),
            *(_slave_diag(station, _DE | _FCV), diagnosis),
        ):
            self._send(octets)
        self._fcb[station] = 0

    def _t_sdr_ns(self, station: int) -> int:
        late = 0
        if (self._segment, station) == LATER:
            late = 3 * self._week
        elif (self._segment, station) == FOR_A_WHILE:
            late = 3 * min(self._week, 2) - 2 * (self._week == 3)
        jitter = (self._number * 31 + station * 17 + self._now // ROUND * 13) % 11 - 5
        return (60 + late) * NS_PER_US + jitter * 91

    def _send(self, octets: bytes) -> None:
        self._writer.packet(self._interface, self._now, octets)
        self._archive.telegrams += 1
        self._now += chars_to_ns(len(octets), BAUD) + 66 * NS_PER_US


def _slave_diag(station: int, fc: int) -> bytes:
    return encode_sd2(station, _MASTER, fc, dsap=60, ssap=62)
