"""``Reporter`` for people: a line for each change of diagnoses and drives, the table at the end; and ``ctl status``.
Tables on narrow terminals: no number is cut, whatever has to give way."""

from __future__ import annotations

import asyncio
import re
from collections import Counter
from collections.abc import Awaitable, Callable
from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from api_kit import FAN, HOIST, RAW, bench_of, bus_of, virtual
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs
from property_kit import examples
from rich.cells import cell_len
from rich.console import Console

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.api.bus.opening import open_bus
from dpstack.api.commissioning.live_list import LiveListResult
from dpstack.api.config.config import slave_config
from dpstack.api.control.handlers import run_status
from dpstack.api.control.simulation_handlers import slave_handlers
from dpstack.cli.commands import ctl, demo, ports, scan
from dpstack.cli.main import main
from dpstack.cli.terminal import drawing, output
from dpstack.cli.terminal.report import Reporter
from dpstack.dp.master.events import DriveEvent, SlaveDiagnosis, SlaveStateChanged
from dpstack.dp.master.scanner import Found
from dpstack.dp.pdu.diag_texts import conspicuous_text
from dpstack.dp.pdu.diagnosis import Diagnosis, SlaveView
from dpstack.fdl.telegram import StationType
from dpstack.ports.adapters import AdapterInfo

IO: dict[str, object] = {"name": "io", "address": 8, "gsd": "io-station", "modules": ["8 DI", "8 DO", "2 AI"]}
PLAIN_FAN: dict[str, object] = {"name": "fan", "address": 4, "drive": "fuji-frenic", "telegram": "PPO2", "ident": "ask"}
TERMINAL = str(Path(__file__).resolve().parents[3] / "examples" / "terminal.gsd")
Out = pytest.CaptureFixture[str]
#: what a person does at the plant while the run goes on
Story = Callable[[dpstack.Bus, dict[str, Any]], Awaitable[None]]


def told_of(story: Story, *slaves: dict[str, object], capsys: Out) -> tuple[list[str], list[str], Any]:
    """The lines about slaves from data exchange on, without their times; the end; the status before it."""

    async def program() -> Any:
        bus = bus_of(*slaves, on_event=lambda event: reporter.event(event))
        reporter: Reporter = Reporter(bus, json=False)
        async with bus:
            await bus.operate()
            await bus.ready()
            await asyncio.sleep(0.5)
            capsys.readouterr()
            await story(bus, slave_handlers(bench_of(bus)))
            await bus.rotated(bus.stats.rotations + 10)
            lines = [
                line[13:] for line in capsys.readouterr().out.splitlines() if line[13:].startswith(("slave ", "drive "))
            ]
            status, stats = run_status(bus), bus.stats
        capsys.readouterr()
        reporter.summary(stats)
        return lines, capsys.readouterr().out.splitlines(), status

    result: tuple[list[str], list[str], Any] = virtual(program())
    return result


def rows(end: list[str]) -> list[list[str]]:
    """Of the table "Diagnoses and drives"; empty where there is none."""
    if "Diagnoses and drives" not in end:
        return []
    table = end[end.index("Diagnoses and drives") + 2 : end.index("Process data")]
    return [[cell.strip() for cell in line.split("  ") if cell] for line in table]


def test_a_wire_break_with_its_text_in_lines_table_and_status(capsys: Out) -> None:
    async def story(bus: dpstack.Bus, order: dict[str, Any]) -> None:
        order["wire-break"](["io", "3", "0", "on"])
        await asyncio.sleep(1)

    lines, end, status = told_of(story, IO, capsys=capsys)
    text = "ext_diag; slots with a diagnosis: 3 (2 AI); slot 3 (2 AI), input channel 0 (word): line break"
    assert [line for line in lines if "diagnosis ext_diag" in line] == [f"slave 8 (io): diagnosis {text}"]
    assert rows(end) == [["8", "io", "diagnosis", text]]
    told = status["slaves"]["8"]["diagnosis"]
    assert told["flags"] == ["ext_diag", "wd_on"]
    assert "slot 3 (2 AI), input channel 0 (word): line break" in told["texts"]
    ctl._show(status)
    assert "line break" in capsys.readouterr().out


