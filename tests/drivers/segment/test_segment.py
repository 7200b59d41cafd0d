"""The virtual segment: ptys joined as one bus, seen by stations that are plain files."""

from __future__ import annotations

import contextlib
import os
import select
import stat
import subprocess
import sys
import termios
from collections.abc import AsyncIterator, Iterator
from functools import partial
from pathlib import Path
from time import monotonic_ns
from typing import Any

import pytest
from far_ends import FarEnd, open_slave, set_rate, until

from dpstack.drivers.segment.hub import Segment, StationStats, default_directory
from dpstack.errors import ConfigError, PortBusyError, PortError, UsageError
from dpstack.ports.pacing import slice_octets

TELEGRAM = bytes.fromhex("68 05 05 68 82 E3 6D 3C 3E 4C 16")


@pytest.fixture
def directory(tmp_path: Path) -> Path:
    return tmp_path / "bus"


def _stations(segment: Segment) -> list[FarEnd]:
    return [open_slave(path) for path in segment.paths]


def _leave(stations: list[FarEnd]) -> None:
    for station in stations:
        station.hang_up()


@contextlib.asynccontextmanager
async def joined(stations: int, directory: Path, **options: Any) -> AsyncIterator[tuple[Segment, list[FarEnd]]]:
    """A segment, and a file at each of its stations."""
    async with Segment(stations, directory, **options) as segment:
        files = _stations(segment)
        yield segment, files
        _leave(files)


#: writes without end to the descriptor it is told: a process, because a thread would take this one's time
_FLOOD = """
import os, sys, time
fd, octets = int(sys.argv[1]), bytes.fromhex(sys.argv[2]) * 20
while True:
    try:
        os.write(fd, octets)
    except BlockingIOError:
        time.sleep(0.0005)
"""


@contextlib.contextmanager
def flood(fd: int) -> Iterator[None]:
    """Somebody who never stops sending on ``fd``, whatever becomes of it, while it is entered."""
    call = [sys.executable, "-I", "-S", "-c", _FLOOD, str(fd), TELEGRAM.hex()]
    with subprocess.Popen(call, pass_fds=[fd]) as writer:
        try:
            yield
        finally:
            writer.kill()


def _fill(station: FarEnd) -> None:
    """Send until the pty takes no more."""
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(station.fd, TELEGRAM * 20)


def _wait_for_octets(segment: Segment, number: int) -> None:
    """The kernel has handed over what station ``number`` sent; the segment could not look yet."""
    poll = select.poll()
    poll.register(segment._stations[number].master.fd, select.POLLIN)
    assert poll.poll(60_000)


async def test_all_stations_receive_the_octets_of_every_other_station(directory: Path) -> None:
    async with joined(4, directory) as (_segment, stations):
        for sender in stations:
            sender.send(TELEGRAM)
            for station in stations:
                if station is not sender:
                    assert await station.recv(len(TELEGRAM)) == TELEGRAM
        assert all(station.take() == b"" for station in stations)


async def test_with_echo_the_sender_too(directory: Path) -> None:
    async with joined(2, directory, echo=True) as (_segment, stations):
        stations[0].send(TELEGRAM)
        assert [await station.recv(len(TELEGRAM)) for station in stations] == [TELEGRAM, TELEGRAM]


async def test_the_links_come_and_go(directory: Path) -> None:
    segment = Segment(3, directory)
    await segment.open()
    assert segment.paths == [str(directory / name) for name in "012"]
    assert all(os.readlink(path).startswith("/dev/pts/") for path in segment.paths)
    assert stat.S_IMODE(directory.stat().st_mode) == 0o700
    with pytest.raises(UsageError):
        await segment.open()
    await segment.close()
    await segment.close()
    assert not directory.exists()


