"""The wire that rotations are judged on: literal octets against times counted by hand; the benchmarks run on it."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from bench import commit_probe, cycle, jitter, rotation, startup, usb
from bench.jitter import Beside, Cycles, Lateness, cycles_of
from bench.peers import table as peers
from bench.records import Record, pty_share, rotations
from bench.report import Report
from bench.rig import MasterFailedError, Taken, bench, one_round, pinned, unavailable
from bench.settings import SETTINGS, environment
from bench.wire import Wire

MS = 1_000_000
#: at 500 kbit/s a bit takes 2 us, an octet 22 us
OCTET = 22_000
#: Set_Prm and Chk_Cfg of slave 3 from station 2, Data_Exchange with 12 octets, the token
PRM = bytes.fromhex("68 0c 0c 68 83 82 6d 3d 3e 80 01 01 0b 06 96 00")
CFG = bytes.fromhex("68 07 07 68 83 82 5d 3e 3e f3 71")
EXCHANGE = bytes.fromhex("68 0f 0f 68 03 02 7d 00 01 02 03 04 05 06 07 08 09 0a 0b")
TOKEN = bytes.fromhex("dc0202")


def whole(telegram: bytes) -> bytes:
    """With check sum and end."""
    return telegram + bytes((sum(telegram[4:]) & 0xFF, 0x16))


def wire(**options: int) -> Wire:
    """One slave at 500 kbit/s in data exchange; nothing of its bring-up is left."""
    usual = {"baud": 500_000, "min_tsdr": 11, "t_id1": 37, "t_id2": 100, "t_sl": 200, "slice_bits": 50}
    adapter = {"frame_us": 0, "latency_ms": 16, "packet": 62, "collide": 0}
    made = Wire(["3:0696:f371:12:12"], argparse.Namespace(**usual, **adapter | options))
    made.take(whole(PRM), 1 * MS)
    made.take(whole(CFG), 5 * MS)
    made.records.clear()
    made.pieces.clear()
    return made


def test_an_exchange_takes_what_its_octets_take() -> None:
    line = wire()
    line.take(whole(EXCHANGE), 100 * MS)
    (record,) = line.records
    read, begin, end, answer_end, due, _written, first, to, octets, answer_octets = record
    assert (read, begin) == (100 * MS, 100 * MS)
    assert end == 100 * MS + 21 * OCTET
    assert answer_end == due == end + 11 * 2_000 + 21 * OCTET
    assert (first, to, octets, answer_octets) == (0x68, 3, 21, 21)
    assert line.held == 0


def test_an_answer_comes_in_slices_each_when_its_last_bit_is_there() -> None:
    line = wire()
    line.take(whole(EXCHANGE), 100 * MS)
    starts = 100 * MS + 21 * OCTET + 22_000
    assert [(at - starts, len(octets)) for at, octets in line.pieces] == [
        (4 * OCTET, 4),
        (8 * OCTET, 4),
        (12 * OCTET, 4),
        (16 * OCTET, 4),
        (20 * OCTET, 4),
        (21 * OCTET, 1),
    ]
    mirrored = b"".join(octets for _, octets in line.pieces)
    assert mirrored == whole(bytes.fromhex("680f0f68020308000102030405060708090a0b"))


def test_a_telegram_before_the_end_of_its_idle_time_waits_and_is_counted() -> None:
    line = wire()
    line.take(TOKEN, 100 * MS)
    line.take(whole(EXCHANGE), 100 * MS + 10_000)
    token, exchange = line.records
    assert token[2] == 100 * MS + 3 * OCTET
    assert exchange[1] == token[2] + 37 * 2_000  # T_ID1
    assert line.held == 1


def test_a_request_before_the_end_of_an_answer_is_held_back_or_spoils_both() -> None:
    for collide, answers in ((0, 12), (1, 6)):
        line = wire(collide=collide)
        line.take(whole(EXCHANGE), 100 * MS)
        heard = b"".join(octets for _, octets in line.pieces)
        line.take(whole(EXCHANGE), 100 * MS + 30 * OCTET)
        first, second = line.records
        assert second[1] == first[3] + 37 * 2_000
        assert bool(second[3]) is not bool(collide)
        assert len(line.pieces) == answers
        inverted = bytes(octet ^ 0xFF for octet in b"".join(octets for _, octets in line.pieces))
        assert (inverted == heard) is bool(collide)
    line.take(whole(EXCHANGE), 200 * MS)
    assert line.records[-1][3]  # the next one is answered again


def test_a_broadcast_is_followed_by_t_id2_and_silence_by_the_slot_time() -> None:
    control = whole(bytes.fromhex("68 07 07 68 ff 82 46 3a 3e 00 00"))
    status = bytes.fromhex("100902494516")[:4]
    status += bytes((sum(status[1:]) & 0xFF, 0x16))
    for request, octets, idle in ((control, 13, 100), (status, 6, 200)):
        line = wire()
        line.take(request, 100 * MS)
        line.take(TOKEN, 100 * MS)
        assert line.records[1][1] == 100 * MS + octets * OCTET + idle * 2_000
        assert line.pieces == []


def test_behind_an_adapter_everything_waits_for_frames_and_the_timer() -> None:
    line = wire(frame_us=1000, latency_ms=16)
    line.take(whole(EXCHANGE), 100 * MS + 1)
    (record,) = line.records
    assert record[1] == 101 * MS  # the next frame
    ((at, octets),) = line.pieces
    assert len(octets) == 21
    assert at % MS == 0
    assert at >= record[3]
    # at least one octet is there when the timer runs out: never later than its period and a frame behind the answer
    assert at <= record[3] + 17 * MS


def test_a_full_packet_waits_for_no_timer() -> None:
    line = wire(frame_us=1000, latency_ms=255, packet=21)
    line.take(whole(EXCHANGE), 100 * MS)
    ((at, _octets),) = line.pieces
    assert at == 101 * MS  # 946 us on the wire


def recorded() -> Iterator[Record]:
    """Three rounds over slaves 3 and 4 and the token at 500 kbit/s, each exchange 60 us later than by the rules."""
    at = 0
    for _ in range(3):
        for to in (3, 4):
            end = at + 21 * OCTET + 22_000 + 21 * OCTET
            yield Record(at, at, at + 21 * OCTET, end, end, end + 5_000, 0x68, to, 21, 21)
            at = end + 37 * 2_000 + 60_000
        yield Record(at, at, at + 3 * OCTET, 0, 0, 0, 0xDC, -1, 3, 0)
        at += 3 * OCTET + 37 * 2_000


def test_a_rotation_is_judged_by_what_was_sent_in_it() -> None:
    ruled = 2 * (21 + 21) * OCTET + 2 * (11 + 37) * 2_000 + 3 * OCTET + 37 * 2_000
    assert [(r.wire, r.took, r.exchanges) for r in rotations(list(recorded()), 500_000)] == [
        (ruled, ruled + 120_000, 2),
        (ruled, ruled + 120_000, 2),
    ]
    assert pty_share(list(recorded()), 500_000) == 55_000  # the wire's own lateness is not the pty's


def begins(*times_ms: float) -> list[Record]:
    """First exchanges of rounds at these times."""
    return [Record(round(t * MS), 0, 0, 0, 0, 0, 0x68, 3, 21, 21) for t in times_ms]


def test_a_late_round_does_not_make_the_next_ones_late() -> None:
    late = Lateness(begins(0, 10, 20.5, 30, 40.1), 10, 0)
    assert [round(ns / MS, 3) for ns in late.late] == [0, 0, 0.5, 0, 0.1]
    assert late.missed == 0


def test_rounds_that_a_stall_has_swallowed_are_missed_and_a_long_pause_is_a_gap() -> None:
    late = Lateness(begins(0, 10, 64, 70, 80), 10, 0)
    assert late.missed == 4
    assert late.gaps == 1
    assert late.quantile_us(1.0) == pytest.approx(4_000)


def test_a_round_more_than_a_cycle_late_keeps_its_place() -> None:
    late = Lateness(begins(0, 10, 31, 32, 40, 50), 10, 0)
    assert [round(ns / MS, 3) for ns in late.late] == [0, 0, 11, 2, 0, 0]
    assert late.missed == 0


def test_the_first_round_may_be_a_late_one() -> None:
    late = Lateness(begins(3, 10, 20, 30), 10, 0)
    assert [round(ns / MS, 3) for ns in late.late] == [3, 0, 0, 0]


def test_late_rounds_all_over_the_cycle_do_not_move_the_grid() -> None:
    late = Lateness(begins(*(10 * n + n % 9 for n in range(18))), 10, -30 * MS)
    assert [round(ns / MS, 3) for ns in late.late] == [*range(9), *range(9)]
    assert late.missed == 0


def test_a_round_that_the_wire_reads_just_before_it_was_due_keeps_its_place() -> None:
    late = Lateness(begins(0, 9.95, 20, 30.5), 10, 0)
    assert [round(ns / MS, 3) for ns in late.late] == [0, -0.05, 0, 0.5]
    assert late.missed == 0


def words(line: str) -> list[str]:
    """As a shell would split it."""
    return line.split()


def titles(report: Report) -> set[str]:
    """Names of its figures; every one has a value, and the whole can be told."""
    assert json.loads(report.finished().as_json())["benchmark"] == report.name
    assert report.as_text()
    return {figure.name for figure in report.figures}


def test_cycle_runs() -> None:
    names = titles(cycle.run(words("--slaves 2 --rounds 1 --seconds 0.05 --kinds asyncio bare")))
    assert names >= {
        "Python calibration",
        "pipe calibration",
        "asyncio, 2 slaves: turn-around p50",
        "asyncio, 2 slaves: turn-around p99",
        "asyncio, 2 slaves: with the token to itself between p50",
        "asyncio, 2 slaves: CPU time per exchange",
        "bare, 2 slaves: exchanges per second",
        "asyncio, 2 slaves: exchanges per second to a bare loop's",
    }


def test_rotation_runs() -> None:
    report = rotation.run(words("--bauds 3000000 --slaves 2 --rounds 1 --seconds 0.05 --kinds asyncio bare"))
    assert titles(report) >= {
        "3 Mbit/s: rotation by the rules",
        "3 Mbit/s: the pty's own share per exchange",
        "3 Mbit/s: the wire's own lateness p50",
        "3 Mbit/s, asyncio: rotation p50",
        "3 Mbit/s, asyncio: efficiency p50",
        "3 Mbit/s, asyncio: efficiency p50 without the pty's share",
        "3 Mbit/s, asyncio: efficiency to the bare loop's",
        "3 Mbit/s, asyncio: CPU time per exchange",
    }
    (ruled,) = [f.value for f in report.figures if f.name.endswith("by the rules")]
    assert ruled == pytest.approx((2 * (42 * 11 + 11 + 46) + 33 + 46) / 3, abs=0.01)


@pytest.mark.parametrize(
    ("bare", "verdict"), [([0.8, 0.82, 0.6], "met"), ([0.4, 0.41, 0.9], "no verdict"), ([0.95, 0.94, 0.93], "MISSED")]
)
def test_a_driver_is_judged_by_the_bare_loop_unless_that_keeps_the_wire_idle(bare: list[float], verdict: str) -> None:
    report = Report("rotation")
    rotation.to_bare(report, "3 Mbit/s", {"process": [0.8, 0.8, 0.57], "bare": bare}, 0.90)
    (figure,) = report.figures
    assert figure.name == "3 Mbit/s, process: efficiency to the bare loop's"
    assert figure.rounds == pytest.approx([0.8 / bare[0], 0.8 / bare[1], 0.57 / bare[2]])
    assert {"met": True, "MISSED": False, "no verdict": None}[verdict] is figure.met
    assert report.notes == (
        ["3 Mbit/s: no verdict: the bare loop's own efficiency is 0.41, less than 0.5"] if figure.met is None else []
    )


def test_the_cpu_time_of_an_exchange_is_given_with_what_decides_it() -> None:
    def run(cpu: int, sleeps: int, preempted: int) -> Taken:
        return Taken(0.5, 500, cpu, 0.0, [], 0, [], [], 1.0, 0, sleeps, preempted)

    report = Report("rotation")
    taken = {
        "asyncio": [run(50_000_000, 1000, 50)],
        "bare": [run(40_000_000, 3000, 0)],
    }
    rotation.add_cpu(report, "500 kbit/s", taken, {"bare": 7.0})
    values = {figure.name.removeprefix("500 kbit/s"): figure.value for figure in report.figures}
    assert values.pop(": CPU time of one sleep and wake-up") > 0
    assert values == {
        ", asyncio: sleeps per exchange": 2,
        ", asyncio: preemptions per exchange": 0.1,
        ", asyncio: CPU time to that of the clock": 0.1,
        ", bare: sleeps per exchange": 6,
        ", bare: preemptions per exchange": 0,
        ", bare: system calls per exchange": 7,
        ", bare: CPU time to that of the clock": 0.08,
        ", asyncio: CPU time per exchange to the bare loop's": 1.25,
    }
    assert [figure.met for figure in report.figures if figure.goal is not None] == [False]


def test_peers_runs_masters_of_others_as_programs_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "profirust"
    program.write_text(
        f'#!/bin/sh\nexec {sys.executable} -m bench.masters bare "$1" --baud 500000 --slaves "$2" --t-id1 "$3"\n'
    )
    program.chmod(0o700)
    monkeypatch.setattr(peers, "_TITLES", {"bare": "bare loop", "profirust 37": "profirust, 37 us"})
    report = peers.run(["--profirust", str(program), *words("--slaves 2 --rounds 1 --seconds 0.05")])
    assert titles(report) >= {
        f"2 slaves, {kind}: {figure}"
        for kind in ("bare", "profirust 37")
        for figure in (
            "CPU time per exchange",
            "CPU time per exchange to the bare loop's",
            "exchanges per second",
            "time on the wire to rotation",
            "share of requests sent too soon",
        )
    }
    rows = [note for note in report.notes if note.startswith("| ")]
    assert [row.split(" | ")[0] for row in rows] == ["| 2 slaves", "| bare loop", "| profirust, 37 us"]
    assert all(row.count("|") == 8 for row in rows)


def test_usb_runs() -> None:
    names = titles(usb.run(words("--bauds 1500000 --slaves 2 --timers 1 --rounds 1 --seconds 0.05 --kinds asyncio")))
    assert names >= {
        "1.5 Mbit/s, timer 1 ms, asyncio: rotation p50",
        "1.5 Mbit/s, timer 1 ms, asyncio: wire per exchange",
        "1.5 Mbit/s, timer 1 ms, asyncio: adapter per exchange",
        "1.5 Mbit/s, timer 1 ms, asyncio: stack per exchange",
    }


def test_startup_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    for pause in ("_REST_S", "_SETTLE_S"):
        monkeypatch.setattr(commit_probe, pause, 0.1)
    report = startup.run(words("--slaves 2 --rounds 1 --kinds asyncio --connectors metrics"))
    commands = ("--version", "ctl status")
    names = {f"dpstack {c}: CPU time beside python -c 'import argparse, json, socket'" for c in commands}
    names |= {f"{way}, asyncio, until the first octet: CPU time" for way in ("dpstack run", "open_bus")}
    names |= {f"asyncio, 2 slaves in data exchange: {figure}" for figure in ("CPU time", "PSS")}
    names |= {"Python calibration", "dpstack --version: CPU time", "metrics: CPU time of the application"}
    assert titles(report) == names | {"metrics: PSS of the application", "metrics: PSS with its bus process"}
    alone, both = (figure.value for figure in report.figures[-2:])
    assert 5 < alone < both - 5 < 100  # MB


def test_jitter_runs_or_says_why_not() -> None:
    report = jitter.run(words("--cycles 10 --apps idle --rounds 1 --seconds 0.1 --kinds asyncio"))
    refused = unavailable("asyncio", 10.0)
    assert not refused or refused in report.notes
    figures = ("lateness p50", "lateness p99", "lateness p99.9", "lateness max", "missed rounds", "gaps a second")
    assert titles(report) == (set() if refused else {f"asyncio, 10 ms, idle: {figure}" for figure in figures})


def test_the_wake_ups_of_a_bare_loop_are_counted_by_places() -> None:
    """A cycle of 1 ms, late from 0.1 ms on; two places without a wake-up."""
    ms = 1_000_000
    due = [0, ms, 2 * ms, 5 * ms]
    woke = list(zip(due, (100_000, ms + 100_001, 2 * ms, 5 * ms + 400_000), strict=True))
    assert cycles_of(woke, 1.0) == (4, 2, 2, 0)
    assert cycles_of(woke, 1.0).percent == pytest.approx(400 / 6)
    assert cycles_of([], 1.0) == (0, 0, 0, 0)


@pytest.mark.parametrize(
    ("loop_late", "ratio", "goal"),
    [((10, 12), 1.5, 1.5), ((10, 15), 1.32, 1.5), ((10, 17), 33 / 27, None), ((0, 0), 16.5, 1.5), ((0, 2), 11.0, 1.5)],
    ids=["differ by 2 of 11", "5 of 12.5, of which 2 are chance", "7 of 13.5: no verdict", "never late", "by chance"],
)
def test_the_verdict_beside_a_loop(loop_late: tuple[int, int], ratio: float, goal: float | None) -> None:
    report = Report("jitter")
    steady, ours = Cycles(1000, 20, 0), (Cycles(990, 5, 10, 3), Cycles(990, 8, 10, 4))
    jitter.compare_with_loops(
        report, "x", [Beside(mine, Cycles(1000, n, 0), steady) for mine, n in zip(ours, loop_late, strict=True)]
    )
    found = {
        figure.name.removeprefix("process, x: late and missed rounds to those of "): figure for figure in report.figures
    }
    assert found["a bare loop"].value == pytest.approx(ratio)
    assert found["a bare loop"].goal == goal
    assert bool(report.notes) is (goal is None)
    assert found["an exchanging loop"].value == pytest.approx(33 / 40)
    assert found["an exchanging loop"].goal == 1.5


def test_one_late_round_beside_none_is_chance_and_two_are_not() -> None:
    for late, met in ((1, True), (2, False)):
        report = Report("jitter")
        jitter.compare_with_loops(report, "x", [Beside(Cycles(200, late, 0), Cycles(200, 0, 0), Cycles(200, 0, 0))] * 4)
        judged = [figure for figure in report.figures if figure.goal is not None]
        assert [figure.met for figure in judged] == [met] * 2


def test_the_bus_process_is_compared_with_loops_of_the_same_settings() -> None:
    report = jitter.run(words("--cycles 10 --apps idle --rounds 1 --seconds 0.3 --kinds process"))
    if unavailable("process", 10.0):
        return
    found = {figure.name: figure for figure in report.figures}
    for loop_name in ("bare", "exchanging"):
        assert 0 <= found[f"{loop_name} loop, 10 ms, idle: late and missed rounds"].value <= 100
    assert "process, 10 ms, idle: late and missed rounds to those of a bare loop" in found
    assert "process, 10 ms, idle: late and missed rounds to those of an exchanging loop" in found


def test_each_setting_can_be_switched_off_alone_and_is_on_alone() -> None:
    found = jitter.variants()
    assert next(iter(found)) == "all"
    assert found["none"] == SETTINGS
    for name in SETTINGS:
        assert found[f"without {name}"] == (name,)
        assert {*found[f"only {name}"], name} == set(SETTINGS)
        assert name not in found[f"only {name}"]


@pytest.mark.parametrize("without", [(), SETTINGS])
def test_a_bus_process_does_without_the_settings_that_are_switched_off(without: tuple[str, ...]) -> None:
    """In a program that only looks like a bus process."""
    program = (
        "import gc, json, os\n"
        "from dpstack.drivers.line.select_loop import SelectLoop\n"
        "from dpstack.drivers.realtime import gc_control, processors, rights\n"
        "gc_control.Collector().begin()\n"
        "awake = processors.AwakeProcessors(); awake.hold(True)\n"
        "print(json.dumps([rights.become_real_time(pty=True) == [], gc.isenabled(), SelectLoop()._lead.ns,"
        " awake._wanted, 'dpstack.drivers.process' in __import__('sys').orig_argv]))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, "dpstack.drivers.process"],
        env=environment(without),
        cwd=Path(__file__).parent.parent,
        capture_output=True,
        text=True,
        check=True,
    )
    ready, collects, lead_ns, awake, is_named = json.loads(done.stdout)
    assert is_named
    assert (collects, lead_ns > 0, awake) == ((True, False, False) if without else (False, True, True))
    assert ready or not without


def test_failures_of_another_stack_are_left_out_and_ours_are_not() -> None:
    def fails(kind: str, slaves: int) -> Taken:
        raise MasterFailedError(f"{kind}, {slaves} slaves: why")

    notes: list[str] = []
    taken: dict[tuple[str, int], list[Taken]] = {("pyprofibus", 64): []}
    one_round(taken, fails, notes)
    assert taken == {}
    assert notes == ["left out: pyprofibus, 64 slaves: why"]
    with pytest.raises(MasterFailedError):
        one_round({("asyncio", 1): []}, fails, notes)


def test_a_master_that_fails_is_told_with_its_reason() -> None:
    with (
        pinned() as where,
        pytest.raises(MasterFailedError, match=r"bare, 1 slaves: RuntimeError: the wire's slaves refuse"),
        bench("bare", 1, 500_000, where, ident=0x1234),
    ):
        pytest.fail("slaves of another ident number never come up")
