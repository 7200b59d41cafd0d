"""docs/explanation/ends.md: its table is the data, the data are what a slave that knows octets only records; the
finaliser."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import re
import select
import time
from collections.abc import Callable

import pytest
from ends.programs import Ways
from ends.rows import WAYS, kept, measure, plain, rows
from ends.telegrams import heard, is_in_order
from far_ends import HANG_S, eventually
from process_kit import LAMPS_SPEC, SPEC, octet_slaves
from support_responder import Responder

import dpstack
from dpstack.api.bus import shutdown
from dpstack.api.bus.bus import core_of
from dpstack.drivers.line import shutdown as of_drivers
from dpstack.fdl.active.station import ActiveStation
from dpstack.ports.tty import TtyPort
from dpstack.units import ns_to_s
from tools.make_ends_docs import TARGET, render

LIVE, SAFE = "1122", "a55a"
ROWS = {row.key: row for row in rows()}
#: applications by way and driver, as they were measured
APPLICATIONS = {key: row for key, row in ROWS.items() if row.program == "application" and row.act is None}
TABLE = {(row.way, row.driver): kept()[key] for key, row in APPLICATIONS.items() if row.way != "waits"}


def check(way: str, words: list[str], told: str) -> None:
    """With the asyncio driver the slave has received what the table says in ``words``; the log has ``told``."""
    row = TABLE[way, "asyncio"]
    assert LIVE in words
    assert row["last"] == "safe values, Clear"
    assert is_in_order(words, live=LIVE, safe=SAFE), words
    said = [part for part in row["told"].split(" / ") if part.startswith("the bus on")]
    assert [plain(line).replace(plain_port(line), "PORT") for line in told.splitlines()] == said


def plain_port(line: str) -> str:
    found = re.match(r"the bus on (\S+)", line)
    return found[1] if found else "PORT"


def test_the_data_have_every_row_and_the_page_has_the_data() -> None:
    assert list(kept()) == list(ROWS)
    assert {way for way, _ in TABLE} == {name for ways in WAYS.values() for name in ways}
    page = TARGET.read_text(encoding="utf-8")
    assert page == render(page, kept()), "run: python tools/make_ends_docs.py"


def test_no_row_says_that_a_program_hangs_or_an_end_is_missing() -> None:
    """Outputs stay live after a program's end only where nobody was left that could have sent anything."""
    for key, found in kept().items():
        assert "HANGS" not in found["exit"], key
        assert "NOT MEASURED" not in found["exit"], key
        row = ROWS[key]
        if found["last"] == "live outputs" and found["exit"] not in ("goes on", "stopped"):
            killed = found["exit"].startswith("killed by SIG") and row.driver == "asyncio"
            bus_process = row.group == "bus process" and row.text.startswith(("SIGSEGV", "SIGKILL"))
            exits = row.way in ("os_exit", "os_execv") and row.driver == "asyncio"
            assert killed or bus_process or exits or row.group == "port", key


@pytest.mark.parametrize(
    "key", [pytest.param(key, marks=() if row.quick else pytest.mark.soak) for key, row in ROWS.items()]
)
def test_every_row(key: str) -> None:
    assert measure(ROWS[key]) == kept()[key], f"when it is meant: python tests/kits/ends {key!r}"


#: what can be seen from within the process of the test
HERE = (
    *("the_block_ends", "an_exception", "ctrl_c_three_times", "anyio_scope", "sys_exit_in_a_callback"),
    *("nobody_closes_it", "closed_in_another_loop", "the_loop_is_closed"),
)
RAISED: dict[str, type[BaseException]] = {
    "an_exception": ZeroDivisionError,
    "ctrl_c_three_times": KeyboardInterrupt,
    "sys_exit_in_a_callback": SystemExit,
}


@pytest.mark.parametrize("way", HERE)
def test_within_this_process(way: str, caplog: pytest.LogCaptureFixture) -> None:
    raised = RAISED.get(way)
    with octet_slaves(SPEC, LAMPS_SPEC) as (path, there), heard(there) as words:
        with contextlib.nullcontext() if raised is None else pytest.raises(raised):
            getattr(Ways(path, "asyncio"), way)()
        eventually(lambda: bool(words) and words[-1] == "clear", "Clear")
        check(way, words, "\n".join(record.getMessage() for record in remarks(caplog)))


def remarks(caplog: pytest.LogCaptureFixture) -> list[logging.LogRecord]:
    """Records about the end; not those of events."""
    return [record for record in caplog.records if record.name == "dpstack"]


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
        (record,) = remarks(caplog)
        assert record.levelno == logging.ERROR
        assert "could not be sent: somebody else sends on the bus" in record.getMessage()
        assert "The slaves' watchdogs make their outputs safe within" in record.getMessage()
        assert there.slaves[4].outputs == b"\x11\x22"
        assert there.slaves[4].control != b"\x02\x00"
        with pytest.raises(dpstack.UsageError, match="left with its event loop"):
            core_of(bus).command(object())
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
        (record,) = remarks(caplog)
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
        check("the_block_ends", words, "")


def test_another_task_blocks_the_loop_for_longer_than_the_end_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """The time in which the loop does not run is none in which the master could have ended."""
    monkeypatch.setattr(of_drivers, "END_LIMIT", 50_000_000)

    with octet_slaves(SPEC, LAMPS_SPEC) as (path, there), heard(there) as words:

        async def main() -> None:
            async with ways.bus() as bus:
                await ways.live(bus)
                # safe values stand for 50 ms
                asyncio.get_running_loop().call_later(
                    0.02, time.sleep, ns_to_s(core_of(bus).rotation_limit_ns * 10) + 0.2
                )
            assert not bus.end_failed

        ways = Ways(path, "asyncio")
        asyncio.run(main())
        eventually(lambda: bool(words) and words[-1] == "clear", "Clear")
        check("the_block_ends", words, "")


def test_a_closed_bus_leaves_no_finaliser(caplog: pytest.LogCaptureFixture) -> None:
    with octet_slaves(SPEC, LAMPS_SPEC) as (path, _there):
        Ways(path, "asyncio").the_block_ends()
        assert remarks(caplog) == []


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
        assert is_in_order(words, live=LIVE, safe=SAFE), words