async def test_a_directory_that_was_there_stays_with_all_that_is_not_ours(directory: Path) -> None:
    directory.mkdir()
    (directory / "notes").write_text("mine")
    (directory / "7").symlink_to("/dev/pts/left-over-by-a-killed-segment")
    async with Segment(2, directory) as segment:
        os.unlink(segment.paths[1])
        os.symlink("/dev/null", segment.paths[1])  # replaced by somebody: not ours any more
    assert sorted(path.name for path in directory.iterdir()) == ["1", "notes"]


async def test_a_second_segment_in_one_directory_is_refused(directory: Path) -> None:
    async with Segment(2, directory) as segment:
        with pytest.raises(PortBusyError, match=f"pid {os.getpid()}"):
            await Segment(2, directory).open()
        assert all(os.path.exists(path) for path in segment.paths)


async def test_a_station_name_taken_by_a_file_is_refused(directory: Path) -> None:
    directory.mkdir()
    (directory / "1").write_text("mine")
    with pytest.raises(PortError, match="--dir"):
        await Segment(2, directory).open()
    assert (directory / "1").read_text() == "mine"
    assert not (directory / "0").is_symlink()


async def test_a_directory_that_is_none_of_ours_is_refused(directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    directory.write_text("a file")
    with pytest.raises(PortError, match="no directory of yours"):
        await Segment(2, directory).open()
    directory.unlink()
    directory.mkdir()
    monkeypatch.setattr(os, "geteuid", lambda: 12345)
    with pytest.raises(PortError, match="no directory of yours"):
        await Segment(2, directory).open()


def test_the_default_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert default_directory() == tmp_path / "dpstack-segment"
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "missing"))
    assert default_directory().name == f"dpstack-segment-{os.getuid()}"


@pytest.mark.parametrize(
    "bad", [{"stations": 1}, {"stations": 1000}, {"baud": 115_200}, {"error_rate": -0.1}, {"error_rate": 1.0}]
)
def test_impossible_segments(bad: dict[str, Any]) -> None:
    with pytest.raises(ConfigError):
        Segment(**bad)


async def test_a_station_that_leaves_and_returns_finds_no_old_octets(directory: Path) -> None:
    async with joined(2, directory) as (segment, (one, other)):
        one.send(TELEGRAM)
        await until(lambda: segment._stations[1].stats.received == len(TELEGRAM), "the delivery")
        other.hang_up()
        await until(lambda: not segment._stations[1].present, "the departure")
        one.send(b"for nobody")
        await until(lambda: segment._stations[0].stats.sent == len(TELEGRAM) + 10, "the sending")
        back = FarEnd(os.open(segment.paths[1], os.O_RDWR | os.O_NOCTTY))  # sets nothing, flushes nothing
        one.send(b"fresh")
        assert await back.recv(5) == b"fresh"
        back.send(b"answer")
        assert await one.recv(6) == b"answer"


async def test_octets_sent_just_before_leaving_are_still_forwarded(directory: Path) -> None:
    async with Segment(2, directory) as segment:
        one, other = _stations(segment)
        one.send(TELEGRAM)
        one.hang_up()
        assert await other.recv(len(TELEGRAM)) == TELEGRAM
        other.hang_up()


async def test_a_station_that_does_not_read_costs_octets_only(directory: Path) -> None:
    told_of: list[str] = []
    async with joined(3, directory, on_notice=told_of.append) as (segment, (one, _lazy, busy)):
        got = 0
        for _ in range(300):
            one.send(bytes(250))
            got += len(await busy.recv(250))
        assert got == 75_000
        stats = segment._stations[1].stats
        assert stats.dropped > 0
        assert stats.received + stats.dropped == 75_000
        told = segment.stats()
        assert told["damaged"] == 0
        stations = told["stations"]
        assert isinstance(stations, list)
        octets = {"sent": 75_000, "received": 0, "dropped": 0, "overrun": 0}
        assert stations[0] == {"path": segment.paths[0], **octets, "telegrams": 0, "damaged": 0, "erased": 0}
        assert told_of == ["station 1 of the segment takes no more: what it does not read is dropped"]