def test_values_that_are_not_good_say_so_in_lines_table_and_status(capsys: Out) -> None:
    """A wire at channel 0 of slot 3: no door shows the number alone."""
    named = IO | {"inputs": {
        "full": "bool@0.0", "level": {"at": "i16@1", "unit": "m"}, "pressure": "i16@3",
    }, "outputs": {"lamp": "bool@0.0"}}  # fmt: skip

    async def story(bus: dpstack.Bus, order: dict[str, Any]) -> None:
        order["set"](["io.level=320", "io.pressure=7"])
        order["fault"](["io", "diagnosis", "what=slot 3 channel 0 line break"])
        await asyncio.sleep(1)

    lines, end, status = told_of(story, named, capsys=capsys)
    place = "slot 3 (2 AI)"
    said = f"level bad (line break: {place}, input channel 0); pressure uncertain (data invalid: {place})"
    assert f"slave 8 (io): {said}" in lines
    table = end[end.index("Named inputs and outputs") + 1 :][:5]
    assert [line.split(maxsplit=5) for line in table] == [
        ["address", "name", "field", "value", "quality"],
        ["8", "io", "full", "False"],
        ["8", "io", "level", "320", "m", f"bad: line break: {place}, input channel 0"],
        ["8", "io", "pressure", "7", "uncertain:", f"data invalid: {place}"],
        ["8", "io", "lamp", "False"],
    ]
    slave = status["slaves"]["8"]
    assert "quality" not in slave
    assert {name: one["quality"] for name, one in slave["qualities"].items()} == {
        "level": "bad",
        "pressure": "uncertain",
    }
    assert slave["qualities"]["level"]["reason"] == "channel_fault"
    ctl._show(status)
    shown = [line.strip() for line in capsys.readouterr().out.splitlines()]
    assert "fields: full False, level 320 (bad), pressure 7 (uncertain), lamp False" in shown
    assert any(
        re.fullmatch(
            rf"level: bad: line break: {re.escape(place)}, input channel 0 \(since [0-9.]+ s\); check wire, .*", one
        )
        for one in shown
    )


def test_old_values_are_stale_in_table_and_status(capsys: Out) -> None:
    async def story(bus: dpstack.Bus, order: dict[str, Any]) -> None:
        order["power-off"](["raw"])
        await asyncio.sleep(1)

    _, end, status = told_of(story, RAW | {"inputs": {"level": "u8@0"}}, IO, capsys=capsys)
    row = end[end.index("Named inputs and outputs") + 2]
    assert row.split()[:5] == ["9", "raw", "level", "0", "stale:"]
    slave = status["slaves"]["9"]
    assert slave["quality"]["quality"] == slave["qualities"]["level"]["quality"] == "stale"
    ctl._show(status)
    assert "fields: level 0 (stale)" in capsys.readouterr().out


def test_an_alarm_does_not_repeat_the_line_of_its_diagnosis(capsys: Out) -> None:
    async def story(bus: dpstack.Bus, order: dict[str, Any]) -> None:
        order["pull"](["io", "2"])
        await asyncio.sleep(0.5)

    lines, _, _ = told_of(story, IO | {"dpv1": {"alarms": ["pull_plug"]}}, capsys=capsys)
    assert "slave 8 (io): diagnosis ext_diag; slots with a diagnosis: 2 (8 DO)" in lines
    alarms = [line for line in lines if "pull alarm" in line]
    assert len(alarms) == 1
    assert "slots with a diagnosis" not in alarms[0]
    assert sum("slots with a diagnosis: 2 (8 DO)" in line for line in lines) == 1


