"""``dpstack fleet``: what it refuses, its table, its lines, its JSON, its exit codes."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from fleet_kit import GOOD
from rich.console import Console

from dpstack.boottime import boottime_s
from dpstack.bridge.mqtt.fleet import Fleet, State
from dpstack.bridge.mqtt.fleet_reader import FleetReader
from dpstack.cli.looking.fleet_view import FleetView
from dpstack.cli.main import main

LOST: dict[str, Any] = GOOD | {
    "verdict": "critical",
    "reasons": ["slave 5: fault of the drive"],
    "lost": [{"address": 8, "name": "valves\x1b[2J", "state": "offline"}],
    "more_lost": 1,
}


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ("--mqtt http://x", "--mqtt 'http://x' is no address of a broker; write mqtt://HOST:PORT"),
        ("--mqtt mqtt://x:0", "--mqtt 'mqtt://x:0' is no address of a broker"),
        (
            "--mqtt mqtt://me:sesame@x",
            "--mqtt: user and password have keys of their own (--user, --password-file); take them out",
        ),
        ("--mqtt mqtt://x --password-env NO_SUCH", "--password-env: the environment has no variable 'NO_SUCH'"),
        ("--mqtt mqtt://x --password-file /none", "--password-file /none"),
        ("--mqtt mqtt://x --ca /none", "--ca, --cert and --key need TLS; write mqtts:// in --mqtt"),
        ("--mqtt mqtts://x --ca /none/key.pem", "--ca /none/key.pem: No such file"),
        ("--mqtt mqtts://x --cert /none", "--cert and --key go together; give both"),
        ("--mqtt mqtt://x --password-file x --password-env y", "--password-env and --password-file are both there"),
        ("--mqtt mqtt://x --group a/b", "--group 'a/b': MQTT does not permit this name"),
        ("--mqtt mqtt://x --rebirth gateway", "write GROUP/NODE, or all"),
        ("--mqtt mqtt://x --expect gateway", "--expect 'gateway': write GROUP/NODE"),
        ("--mqtt mqtt://x --group hall --expect yard/saw", "--expect: yard is not the group of --group"),
        ("", "--mqtt"),
    ],
)
def test_wrong_use(words: str, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    try:
        code = main(["fleet", *words.split()])
    except SystemExit as end:
        code = int(end.code or 0)
    said = capsys.readouterr()
    assert code == 2
    assert said.out == ""
    assert text in said.err
    assert "sesame" not in said.err


def test_without_the_extra_it_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert main(["fleet", "--mqtt", "mqtt://x"]) == 2
    assert "dpstack fleet needs aiomqtt: pip install 'dpstack[mqtt]'" in capsys.readouterr().err


def test_a_broker_that_is_not_there_is_told_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fleet", "--mqtt", "mqtt://127.0.0.1:9", "--seconds", "0.3"]) == 1
    said = capsys.readouterr()
    assert said.err.count("\n") == 1
    assert "broker 127.0.0.1:9: " in said.err
    assert "it is tried again" in said.err
    assert said.out.splitlines()[-1] == "0 segments"


def fill(fleet: Fleet, now: float) -> None:
    for node, given in (("a", GOOD), ("b", LOST), ("c", GOOD | {"state": "ended"})):
        fleet.receive(f"dpstack/hall 3/{node}/status", json.dumps(given).encode(), now, expiry=27)
    for number in range(40):
        fleet.receive(f"dpstack/more/{number}/status", json.dumps(GOOD).encode(), now)


def in_loop(work: Callable[[Fleet, float], None]) -> None:
    async def run() -> None:
        fleet, now = Fleet(), boottime_s()
        fill(fleet, now)
        work(fleet, now)

    asyncio.run(run())


def drawn(fleet: Fleet, width: int, height: int) -> tuple[FleetView, str]:
    """A view of ``fleet``, and what it draws in a window."""
    view = FleetView(fleet, "broker:1883", json=False, redraws=True)
    view.begin(cast("FleetReader", SimpleNamespace(lost=0, connected=True)))
    console = Console(width=width, height=height)
    with console.capture() as got:
        console.print(view.picture())
    return view, got.get()


@pytest.mark.parametrize(("width", "height"), [(100, 24), (40, 12), (200, 60)])
def test_the_table_shows_the_worst_first_and_fits(width: int, height: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    monkeypatch.setenv("LINES", str(height))

    def work(fleet: Fleet, now: float) -> None:
        _, shown = drawn(fleet, width, height)
        lines = shown.splitlines()
        assert len(lines) <= height
        flat = " ".join(shown.split())
        assert "43 segments: 1 lost slaves, 1 ended, 41 ok" in flat
        assert "\x1b[2J" not in shown
        if width == 200:
            assert "more segments" not in flat
            row = next(line for line in lines if "lost slaves" in line and "hall 3" in line)
            assert r"valves\x1b[2J (8, offline), and 1 more; slave 5: fault of the drive" in row
            assert " 3 s " in row  # 27 of 30 s were left
            assert lines.index(row) < next(at for at, line in enumerate(lines) if " ended " in line and "hall" in line)
        elif width == 100:
            assert "more segments, none of them worse" in flat

    in_loop(work)


@pytest.mark.parametrize("as_json", [False, True])
def test_expected_segments_that_are_missing_and_a_fleet_of_nobody_are_failures(
    capsys: pytest.CaptureFixture[str], as_json: bool
) -> None:
    """A look by cron or Nagios: a plant whose gateway never came was a success."""

    def end_of(*expected: tuple[str, str], nodes: tuple[str, ...] = ("press",)) -> tuple[bool, str]:
        fleet = Fleet()
        for node in nodes:
            fleet.receive(f"dpstack/hall/{node}/status", json.dumps(GOOD).encode(), boottime_s())
        view = FleetView(fleet, "broker:1883", json=as_json, redraws=False, expected=expected)
        view.begin(cast("FleetReader", SimpleNamespace(lost=0, connected=True)))
        capsys.readouterr()
        return view.end(), capsys.readouterr().out

    async def run() -> None:
        assert end_of(("hall", "press"))[0] is False
        failed, said = end_of(("hall", "press"), ("hall", "sa\x1bw"))
        assert failed
        if as_json:
            assert json.loads(said)["missing"] == ["hall/sa\\x1bw"]
        else:
            assert "hall/sa\\x1bw: missing: broker:1883 has no status of it" in said
        failed, said = end_of(nodes=())
        assert failed
        assert as_json or "broker:1883 has no status of any segment" in said

    asyncio.run(run())


def test_after_a_sleep_of_the_computer_nothing_old_is_drawn_as_alive(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("dpstack.cli.looking.fleet_view.boottime_s", lambda: boottime_s() + 3600)

    def work(fleet: Fleet, now: float) -> None:
        view, shown = drawn(fleet, 100, 24)
        assert "43 segments: 42 silent, 1 ended" in " ".join(shown.split())
        fill(fleet, now)
        assert view.end()

    in_loop(work)
    assert "43 segments: 42 silent, 1 ended" in capsys.readouterr().out


@pytest.mark.parametrize(("width", "height"), [(40, 24), (40, 12), (60, 24), (60, 3), (20, 24)])
def test_a_narrow_window_shows_the_segment_that_has_lost_slaves(
    width: int, height: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    monkeypatch.setenv("LINES", str(height))

    def work(fleet: Fleet, now: float) -> None:
        north = GOOD | {"lost": [{"address": 12, "name": "hoist " * 40, "state": "offline"}]}
        fleet.receive("dpstack/hall 5/packaging machine north side/status", json.dumps(north).encode(), now)
        _, shown = drawn(fleet, width, height)
        lines = shown.splitlines()
        assert all(len(line) <= width for line in lines)
        flat = " ".join(shown.split())
        assert "\x1b[2J" not in shown
        assert "lost slaves hall 3/b 3 s" in flat
        if height > 3:
            assert len(lines) <= height
            assert "valves" in flat
            assert flat.index("valves") < flat.index("hall 5/")
            assert "more segments" in flat
            assert width != 40 or lines[-1].rstrip().endswith("more segments, none of them worse")

    in_loop(work)


def test_json_and_plain_lines(capsys: pytest.CaptureFixture[str]) -> None:
    def work(fleet: Fleet, now: float) -> None:
        segment = fleet.get("hall 3", "b")
        assert segment is not None
        for json_ in (True, False):
            view = FleetView(fleet, "broker:1883", json=json_, redraws=False)
            view.begin(cast("FleetReader", SimpleNamespace(lost=2, connected=True)))
            view.tell("connected to broker:1883")
            view.show(segment)
            assert view.end()

    in_loop(work)
    lines = capsys.readouterr().out.splitlines()
    start, broker, shown, summary = map(json.loads, lines[:4])
    assert (start["event"], start["broker"]) == ("start", "broker:1883")
    assert (broker["connected"], broker["text"]) == (True, "connected to broker:1883")
    assert (shown["group"], shown["node"], shown["state"], shown["more_lost"]) == ("hall 3", "b", "lost_slaves", 1)
    assert 2.9 < shown["age_s"] < 9
    assert (summary["segments"], summary["lost"]) == (43, 2)
    assert summary["states"] == {"lost_slaves": 1, "ended": 1, "ok": 41}
    assert r"hall 3/b: lost slaves: valves\x1b[2J (8, offline), and 1 more" in lines[5]
    assert lines[-1] == "2 messages came faster than they could be read"


def test_the_pages_name_each_state() -> None:
    page = (Path(__file__).parents[2] / "docs" / "how-to" / "fleet.md").read_text()
    assert all(f"| {state.value} |" in page for state in State)