async def test_stations_at_other_rates_read_nonsense(directory: Path) -> None:
    async with joined(3, directory, baud=500_000, seed=7) as (_segment, (one, same, other)):
        set_rate(one.fd, termios.B500000)  # as the segment's own: 'same' has set none
        set_rate(other.fd, termios.B1500000)
        for _ in range(20):
            one.send(TELEGRAM)
            assert await same.recv(len(TELEGRAM)) == TELEGRAM
        assert TELEGRAM not in other.take()
        set_rate(other.fd, termios.B500000)  # without closing, as a search for the rate does it
        other.take()
        one.send(TELEGRAM)
        assert await other.recv(len(TELEGRAM)) == TELEGRAM


async def test_a_station_at_another_rate_receives_the_octets_that_its_uart_samples(directory: Path) -> None:
    async with joined(2, directory, baud=500_000) as (segment, (one, other)):
        set_rate(other.fd, termios.B1500000)
        # 68: a break, then FC with a bad stop bit; 05: three bits of space, of mark, of space, mark: 1C (by hand)
        one.send(b"\x68\x05\x05")
        assert await other.recv(2) == b"\x1c\x1c"
        await until(lambda: segment._stations[0].stats.sent == 3, "forwarded")
        assert other.take() == b""


async def test_noise_damages_octets_for_all_alike(directory: Path) -> None:
    async with joined(3, directory, error_rate=0.01, seed=3) as (segment, stations):
        sent = bytes(range(250)) * 20
        for first in range(0, len(sent), 250):
            stations[0].send(sent[first : first + 250])
        await until(lambda: segment._stations[0].stats.sent == 5000, "forwarded")
        told = segment.stats()
        damaged, lost, changed = _count(told["damaged"]), _count(told["lost"]), _count(told["changed"])
        assert 300 < damaged < 800  # 1 - 0.99^11 = 10.5 % of 5000
        assert damaged == lost + changed
        assert 0 < changed < 50  # 36 pairs of nine bits, 0.01^2 x 0.99^9: 0.3 % of 5000
        one, other = await stations[1].recv(5000 - lost), await stations[2].recv(5000 - lost)
        assert one == other
        assert len(one) == 5000 - lost
        segment.error_rate = 0.0
        stations[0].send(TELEGRAM)
        assert await stations[1].recv(len(TELEGRAM)) == TELEGRAM
        assert segment.stats()["damaged"] == damaged


def _count(value: object) -> int:
    assert isinstance(value, int)
    return value


async def test_the_segment_knows_which_telegrams_it_damaged(directory: Path) -> None:
    """Each telegram that differs at a receiver, and no other; one that vanished wholly leaves no trace there."""
    async with joined(2, directory, error_rate=0.02, seed=5) as (segment, (one, other)):
        sender, receiver = (station.stats for station in segment._stations)
        damaged = erased = 0
        for number in range(300):
            telegram = b"\xe5" if number % 3 == 0 else TELEGRAM
            cut = len(telegram) if number % 2 else 4  # every other one in two pieces
            end, before = sender.sent + len(telegram), receiver.received
            one.send(telegram[:cut])
            one.send(telegram[cut:])
            await until(partial(_has_sent, sender, end), "forwarded")
            await until(lambda: receiver.received == sender.sent - segment._lost, "delivered")
            got = await other.recv(receiver.received - before)  # a pty may hand it over a little later
            damaged += got != telegram
            erased += not got
        assert (sender.telegrams, sender.damaged, sender.erased) == (300, damaged, erased)
        assert erased > 0


def _has_sent(stats: StationStats, octets: int) -> bool:
    return stats.sent == octets