@pytest.mark.parametrize(
    ("retries", "bad", "extra_idle_bits", "advice", "pause"),
    [
        (45, 0, 0, True, True),
        (45, 40, 0, True, False),  # damaged answers: the line
        (45, 0, 60, True, False),  # set already
        (9, 0, 0, False, False),
    ],
)
def test_many_repetitions_bring_advice_in_the_summary(
    capsys: Out, retries: int, bad: int, extra_idle_bits: int, advice: bool, pause: bool
) -> None:
    async def program() -> None:
        bus = bus_of(RAW, on_event=lambda event: reporter.event(event), extra_idle_bits=extra_idle_bits)
        reporter: Reporter = Reporter(bus, json=False, quiet=True)
        async with bus:
            await bus.ready()
            stats = bus.stats
        link = structs.replace(stats.slaves[9].link, requests=236, retries=retries, bad={"fcs": bad})
        slave = structs.replace(stats.slaves[9], retries=retries, link=link)
        capsys.readouterr()
        reporter.summary(structs.replace(stats, slaves={9: slave}))

    virtual(program())
    out = capsys.readouterr().out
    assert (f"slave 9 (raw): {retries} repetitions of 236 requests: check cable" in out) is advice
    assert ("extra_idle_bits = 60" in out) is pause


def test_a_diagnosis_that_is_over_is_told_once_and_leaves_the_table(capsys: Out) -> None:
    async def story(bus: dpstack.Bus, order: dict[str, Any]) -> None:
        order["wire-break"](["io", "3", "0", "on"])
        await asyncio.sleep(0.5)
        order["wire-break"](["io", "3", "0", "off"])
        await asyncio.sleep(0.5)

    lines, end, _ = told_of(story, IO, capsys=capsys)
    diagnoses = [line for line in lines if "diagnosis ext_diag" in line or "without findings" in line]
    assert len(diagnoses) == 2
    assert diagnoses[1] == "slave 8 (io): diagnosis without findings"
    assert rows(end) == []


def test_a_slave_that_is_not_ready_says_so_in_data_exchange() -> None:
    """Octets of a diagnosis: Station_Not_Ready alone, of a slave that goes on with Data_Exchange."""
    not_ready = Diagnosis.parse(bytes.fromhex("020C00021234"))
    wants_parameters = Diagnosis.parse(bytes.fromhex("030500FF1234"))
    in_order = Diagnosis.parse(bytes.fromhex("000C00021234"))
    assert not_ready is not None
    assert wants_parameters is not None
    assert in_order is not None

    def names(diagnosis: Diagnosis, *, exchanging: bool) -> list[str]:
        return [flag.name for flag in diagnosis.conspicuous(exchanging=exchanging)]

    assert names(not_ready, exchanging=True) == ["station_not_ready"]
    assert names(not_ready, exchanging=False) == []  # its state is wait_ready
    assert names(wants_parameters, exchanging=True) == []  # as every slave says before it is brought up
    assert names(in_order, exchanging=True) == []


def test_a_slave_in_data_exchange_that_is_not_ready_gets_a_line(capsys: Out) -> None:
    async def story(bus: dpstack.Bus, order: dict[str, Any]) -> None:
        for octets in ("020C00021234", "020C00021234", "000C00021234"):
            diagnosis = Diagnosis.parse(bytes.fromhex(octets))
            assert diagnosis is not None
            core_of(bus).publish(
                SlaveDiagnosis(t_ns=core_of(bus).runtime.now(), address=9, name="raw", diagnosis=diagnosis)
            )

    lines, _, _ = told_of(story, RAW, capsys=capsys)
    assert lines == [
        "slave 9 (raw): diagnosis station_not_ready (is not ready for data exchange)",
        "slave 9 (raw): diagnosis without findings",
    ]


def test_a_blown_fuse_in_the_words_of_the_gsd_file() -> None:
    """Device related block 02 01: bit 0 of octet 1."""
    diagnosis = Diagnosis.parse(bytes.fromhex("080C00021A2B0201"))
    assert diagnosis is not None
    terminal = slave_config({"name": "t", "address": 7, "gsd": TERMINAL, "modules": ["8 DI"], "dpv1": False})
    told = conspicuous_text(diagnosis, terminal.params.texts, exchanging=True)
    assert told == "ext_diag; fuse blown (replace F1)"


