"""Tables on narrow terminals: no number is cut, whatever has to give way."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from api_kit import FAN, HOIST, RAW, bus_of, virtual
from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples
from rich.cells import cell_len
from rich.console import Console

from dpstack.api.bus.bus import core_of
from dpstack.api.bus.opening import open_bus
from dpstack.api.commissioning.live_list import LiveListResult
from dpstack.cli.commands import demo, ports, scan
from dpstack.cli.main import main
from dpstack.cli.terminal import drawing, output
from dpstack.cli.terminal.report import Reporter
from dpstack.dp.master.scanner import Found, SlaveView
from dpstack.fdl.telegram import StationType
from dpstack.ports.adapters import AdapterInfo

ROOT = Path(__file__).resolve().parents[3]
WIDTHS = (60, 80, 120, 200)
LONG = "the-northern-conveyor-of-the-hall-with-the-long-name"
Out = pytest.CaptureFixture[str]


def drawn(table: object, width: int) -> str:
    """As a terminal of ``width`` shows it."""
    console = Console(file=StringIO(), width=width, height=24, color_system=None)
    console.print(table)
    assert isinstance(console.file, StringIO)
    return console.file.getvalue()


def words(text: str) -> Counter[str]:
    return Counter(re.sub("[│┌┐└┘├┤┬┴┼─]", " ", text).split())


def assert_nothing_cut(text: str, wanted: list[str], width: int) -> None:
    assert max(map(cell_len, text.splitlines())) <= width, text
    missing = Counter(wanted) - words(text)
    assert not missing, (missing, text)


@pytest.fixture
def on_terminal(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    def of(width: int) -> None:
        monkeypatch.setattr(output, "on_terminal", lambda: True)
        monkeypatch.setenv("COLUMNS", str(width))
        monkeypatch.setenv("LINES", "24")

    return of


def numbers(text: str) -> list[str]:
    """Every word with a digit, as the text for pipes has it; octets in hex and paths may be longer than a line."""
    return [word for word in words(text).elements() if any(map(str.isdigit, word)) and len(word) <= 24]


# --- any table ------------------------------------------------------------------------------------------------------

WORD = st.text("abc0189._-", min_size=1, max_size=24)
CELL = st.one_of(st.integers(0, 10**15).map(str), st.lists(WORD, max_size=6).map(" ".join))


@examples(60)
@given(data=st.data(), count=st.integers(1, 9), width=st.integers(30, 200))
def test_no_word_is_cut_in_any_table(data: st.DataObject, count: int, width: int) -> None:
    rows = data.draw(st.lists(st.lists(CELL, min_size=count, max_size=count), min_size=1, max_size=4))
    columns = data.draw(st.lists(CELL, min_size=count, max_size=count))
    text = drawn(drawing.rich_table("", columns, rows, width), width)
    assert_nothing_cut(text, [word for row in (columns, *rows) for cell in row for word in cell.split()], width)


def test_a_wide_terminal_has_each_row_in_one_line() -> None:
    text = drawn(drawing.rich_table("T", ("address", "state"), [(3, "data_exchange"), (125, "fault")], 80), 80)
    assert text.splitlines() == [
        "T",
        "┌─────────┬───────────────┐",
        "│ address │ state         │",
        "├─────────┼───────────────┤",
        "│ 3       │ data_exchange │",
        "│ 125     │ fault         │",
        "└─────────┴───────────────┘",
    ]


def test_columns_without_room_move_into_a_second_line() -> None:
    columns = ("address", "name", "state", "exchanges")
    text = drawn(drawing.rich_table("", columns, [(3, "hoist", "data_exchange", 316), (4, "fan", "fault", 0)], 36), 36)
    assert text.splitlines() == [
        "┌───────────────┬───────────┐",
        "│ address       │ name      │",
        "│ state         │ exchanges │",
        "├───────────────┼───────────┤",
        "│ 3             │ hoist     │",
        "│ data_exchange │ 316       │",
        "├───────────────┼───────────┤",
        "│ 4             │ fan       │",
        "│ fault         │ 0         │",
        "└───────────────┴───────────┘",
    ]


# --- the tables of the commands -------------------------------------------------------------------------------------


def show_scan() -> int:
    stations = [
        Found(
            address=address,
            kind=StationType.SLAVE,
            state=SlaveView.DATA_EXCHANGE,
            ident=0x1000 + address,
            master=2,
        )
        for address in range(100, 127)
    ]
    master = Found(address=2, kind=StationType.MASTER_IN_RING)
    args: Any = SimpleNamespace(json=False, config=False, port="virtual")
    scan._show(LiveListResult(baud=500_000, address=0, stations=(master, *stations)), args)
    return 0


TWO_MS = str(ROOT / "examples" / "two_milliseconds.toml")
COMMANDS: dict[str, Callable[[], int]] = {
    "plan": lambda: main(["plan", TWO_MS, "--cycle-ms", "4"]),
    "plan and simulation": lambda: main(["plan", TWO_MS, "--simulate", "0.1"]),
    "plan of all rates": lambda: main(["plan", TWO_MS, "--baud", "all"]),
    "gsd show": lambda: main(["gsd", "show", str(ROOT / "examples" / "terminal.gsd")]),
    "gsd show of a drive": lambda: main(["gsd", "show", "demag-dedrive"]),
    "scan": show_scan,
    "ports": lambda: main(["ports"]),
    "drives": lambda: main(["drives"]),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_terminal_shows_every_number_that_a_pipe_gets(
    command: str, on_terminal: Callable[[int], None], monkeypatch: pytest.MonkeyPatch, capsys: Out
) -> None:
    by_id = "/dev/serial/by-id/usb-FTDI_USB-RS485_Cable_FTABC123-if00-port0"
    adapter = AdapterInfo(
        path="/dev/ttyUSB12",
        by_id=by_id,
        chip="FTDI FT232R",
        driver="ftdi_sio",
        usb=None,
        serial=None,
        holder="dpstack (pid 4711)",
    )
    monkeypatch.setattr(ports, "list_adapters", lambda: [adapter])
    assert COMMANDS[command]() == 0
    wanted = numbers(capsys.readouterr().out)
    assert len(wanted) > 2
    for width in WIDTHS:
        on_terminal(width)
        assert COMMANDS[command]() == 0
        # a line that is no table has words of any length
        assert not Counter(wanted) - words(capsys.readouterr().out), width


def leaves(value: object) -> list[str]:
    """Every number in some JSON."""
    if isinstance(value, dict):
        return [leaf for one in value.values() for leaf in leaves(one)]
    return [str(value)] if isinstance(value, (int, float)) and not isinstance(value, bool) else []


def test_the_end_of_a_run_shows_every_number_of_its_json(on_terminal: Callable[[int], None], capsys: Out) -> None:
    async def program() -> Any:
        async with bus_of(HOIST, FAN, {**RAW, "name": LONG, "inputs": {"level": "u8@0"}}) as bus:
            await bus.operate()
            await bus.ready()
            bus.slave(9).outputs = b"\xa5"
            await bus.rotated(400)
            for address, count in ((3, 1234567), (9, 31653165)):  # a slave's bad days
                link = core_of(bus).view.link.station(address)
                link.retries, link.timeouts, link.late, link.wrong = count + 1, count + 2, count + 3, count + 4
                link.bad["fcs"] = count + 9
                link.requests = (1000 if address == 9 else 10) * count  # advice for slave 3 only
            return Reporter(bus, json=False), bus.stats

    reporter, stats = virtual(program())
    summary = stats.summary()
    wanted = [str(summary["rotations"]), *leaves(summary["rotation_us"]), *leaves(summary["token_us"])]
    for address, slave in summary["slaves"].items():
        wanted += [address, *(str(slave[key]) for key in ("exchanges", "retries", "timeouts"))]
        wanted += [str(slave["late"] + slave["wrong"]), *leaves(slave["bad"]), *leaves(slave.get("fields", {}))]
        wanted += [slave[key] for key in ("inputs", "outputs") if len(slave[key]) <= 24]
    wanted += ["12345670", "repetitions", "cable"]  # of the advice
    assert "31653165" not in wanted
    assert "31653174" in wanted
    for width in (40, *WIDTHS):
        on_terminal(width)
        reporter.summary(stats)
        out = capsys.readouterr().out
        assert set(wanted) <= set(words(out.replace(",", " "))), width
        assert max(map(cell_len, out.splitlines())) <= width


def test_lines_are_wrapped_between_words(on_terminal: Callable[[int], None], capsys: Out) -> None:
    on_terminal(40)
    output.line("  rotation in us: min 1234567890, p50 1234567891, max " + 60 * "9" + " end")
    lines = capsys.readouterr().out.splitlines()
    assert lines == ["  rotation in us: min 1234567890, p50", "1234567891, max", 60 * "9", "end"]


def test_the_live_table_of_the_demo_fits(on_terminal: Callable[[int], None]) -> None:
    config = demo.plant(500_000)

    async def program() -> None:
        async with open_bus(config) as bus:
            await bus.operate()
            await bus.ready()
            await bus.rotated(bus.stats.rotations + 30)
            stage = demo._Stage(bus, json=False, live=True)
            for number in range(40):
                stage.lines.append(f"{number:9.3f} s  demag: -30.000% of the reference reached, parameter 4711 is 8150")
            for width in (60, 80, 120):
                on_terminal(width)
                text = drawn(stage.picture(), width)
                assert len(text.splitlines()) <= 24
                exchanges = [str(slave.exchanges) for slave in bus.slaves]
                assert_nothing_cut(text, [*exchanges, "-30.000%", "4711", "8150"], width)

    virtual(program())