async def test_an_endless_writer_leaves_their_turn_to_the_others(directory: Path) -> None:
    """Station 0 floods from another process; 1 and 2 go on talking, what 3 does not read is counted."""
    told_of: list[str] = []
    request = bytes.fromhex("10 02 63 49 AE 16")
    async with joined(4, directory, on_notice=told_of.append) as (segment, (endless, one, other, _lazy)):

        def got_through() -> bool:
            one.send(request)
            while got := other.take():  # a pty gives a page at a time
                if request in got:
                    return True
            return False

        with flood(endless.fd):
            for _ in range(5):
                await until(got_through, "a telegram in the flood")
            await until(lambda: segment._stations[3].stats.dropped > 0, "nobody reads")
        assert "station 3 of the segment takes no more: what it does not read is dropped" in told_of
        assert len(told_of) == len(set(told_of))


async def test_a_telegram_beside_an_endless_writer_arrives_at_a_station_that_reads(directory: Path) -> None:
    """The writer is first each time and has more to say than a pty holds; the other one's telegrams all get through."""
    request = bytes.fromhex("10 02 63 49 AE 16")
    async with joined(3, directory) as (segment, (endless, one, other)):
        stats = [station.stats for station in segment._stations]
        for _ in range(4):
            taken = stats[2].received
            _fill(endless)
            _wait_for_octets(segment, 0)
            one.send(request)
            _wait_for_octets(segment, 1)
            sent = stats[1].sent + len(request)
            await until(partial(_has_sent, stats[1], sent), "forwarded")
            got = await other.recv(stats[2].received - taken)
            assert request in got
            await until(lambda: not segment._unread, "the rest of the flood")
            await other.recv(stats[2].received - taken - len(got))


async def test_a_station_whose_pty_was_full_hears_again_once_it_has_read(directory: Path) -> None:
    async with joined(2, directory) as (segment, (one, lazy)):
        heard = segment._stations[1].stats
        for number in range(2):
            taken, sent = heard.received, segment._stations[0].stats.sent
            while heard.dropped == 0:
                one.send(bytes(250))
                sent += 250
                await until(partial(_has_sent, segment._stations[0].stats, sent), "forwarded")
            assert len(await lazy.recv(heard.received - taken)) > 4096
            heard.dropped = 0
            one.send(TELEGRAM)
            assert await lazy.recv(len(TELEGRAM)) == TELEGRAM, number
            assert heard.dropped == 0


async def test_octets_beyond_the_capacity_of_a_paced_wire_are_dropped_and_reported_once(directory: Path) -> None:
    told_of: list[str] = []
    async with joined(2, directory, baud=93_750, paced=True, on_notice=told_of.append) as (segment, (endless, _other)):
        wire = segment._wire
        assert wire is not None
        with flood(endless.fd):
            await until(lambda: segment._stations[0].stats.overrun > 1_000_000, "the flood")
            now = monotonic_ns()  # what is due already waits for the loop only
            waiting = sum(len(piece) for at, _, _, piece, _ in wire._queue if at > now)
            assert waiting <= 2 * 4096
        assert told_of == [
            "station 0 of the segment sends faster than 93.75 kbit/s: what the wire cannot take is dropped"
        ]


@pytest.mark.parametrize(
    ("baud", "octets"),
    [(9_600, 2), (19_200, 2), (45_450, 14), (93_750, 8), (500_000, 45), (12_000_000, 1090)],
)
def test_slices_are_a_quarter_slot_time_or_a_millisecond(baud: int, octets: int) -> None:
    # 9.6: 25 bits; 45.45: 160 bits; 93.75: 93 bits in 1 ms; 500: 500 bits; 12 M: 12 000 bits
    assert slice_octets(baud) == octets


async def test_a_paced_segment_delivers_all_in_order_and_not_before_its_time(directory: Path) -> None:
    async with Segment(2, directory, baud=93_750, paced=True) as segment:
        one, other = _stations(segment)
        octets = bytes(range(200))
        start = monotonic_ns()
        one.send(octets[:100])
        one.send(octets[100:])
        assert await other.recv(200) == octets
        assert monotonic_ns() - start >= 200 * 11 * 10**9 // 93_750
        one.send(octets)
        await until(lambda: segment._stations[0].stats.sent == 400, "taken up")
        _leave([one, other])  # and closed with octets on the wire