def test_a_trip_its_name_and_why_the_drive_stopped(capsys: Out) -> None:
    async def story(bus: dpstack.Bus, order: dict[str, Any]) -> None:
        fan = bus.drive("fan")
        await fan.start()
        fan.speed = 0.5
        await fan.reached()
        await asyncio.sleep(0.5)
        order["trip"](["fan", "Er5"])
        await asyncio.sleep(1)

    lines, end, status = told_of(story, PLAIN_FAN, capsys=capsys)
    drive = [line for line in lines if line.startswith("drive 4 (fan): ")]
    assert drive[0] == "drive 4 (fan): running"
    assert any(line.startswith("drive 4 (fan): fault: Er5") for line in drive)
    assert any("left the running state by itself" in line for line in drive)
    assert sum(": running" in line for line in drive) == 1  # and nothing of set point, speed and reached
    assert any(row[2] == "drive fault" and "Er5" in row[3] for row in rows(end))
    assert any("left the running state by itself" in row[-1] for row in rows(end))
    told = status["slaves"]["4"]["drive"]
    assert any("Er5" in fault for fault in told["faults"])
    assert any("left the running state by itself" in one["text"] for one in told["notices"])


def test_an_ordinary_run_tells_nothing_of_diagnoses(capsys: Out) -> None:
    async def program() -> None:
        bus = bus_of(RAW, IO, on_event=lambda event: reporter.event(event))
        reporter: Reporter = Reporter(bus, json=False)
        async with bus:
            await bus.ready()
            await bus.rotated(20)
            stats = bus.stats
        reporter.summary(stats)

    virtual(program())
    assert "iagnos" not in capsys.readouterr().out


def test_a_drive_that_flickers_is_no_flood(capsys: Out) -> None:
    async def program() -> None:
        async with bus_of(PLAIN_FAN) as bus:
            reporter = Reporter(bus, json=False)
            for number in range(2000):
                payload: dict[str, object] = {
                    "type": "status",
                    "state": "ready",
                    "faults": [],
                    "warnings": ["fan"][: number % 2],
                }
                reporter.event(DriveEvent(t_ns=core_of(bus).runtime.now(), address=4, name="fan", payload=payload))
                await asyncio.sleep(0.001)
            stats = bus.stats
        reporter.summary(stats)

    virtual(program())
    out = capsys.readouterr().out
    assert 40 <= out.count("drive 4 (fan): ready") < 60
    assert "changes of the drive's state, faults or warnings are not reported one by one" in out


def test_a_slave_that_refuses_tells_its_fault_once_however_often_it_is_asked(capsys: Out) -> None:
    """The configuration has a module more than the device; it is asked again after 1, 2, 4 ... seconds."""

    async def program() -> None:
        world = dpstack.World()
        device = {**IO, "modules": ["8 DI", "8 DO"]}
        dpstack.simulate(world, [slave_config(device)], baud=93_750)  # slow: ten seconds of a bus
        states: list[str] = []

        def on_event(event: dpstack.Event) -> None:
            reporter.event(event)
            if isinstance(event, SlaveStateChanged):
                states.append(event.state.value)

        bus = bus_of(IO, on_event=on_event, world=world, baud=93_750)
        reporter: Reporter = Reporter(bus, json=False)
        async with bus:
            await bus.operate()
            await asyncio.sleep(10)
            assert states.count("fault") > 3
            lines = [line[13:] for line in capsys.readouterr().out.splitlines() if "slave 8" in line]
            fault = next(n for n, line in enumerate(lines) if "refuses the parameters" in line)
            assert lines[:fault] == [f"slave 8 (io): {state}" for state in ("set_prm", "chk_cfg", "wait_ready")]
            assert lines[fault + 1 :] == ["slave 8 (io): fault"]

    virtual(program())


ROOT = Path(__file__).resolve().parents[3]
WIDTHS = (60, 80, 120, 200)
LONG = "the-northern-conveyor-of-the-hall-with-the-long-name"


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
