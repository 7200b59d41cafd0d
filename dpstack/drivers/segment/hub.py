"""A virtual RS-485 segment: ptys joined as one bus, which any program may open as serial ports.

Every station receives the octets of all others. One edge-triggered epoll watches all master ends (in a level-triggered
selector a pty without a program would be ready for ever); the event loop watches that epoll. A round trip through this
hub costs about 80 us with two stations, so it cannot verify timing from 1.5 Mbit/s up.

A station has the baud rate of its tty. At another rate than the sender's it receives the octets that its UART would
sample from the waveform. Noise inverts bits. Characters with errors are dropped, as by a UART with IGNPAR: a pty cannot
mark errors.

No station blocks the others. From a station that sends without pause the hub reads at most one chunk a turn, after the
other stations, and far less than a pty holds, so that a slow reader still finds the others' telegrams. Octets beyond
the capacity of a paced wire, and octets that a station does not read, are dropped, counted and reported once.

One station of a segment: its pty, its receiver, counters of octets and telegrams before noise.
"""

from __future__ import annotations

import asyncio
import errno
import os
import random
import select
from collections.abc import Callable
from pathlib import Path
from time import monotonic_ns
from typing import Final

from msgspec import Struct
from msgspec.structs import asdict

from dpstack.drivers.tap import Tap
from dpstack.errors import ConfigError, PortBusyError, PortError, UsageError
from dpstack.fdl.decoder import Decoder
from dpstack.params import T_SYN
from dpstack.phy.noise import BitNoise
from dpstack.phy.uart import Receiver, flipped, waveform
from dpstack.ports.base import reason_of
from dpstack.ports.holders import holder_of
from dpstack.ports.pacing import PacedWire
from dpstack.ports.posix import check, fcntl
from dpstack.ports.pty import PtyMaster
from dpstack.ports.runtime_dir import open_own, own_directory, runtime_path
from dpstack.units import BAUD_RATES, NEVER, baud_text, bits_to_ns, chars_to_ns


class StationStats(Struct):
    """Counters of one station.

    Octets: ``sent``, ``received``, ``dropped`` (its pty was full), ``overrun`` (beyond the capacity of a paced wire).
    Telegrams it sent: ``telegrams`` in all, ``damaged`` those with an inverted bit, ``erased`` the damaged ones without
    any octet left, which no receiver can notice.
    """

    path: str
    sent: int = 0
    received: int = 0
    dropped: int = 0
    overrun: int = 0
    telegrams: int = 0
    damaged: int = 0
    erased: int = 0


class SegmentStation:
    """A pty of the segment and its state."""

    def __init__(self, master: PtyMaster, link: str) -> None:
        self.master = master
        self.present = False
        #: it neither sends nor receives before this time (ns)
        self.silent_until = 0
        self.stats = StationStats(link)
        #: notices about this station that were reported; each is reported once
        self.reported: set[str] = set()
        self._receiver: Receiver | None = None  # while senders have another rate
        # finds the ends of its telegrams, before noise
        self._telegrams = Decoder(stall_ns=NEVER)
        self._damaged = self._arrived = False  # of the telegram it is sending: by noise; at least one octet

    def on_hang_up(self) -> None:
        """Note that no program has the station's pty open any more."""
        if self.present:
            self.present = False
            self.master.discard_unread()
            self._telegrams.reset()
            self._damaged = self._arrived = False

    def transmit(self, octets: bytes, flips: dict[int, int]) -> bytes:
        """It sends ``octets`` with the bits ``flips`` inverted: the octets that UARTs at its rate receive.

        A UART drops a character with a parity or framing error; two inverted bits may give another valid octet.
        """
        stats, telegrams = self.stats, self._telegrams
        if not flips and not telegrams.pending:
            stats.telegrams += len(telegrams.feed(octets, 0))
            self._damaged, self._arrived = False, bool(telegrams.pending)
            return octets
        arrived = bytearray()
        for number, octet in enumerate(octets):
            mask = flips.get(number, 0)
            got = flipped(octet, mask) if mask else octet
            if got is not None:
                arrived.append(got)
            self._damaged |= bool(mask)
            self._arrived |= got is not None
            found = len(telegrams.feed(octets[number : number + 1], 0))
            stats.telegrams += found
            if found and self._damaged:
                stats.damaged += 1
                stats.erased += not self._arrived
            if not telegrams.pending:
                self._damaged = self._arrived = False
        return bytes(arrived)

    def misread(self, octets: bytes, baud: int, reading: int, start_ns: int, flips: dict[int, int]) -> bytes:
        """Octets that its UART at ``reading`` bit/s receives of ``octets`` sent at ``baud`` from ``start_ns`` on."""
        receiver = self._receiver
        if receiver is None or receiver.baud != reading:
            receiver = self._receiver = Receiver(reading)
        received = receiver.idle(start_ns)
        received += receiver.sample(start_ns, waveform(octets, flips), baud)
        return bytes(character.octet for character in received if character.good)

    def deliver(self, octets: bytes) -> bool:
        """Write ``octets`` to its pty; False when that is full."""
        try:
            done = os.write(self.master.fd, octets)
        except OSError:  # full, or closed this very moment
            done = 0
        self.stats.received += done
        self.stats.dropped += len(octets) - done
        return done == len(octets)


