"""docs/ends.md, row by row: what a slave that knows octets only is sent last, and what is told."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import re
import select
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from ends_kit import after_live, heard, is_in_order, table
from ends_programs import WAYS, Ways
from far_ends import HANG_S
from process_kit import LAMPS_SPEC, SPEC, eventually, octet_slaves
from support_responder import Responder

import dpstack
from dpstack.api.bus import shutdown
from dpstack.drivers.line import shutdown as of_drivers
from dpstack.fdl.active.station import ActiveStation
from dpstack.ports.tty import TtyPort
from dpstack.units import ns_to_s

ROOT = Path(__file__).parents[3]
DRIVERS = ("asyncio", "process")
LIVE, SAFE = "1122", "a55a"


@dataclass(frozen=True)
class Row:
    """A row of the table."""

    last: str
    clear: bool
    told: str


#: applications by way and driver
TABLE = {
    (way, driver): Row(last, clear == "yes", told)
    for way, (_, driver, last, clear, _who, told) in table("By the application", "way out")
}


def check(row: Row, words: list[str], told: str) -> None:
    """The row says what the slave has received in ``words``, and what the log has in ``told``."""
    assert LIVE in words
    if row.last == "live outputs":
        assert after_live(words, LIVE) == ([], [])
        assert not row.clear
    else:
        assert row.last == "safe values, zeros"
        assert row.clear
        assert is_in_order(words, live=LIVE, safe=SAFE), words
    quoted = re.findall(r"`([^`]+)`", row.told)
    assert all(text in told for text in quoted)
    if row.told == "nothing":
        assert told == ""


def test_the_table_has_every_way_with_every_driver() -> None:
    assert list(TABLE) == [(way, driver) for way in WAYS for driver in DRIVERS]


#: what can be seen from within the process of the test
HERE = [way for way in WAYS if way not in ("the_interpreter_ends", "in_a_daemon_thread", "killed", "os_exit")]
for out in ("a_forked_child_ends", "ctrl_c_without_asyncio_run", "sigterm_without_handler"):
    HERE.remove(out)
RAISED: dict[str, type[BaseException]] = {
    "an_exception": ZeroDivisionError,
    "ctrl_c_three_times": KeyboardInterrupt,
    "sys_exit_in_a_callback": SystemExit,
}


@pytest.mark.parametrize("way", HERE)
def test_within_this_process(way: str, caplog: pytest.LogCaptureFixture) -> None:
    raised = RAISED.get(way)
    told = ""
    with octet_slaves(SPEC, LAMPS_SPEC) as (path, there), heard(there) as words:
        with contextlib.nullcontext() if raised is None else pytest.raises(raised):
            getattr(Ways(path, "asyncio"), way)()
        eventually(lambda: bool(words) and words[-1] == "clear", "Clear")
        told = "\n".join(record.getMessage() for record in caplog.records if record.name == "dpstack")
        check(TABLE[way, "asyncio"], words, told or (raised.__name__ if raised is KeyboardInterrupt else ""))


def as_program(way: str, driver: str) -> None:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT / "tests" / "kits"), str(ROOT)])}
    with octet_slaves(SPEC, LAMPS_SPEC) as (path, there), heard(there) as words:
        command = [sys.executable, str(ROOT / "tests" / "kits" / "ends_programs.py"), path, driver, way]
        ended = subprocess.run(command, capture_output=True, text=True, timeout=HANG_S, env=environment, check=False)
        assert ended.stdout.startswith("live\n"), ended.stderr
        row = TABLE[way, driver]
        if row.clear:
            eventually(lambda: "clear" in words[words.index(LIVE) :], "Clear")
        idle = there.idle
        eventually(lambda: there.idle > idle, "silence")
        check(row, words, "" if way in RAISED and way != "ctrl_c_three_times" else ended.stderr)
        if way == "a_forked_child_ends":
            assert "goes on" in ended.stdout


@pytest.mark.parametrize(
    ("way", "driver"),
    [
        ("the_interpreter_ends", "asyncio"),
        ("ctrl_c_without_asyncio_run", "asyncio"),
        ("a_forked_child_ends", "process"),
        ("os_exit", "process"),
    ],
)
def test_as_programs(way: str, driver: str) -> None:
    as_program(way, driver)


@pytest.mark.soak
@pytest.mark.parametrize("driver", DRIVERS)
@pytest.mark.parametrize("way", WAYS)
def test_every_row_as_a_program(way: str, driver: str) -> None:
    as_program(way, driver)


def closed_loop(path: str, before_it_is_closed: Callable[[], None]) -> dpstack.Bus:
    """A bus in Operate whose loop is closed."""
    ways = Ways(path, "asyncio")
    loop = asyncio.new_event_loop()
    bus = loop.run_until_complete(ways.opened())
    before_it_is_closed()
    loop.close()
    return bus


def test_the_finaliser_sends_nothing_where_somebody_else_sends(caplog: pytest.LogCaptureFixture) -> None:
    """A token between two others arrived when the loop stood still: ours is gone."""
    with octet_slaves(SPEC, LAMPS_SPEC) as (path, there):
        bus = closed_loop(path, lambda: foreign_token(there))
        (record,) = caplog.records
        assert record.levelno == logging.ERROR
        assert "could not be sent: somebody else sends on the bus" in record.getMessage()
        assert "The slaves' watchdogs make their outputs safe within" in record.getMessage()
        assert there.slaves[4].outputs == b"\x11\x22"
        assert there.slaves[4].control != b"\x02\x00"
        with pytest.raises(dpstack.UsageError, match="left with its event loop"):
            bus.command(object())
        asyncio.run(bus.close())  # nothing is left to be closed


def foreign_token(there: Responder) -> None:
    os.write(there.fd, b"\xdc\x05\x07")


def test_the_finaliser_sends_nothing_beside_other_masters(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    with octet_slaves(SPEC, LAMPS_SPEC) as (path, there):
        closed_loop(
            path, lambda: monkeypatch.setattr(ActiveStation, "las", property(lambda _station: frozenset({2, 7, 9})))
        )
        (record,) = caplog.records
        assert (
            "masters 7, 9 may hold the token by now, and without the token nothing may be sent" in record.getMessage()
        )
        assert there.slaves[4].outputs == b"\x11\x22"
        assert there.slaves[4].control != b"\x02\x00"


def test_the_child_of_a_fork_gets_an_epoll_of_its_own_whatever_loop_has_it() -> None:
    """asyncio keeps its epoll in the selector; other loops (uvloop) show it nowhere in Python."""
    fd = os.eventfd(0)
    with select.epoll() as of_loop:
        of_loop.register(fd, select.EPOLLIN)
        pid = os.fork()
        if not pid:
            try:
                shutdown._replace_epoll(fd)
                of_loop.unregister(fd)
            finally:
                os._exit(0)
        os.waitpid(pid, 0)
        os.eventfd_write(fd, 1)
        assert of_loop.poll(0) == [(fd, select.EPOLLIN)]
    os.close(fd)


def test_close_in_another_thread_has_the_loop_make_the_end() -> None:
    with octet_slaves(SPEC, LAMPS_SPEC) as (path, there), heard(there) as words:

        async def main() -> None:
            async with ways.bus() as bus:
                await ways.live(bus)
                await asyncio.to_thread(asyncio.run, bus.close())
                assert not bus.is_open

        ways = Ways(path, "asyncio")
        asyncio.run(main())
        eventually(lambda: bool(words) and words[-1] == "clear", "Clear")
        check(TABLE["the_block_ends", "asyncio"], words, "")


def test_another_task_blocks_the_loop_for_longer_than_the_end_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """The time in which the loop does not run is none in which the master could have ended."""
    monkeypatch.setattr(of_drivers, "END_LIMIT", 50_000_000)

    with octet_slaves(SPEC, LAMPS_SPEC) as (path, there), heard(there) as words:

        async def main() -> None:
            async with ways.bus() as bus:
                await ways.live(bus)
                # safe values stand for 50 ms
                asyncio.get_running_loop().call_later(0.02, time.sleep, ns_to_s(bus.rotation_limit_ns * 10) + 0.2)
            assert not bus.end_failed

        ways = Ways(path, "asyncio")
        asyncio.run(main())
        eventually(lambda: bool(words) and words[-1] == "clear", "Clear")
        check(TABLE["the_block_ends", "asyncio"], words, "")


def test_a_closed_bus_leaves_no_finaliser(caplog: pytest.LogCaptureFixture) -> None:
    with octet_slaves(SPEC, LAMPS_SPEC) as (path, _there):
        Ways(path, "asyncio").the_block_ends()
        assert caplog.records == []


@pytest.mark.parametrize("then", ["closed", "goes on"])
def test_ctrl_c_in_the_middle_of_a_telegram(then: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without asyncio.run() the first Ctrl-C raises KeyboardInterrupt wherever the program is: here as it writes."""
    interrupted: list[bytes] = []
    write = TtyPort.write

    def interrupt(port: TtyPort, octets: bytes) -> bool:
        taken = write(port, octets)
        if octets[7:9] == bytes.fromhex(LIVE) and not interrupted:
            interrupted.append(octets)
            raise KeyboardInterrupt
        return taken

    with octet_slaves(SPEC, LAMPS_SPEC) as (path, there), heard(there) as words:
        ways = Ways(path, "asyncio")
        loop = asyncio.new_event_loop()
        monkeypatch.setattr(TtyPort, "write", interrupt)
        with pytest.raises(KeyboardInterrupt):
            loop.run_until_complete(ways.opened())
        assert ways.bus_left is not None
        if then == "goes on":
            loop.run_until_complete(ways.bus_left.rotated(ways.bus_left.stats.rotations + 5, HANG_S))
            loop.run_until_complete(ways.bus_left.close())
        loop.close()
        eventually(lambda: bool(words) and words[-1] == "clear", "Clear")
        check(TABLE["the_loop_is_closed", "asyncio"], words, "was not closed before its event loop was")