MAX_STATIONS: Final = 64
_CHUNK: Final = 4096  # octets read from one station a turn: a quarter of the capacity of a pty


class Segment:
    """``stations`` ptys joined as one bus, linked as ``directory``/0, /1 ...

    ``directory``: default :func:`default_directory`; made with mode 0700 when it is missing. ``baud``: the rate of a
    station whose tty has none set, in bit/s. ``paced``: octets take their time on the wire. ``echo``: a station
    receives its own octets. ``error_rate``: probability that a bit is inverted. ``seed``: of the noise. ``on_notice``:
    called with one line when a station causes the loss of octets.
    """

    def __init__(
        self,
        stations: int = 2,
        directory: str | os.PathLike[str] | None = None,
        *,
        baud: int = 500_000,
        paced: bool = False,
        echo: bool = False,
        error_rate: float = 0.0,
        seed: int = 0,
        on_notice: Callable[[str], None] | None = None,
    ) -> None:
        if not 2 <= stations <= MAX_STATIONS:
            raise ConfigError(f"{stations} stations: a segment joins 2 to {MAX_STATIONS}")
        if baud not in BAUD_RATES:
            raise ConfigError(f"baud {baud} is no PROFIBUS rate (known: {', '.join(map(str, BAUD_RATES))})")
        check("a segment of ptys")
        self.directory = Path(directory) if directory is not None else default_directory()
        self._chosen = directory is not None
        self.baud = baud
        self.paced = paced
        self.echo = echo
        self._rng = random.Random(seed)
        self._noise = BitNoise(error_rate, random.Random(seed + 1))
        self._lost = self._changed = 0  # octets dropped or changed by noise
        self._on_notice = on_notice
        self._tap: Tap | None = None
        self._links = [self.directory / str(n) for n in range(stations)]
        self._stations: list[SegmentStation] = []
        self._by_fd: dict[int, SegmentStation] = {}
        self._epoll: select.epoll | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._wire: PacedWire[SegmentStation] | None = None
        self._unread: dict[SegmentStation, None] = {}  # stations with more octets than one turn reads
        self._last_sender: SegmentStation | None = None
        self._line_free_ns = 0  # when the last octet left the line
        self._lock_fd = -1
        self._made_directory = False

    @property
    def paths(self) -> list[str]:
        """The stations' serial ports, in order."""
        return [str(link) for link in self._links]

    @property
    def error_rate(self) -> float:
        """Probability that a bit is inverted; may be set while the segment runs."""
        return self._noise.per_bit

    @error_rate.setter
    def error_rate(self, value: float) -> None:
        self._noise = BitNoise(value, random.Random(self._rng.random()))

    def silence(self, number: int, for_ns: int | None = None) -> None:
        """Cut station ``number`` off for a time, None: until :meth:`resume`. Raises UsageError."""
        self._connected(number).silent_until = NEVER if for_ns is None else monotonic_ns() + for_ns

    def silenced(self) -> dict[int, int]:
        """Stations that are cut off, with the remaining time in ns; NEVER: until :meth:`resume`."""
        now = monotonic_ns()
        return {
            number: NEVER if station.silent_until == NEVER else station.silent_until - now
            for number, station in enumerate(self._stations)
            if station.silent_until > now
        }

    def resume(self, number: int) -> None:
        """End the silence of station ``number``. Raises UsageError."""
        self._connected(number).silent_until = 0

    def _connected(self, number: int) -> SegmentStation:
        if not 0 <= number < len(self._stations):
            raise UsageError(f"no station {number} on this segment; it has 0 to {len(self._links) - 1}")
        return self._stations[number]

    def stats(self) -> dict[str, object]:
        """``stations``: the StationStats of each; ``damaged``: octets damaged by noise, ``lost`` and ``changed``."""
        lost, changed = self._lost, self._changed
        stations = [asdict(station.stats) for station in self._stations]
        return {"stations": stations, "damaged": lost + changed, "lost": lost, "changed": changed}

    async def open(self) -> None:
        """Make the ptys and their links and begin. Raises PortError; PortBusyError when a segment runs there."""
        if self._loop is not None:
            raise UsageError("the segment is open already")
        loop = asyncio.get_running_loop()
        try:
            self._take_directory()
            self._epoll = select.epoll()
            for link in self._links:
                self._add_station(link, self._epoll)
            self._epoll.poll(0)  # discards the hang-up that each new pty reports
            if self.paced:
                self._wire = PacedWire(loop, self._deliver)
        except OSError as exc:
            self._release()
            if isinstance(exc, PortError):
                raise
            raise PortError(f"segment in {self.directory}: {reason_of(exc)}") from None
        self._loop = loop
        loop.add_reader(self._epoll.fileno(), self._ready)

    async def close(self) -> None:
        """Remove the links and the ptys. May be called again."""
        loop, self._loop = self._loop, None
        if loop is None:
            return
        if self._epoll is not None:
            loop.remove_reader(self._epoll.fileno())
        self._release()

    def tap(self, tap: Tap | None) -> None:
        """Copy all octets on the segment into ``tap`` from now on; None ends it."""
        self._tap = tap

    async def __aenter__(self) -> Segment:
        await self.open()
        return self

    async def __aexit__(self, *_exc: object) -> None:
        await self.close()

    # --- octets ---------------------------------------------------------------------------------------------------

    def _ready(self) -> None:
        if not self._unread:  # else a turn is due already
            self._turn()

    def _turn(self) -> None:
        """Read every ready station once; those with more octets than the last turn read come last."""
        if self._epoll is None or self._loop is None:
            return
        unread, self._unread = self._unread, {}
        ready = [self._by_fd[fd] for fd, _event in self._epoll.poll(0)]
        for station in [station for station in ready if station not in unread] + list(unread):
            if self._read(station):
                self._unread[station] = None
        if self._unread:
            self._loop.call_soon(self._turn)

    def _read(self, station: SegmentStation) -> bool:
        """Forward the octets of a station. True when there may be more (edge-triggered): read it in the next turn."""
        read = 0
        while read < _CHUNK:
            try:
                chunk = os.read(station.master.fd, _CHUNK - read)
            except BlockingIOError:
                return False
            except OSError:  # EIO: no program has it open, which is normal
                station.on_hang_up()
                return False
            read += len(chunk)
            station.present = True
            self._forward(station, chunk)
        return True

    def _forward(self, sender: SegmentStation, chunk: bytes) -> None:
        sender.stats.sent += len(chunk)
        if sender.silent_until > monotonic_ns():
            return
        baud = sender.master.baud() or self.baud
        if self._wire is None:
            self._deliver(sender, chunk, baud)
        elif not self._wire.send(sender, chunk, baud):
            sender.stats.overrun += len(chunk)
            self._report(sender, f"sends faster than {baud_text(baud)}: what the wire cannot take is dropped")

    def _deliver(self, sender: SegmentStation, chunk: bytes, baud: int) -> None:
        """``chunk`` is on the wire: give it to every other station."""
        now = monotonic_ns()
        start_ns = self._placed(sender, len(chunk), baud, now)
        flips = self._noise.flips(len(chunk))
        received = sender.transmit(chunk, flips)
        if self._tap is not None and received:
            # without pace the line's own time would run ahead of the clock, for ever
            self._tap.add((self._line_free_ns if self.paced else now, baud, bytes(received), False))
        if flips:
            lost = len(chunk) - len(received)
            self._lost += lost
            self._changed += len(flips) - lost
        for station in self._stations:
            if (station is sender and not self.echo) or station.silent_until > now:
                continue
            if not station.present:
                if station.master.has_no_opener():
                    continue
                station.present = True
            reading = station.master.baud() or self.baud
            octets = received if reading == baud else station.misread(chunk, baud, reading, start_ns, flips)
            if octets and not station.deliver(octets):
                self._report(station, "takes no more: what it does not read is dropped")

    def _placed(self, sender: SegmentStation, size: int, baud: int, now: int) -> int:
        """Start of ``size`` octets on the wire: now (paced ones end now), but not before the previous ones end."""
        duration = chars_to_ns(size, baud)
        start = now - (duration if self.paced else 0)
        free = self._line_free_ns
        if self.paced and sender is self._last_sender and start < free + bits_to_ns(T_SYN, baud):
            start = free  # the next slice of one telegram
        else:
            start = max(start, free + bits_to_ns(T_SYN, baud))
        self._last_sender = sender
        self._line_free_ns = start + duration
        return start

    def _report(self, station: SegmentStation, what: str) -> None:
        """Report ``what`` once for each station."""
        if what not in station.reported:
            station.reported.add(what)
            if self._on_notice is not None:
                self._on_notice(f"station {Path(station.stats.path).name} of the segment {what}")

    # --- set-up -------------------------------------------------------------------------------------------------------

    def _take_directory(self) -> None:
        """Make or check the directory and lock it against a second segment. Raises PortError, OSError."""
        try:
            if self._chosen:
                self._made_directory = own_directory(self.directory)
                self._lock_fd = os.open(self.directory, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
            else:
                missing = not os.path.exists(self.directory)
                self._lock_fd = open_own(str(self.directory), make=True)
                self._made_directory = missing
        except PortError as error:
            raise PortError(f"{error}: give another one with --dir") from None
        try:
            fcntl.flock(self._lock_fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = holder_of(self._lock_fd)
            self._made_directory = False
            raise PortBusyError(
                f"a segment runs in {self.directory} already, by {holder}: end it or give another --dir"
            ) from None
        for entry in self.directory.iterdir():
            if entry.name.isdecimal() and entry.is_symlink():  # of a segment that was killed
                entry.unlink()

    def _add_station(self, link: Path, epoll: select.epoll) -> None:
        master = PtyMaster()
        station = SegmentStation(master, str(link))
        self._stations.append(station)
        self._by_fd[master.fd] = station
        epoll.register(master.fd, select.EPOLLIN | select.EPOLLET)
        try:
            link.symlink_to(master.path)
        except FileExistsError:
            raise PortError(f"{link} exists and is no link of a segment: give another --dir") from None

    def _release(self) -> None:
        if self._wire is not None:
            self._wire.close()
            self._wire = None
        for station in self._stations:
            _remove_link(Path(station.stats.path), station.master.path)
            station.master.close()
        self._stations = []
        self._by_fd = {}
        self._unread = {}
        if self._epoll is not None:
            self._epoll.close()
            self._epoll = None
        if self._lock_fd >= 0:
            os.close(self._lock_fd)
            self._lock_fd = -1
        if self._made_directory:
            self._made_directory = False
            try:
                self.directory.rmdir()
            except OSError as exc:
                if exc.errno not in (errno.ENOTEMPTY, errno.ENOENT, errno.EEXIST):
                    raise


def _remove_link(link: Path, target: str) -> None:
    """Remove ``link`` if it still leads to ``target``."""
    try:
        if os.readlink(link) == target:
            link.unlink()
    except OSError:  # removed or replaced by another program
        return


def default_directory() -> Path:
    """``dpstack-segment`` in the user's runtime directory, else one in the temporary directory with the user's id."""
    return Path(runtime_path("dpstack-segment"))
