"""Text of others (GSD files, other programs, file names, arguments) never reaches a terminal as it is."""

from __future__ import annotations

import io
import json
import os
import socket
import threading
import unicodedata
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from api_kit import HOIST
from control_kit import socket_of
from plant_files import plant_file
from step7_kit import PLANT

from dpstack.api.control.socket_path import Sockets, own_name
from dpstack.capture.pcapng import Writer
from dpstack.cli import main as program
from dpstack.cli.main import main
from dpstack.cli.terminal import output
from dpstack.profile import DriveStatus, State

#: a title, colours by C1 CSI, DEL, bidi, marks, zero width, separators, markup and an emoji's name of rich
EVIL = (
    "\x1b]0;owned\x07\x1b[2J\x9b31m\x7f\x85\u202eevil\u2066\u2069\u200e\u200f\u061c\u200b\ufeff"
    "\u2028\u2029[red]x[/red]:smile:\U000e0001"
)
NEVER = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})


def assert_clean(*printed: str) -> None:
    """No control but the line end, no format character, no separator, no lone surrogate."""
    for text in printed:
        found = {letter for letter in text if letter != "\n" and unicodedata.category(letter) in NEVER}
        assert not found, (found, text)


@pytest.fixture(params=["pipe", "terminal"])
def reader(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """The reader of the output: a pipe, or a terminal, for which rich draws (here without colours)."""
    if request.param == "terminal":
        monkeypatch.setattr(output, "on_terminal", lambda: True)
        monkeypatch.setenv("COLUMNS", "400")
        monkeypatch.setenv("TERM", "dumb")
    return str(request.param)


@pytest.fixture
def gsd(tmp_path: Path) -> Path:
    """A GSD file whose every text is hostile."""
    text = f"""#Profibus_DP
GSD_Revision = 5
Vendor_Name = "{EVIL}"
Model_Name = "{EVIL}"
Revision = "{EVIL}"
Ident_Number = 0x1234
9.6_supp = 1
500_supp = 1
Modular_Station = 1
Max_Module = 4
Max_Input_Len = 8
Max_Output_Len = 8
Max_Data_Len = 16
Slave_Family = {EVIL}
Strange{EVIL.replace(" ", "").replace("(", "")} = 3
Freeze_Mode_supp = {EVIL}
Unit_Diag_Bit(0) = "{EVIL}"
Unit_Diag_Bit(x{EVIL}) = "{EVIL}"
PrmText = 1
Text(0) = "off {EVIL}"
Text(1) = "on {EVIL}"
EndPrmText
ExtUserPrmData = 1 "{EVIL}"
Bit(0) 1 0-1
Prm_Text_Ref = 1
EndExtUserPrmData
Max_User_Prm_Data_Len = 4
Ext_User_Prm_Data_Const(0) = 0x00,0x00,0x00,0x00
Ext_User_Prm_Data_Ref(3) = 1
Module = "8 DI {EVIL}" 0x10
1
Info_Text = "{EVIL}"
EndModule
Module = "8 DO {EVIL}" 0x20
2
EndModule
Module = "broken {EVIL}" {EVIL}
EndModule
SlotDefinition
Slot(1) = "{EVIL}" 1 1,2
Slot(2) = "{EVIL}" 2 1,2
EndSlotDefinition
"""
    path = tmp_path / f"{EVIL.replace('/', '')}.gsd"
    path.write_bytes(text.encode())
    return path


@pytest.fixture
def config(tmp_path: Path, gsd: Path) -> Path:
    (tmp_path / "evil.gsd").write_bytes(gsd.read_bytes())
    valves = {"name": "valves", "address": 8, "gsd": "evil.gsd", "modules": [1, 2], "inputs": {"limit": "bool@0.0"}}
    return plant_file(tmp_path, valves, HOIST)


def run(capsys: pytest.CaptureFixture[str], *argv: str) -> tuple[int, str, str]:
    """Exit code and output, which must be clean."""
    try:
        code = main(argv)
    except SystemExit as end:
        code = int(str(end.code))
    printed = capsys.readouterr()
    assert_clean(printed.out, printed.err)
    return code, printed.out, printed.err


def test_a_gsd_file_for_people(reader: str, gsd: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, shown, _ = run(capsys, "gsd", "show", str(gsd))
    assert code == 0
    assert r"\x1b]0;owned\x07" in shown
    assert "[red]x[/red]:smile:" in shown
    code, checked, _ = run(capsys, "gsd", "check", str(gsd))
    assert code == 1
    assert r"broken \x1b]0;owned" in checked


def test_gsd_files_found_and_compared(reader: str, gsd: Path, config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, found, _ = run(capsys, "gsd", "find", "8DI", str(gsd.parent))
    assert (code, found.count(r"8 DI \x1b]0;owned")) == (0, 2)
    code, changes, _ = run(capsys, "gsd", "diff", "io-station", str(gsd))
    assert code == 1
    assert r"8 DI \x1b]0;owned" in changes


def test_a_gsd_file_as_json_has_the_same_values(gsd: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, shown, _ = run(capsys, "gsd", "show", str(gsd), "--json")
    told = json.loads(shown)
    assert told["vendor"] == EVIL
    assert told["modules"][0]["name"] == f"8 DI {EVIL}"
    _, checked, _ = run(capsys, "gsd", "check", str(gsd), "--json")
    assert json.loads(checked)["file"] == str(gsd)


def test_questions_about_a_gsd_file(
    gsd: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    answers = tmp_path / "answers"
    answers.write_text("valves\n8\ny\n" + "1\n2\n\n" + "y\n" * 9, encoding="utf-8")
    with answers.open(encoding="utf-8") as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        run(capsys, "gsd", "configure", str(gsd))


def test_a_first_device_file_of_a_gsd_file(
    gsd: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    target = tmp_path / "evil.toml"
    text = gsd.read_text(encoding="utf-8").replace("0x10\n", "0x71\n", 1)
    gsd.write_text(text, encoding="utf-8")
    for target_or_not in (("-o", str(target)), ("--name", "evil")):
        answers = io.StringIO("profidrive\n1\n")
        monkeypatch.setattr(answers, "isatty", lambda: True, raising=False)
        monkeypatch.setattr("sys.stdin", answers)
        code, out, err = run(capsys, "device", "new", "--gsd", str(gsd), *target_or_not)
        assert code == 0
        assert r"\x1b]0;owned" in err
    assert r"\u001b]0;owned" in out
    assert r"\u001b]0;owned" in target.read_text(encoding="utf-8")


def test_device_files(
    reader: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Their texts, of which the reader refuses those that are not printable, and what stands in messages about them."""
    monkeypatch.setenv("DPSTACK_DEVICES", str(tmp_path))
    path = tmp_path / "fan.toml"
    for place in ("title", "source", "base", "gsd", "python", "notes", "key", "word", "fault", "state", "order"):
        evil = json.dumps(EVIL)
        parts = {
            "title": f"title = {evil}", "source": f"source = {evil}", "base": f"base = {evil}", "gsd": f"gsd = {evil}",
            "python": f"python = {evil}", "notes": f"notes = [{evil}]", "key": f"{evil} = 1",
        }  # fmt: skip
        tables = {
            "word": f"[words]\n{evil} = {{ bits = {{ {evil} = 1 }} }}",
            "fault": f"[fault]\ntexts = {{ 1 = {evil} }}",
            "state": f"[[example]]\ninputs = 'EB31 0000'\nstate = {evil}\nfault = {evil}\nvalues = {{ {evil} = 1 }}",
            "order": f"[[example]]\ninputs = 'EB31 0000'\noutputs = {{ {evil} = '047E 0000' }}",
        }
        base = "" if place == "base" else 'base = "profidrive"\n'
        path.write_text(
            f'format = 1\nname = "fan"\n{base}{parts.get(place, "")}\n[telegrams]\n1 = {{}}\n{tables.get(place, "")}\n',
            encoding="utf-8",
        )
        for argv in (["check", str(path)], ["list"], ["show", "fan"]):
            code, out, err = run(capsys, "device", *argv)
            assert out or err, (place, argv)
            assert code in (0, 1, 2)


def test_plan_and_run_of_such_a_device(reader: str, config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for json_or_not in ([], ["--json"]):
        code, _, _ = run(capsys, "plan", str(config), *json_or_not)
        assert code in (0, 1)
        code, _, _ = run(capsys, "plan", str(config), "--simulate", "0.05", *json_or_not)
        assert code in (0, 1)
        code, _, _ = run(capsys, "names", str(config), *json_or_not)
        assert code == 0
        code, _, _ = run(capsys, "run", str(config), "--seconds", "0.05", *json_or_not)
        assert code in (0, 1)


def test_texts_of_an_export(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "evil.cfg"
    text = PLANT.replace("Hauptschrank", EVIL).replace("NA_INT", EVIL).replace("Not-Aus", EVIL).replace("coupler", EVIL)
    path.write_text(text.replace("Mischerei", EVIL).replace("REDUNDANCY", f"?{EVIL}?"), newline="")
    for more in ([], ["--json"]):
        code, out, _ = run(capsys, "import", str(path), *more)
        assert code == 0
        assert out


def test_comments_of_a_capture(
    reader: str, gsd: Path, config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "bus.pcapng"
    with path.open("wb") as file:
        writer = Writer(file, EVIL)
        writer.packet(writer.interface(EVIL, 500_000, EVIL), 0, b"\xe5", comment=EVIL)
    for json_or_not in ([], ["--json"]):
        code, _, _ = run(capsys, "decode", str(path), *json_or_not)
        assert code == 0
        more = ("--gsd", str(gsd.parent), "--config", str(config))
        code, out, _ = run(capsys, "monitor", str(path), *more, *json_or_not)
        assert code == 0
        assert "owned" in out


NAMES = [
    ["plan", EVIL],
    ["plan", "CONFIG", "--simulate", EVIL],
    ["run", EVIL],
    ["sim", EVIL, "--port", "pty"],
    ["sim", "--drive", EVIL, "--address", "3", "--port", "pty"],
    ["segment", "--dir", f"/proc/self/{EVIL}"],
    ["segment", "--baud", EVIL],
    ["sheet", EVIL],
    ["sheet", "CONFIG", EVIL],
    ["import", EVIL],
    ["import", "GSD"],
    ["import", "GSD", "--gsd", EVIL],
    ["import", "GSD", "--out", f"/nowhere/{EVIL}"],
    ["import", "GSD", "--encoding", EVIL],
    ["names", EVIL],
    ["names", EVIL, "--epics"],
    ["names", "CONFIG", "--from", EVIL],
    ["names", "CONFIG", "--csv", f"/nowhere/{EVIL}"],
    ["plot", EVIL],
    ["plot", f"{EVIL}.csv"],
    ["fleet", "--mqtt", EVIL],
    ["fleet", "--mqtt", "mqtt://localhost", "--group", EVIL],
    ["fleet", "--mqtt", "mqtt://localhost", "--rebirth", EVIL],
    ["fleet", "--mqtt", "mqtts://localhost", "--ca", EVIL],
    ["fleet", "--mqtt", "mqtt://localhost", "--user", "x", "--password-env", EVIL],
    ["completion", EVIL],
    ["drives", EVIL],
    ["device", EVIL],
    ["device", "check", EVIL],
    ["device", "check", f"{EVIL}.toml"],
    ["device", "check", "profidrive", "--telegram", EVIL],
    ["device", "new", "--gsd", EVIL],
    ["device", "new", "--gsd", "GSD", "--name", EVIL],
    ["device", "new", "--gsd", "GSD", "--modules", EVIL],
    ["device", "new", "--gsd", "GSD", "--modules", "8 DO", "--out", EVIL],
    ["device", "new", "--gsd", "GSD", "-o", EVIL],
    ["device", "list", EVIL],
    ["device", "show", EVIL],
    ["device", "show", f"{EVIL}.toml"],
    ["ctl", EVIL, EVIL, EVIL],
    ["drive", EVIL, "x", "status"],
    ["drive", "CONFIG", EVIL, "status"],
    ["drive", "CONFIG", "hoist", EVIL],
    ["drive", "CONFIG", "hoist", "compare", EVIL],
    ["acyclic", "CONFIG", EVIL, "im"],
    ["hart", EVIL, "8", "0"],
    ["hart", "CONFIG", EVIL, "0"],
    ["hart", "CONFIG", "8", EVIL],
    ["hart", "CONFIG", "8", "0", EVIL],
    ["hart", "CONFIG", "8", "0", "command", "3", EVIL],
    ["hart", "CONFIG", "8", "0", "--slot", EVIL],
    ["why", EVIL, "8"],
    ["why", "CONFIG", EVIL],
    ["acyclic", "CONFIG", "8", EVIL],
    ["acyclic", "CONFIG", "8", "read", EVIL, "1"],
    ["acyclic", "CONFIG", "8", "compare", EVIL],
    ["pa", "CONFIG", EVIL],
    ["pa", "CONFIG", "8", EVIL],
    ["pa", "CONFIG", "8", "read", EVIL],
    ["pa", "CONFIG", "8", "compare", EVIL],
    ["scan", "--port", f"/nowhere/{EVIL}"],
    ["fdl", f"/nowhere/{EVIL}", "status", "5", "--baud", "500000"],
    ["fdl", "/nowhere/port", EVIL, "5"],
    ["fdl", "/nowhere/port", "sda", EVIL],
    ["fdl", "/nowhere/port", "sda", "5", EVIL],
    ["fdl", "/nowhere/port", "sda", "5", "--dsap", EVIL],
    ["ppi", f"/nowhere/{EVIL}", "2", "clock"],
    ["ppi", "/nowhere/port", EVIL, "clock"],
    ["ppi", "/nowhere/port", "2", EVIL],
    ["ppi", "/nowhere/port", "2", "read", EVIL],
    ["ppi", "/nowhere/port", "2", "write", "VW0", EVIL, "--yes"],
    ["ppi", "/nowhere/port", "2", "set-time", EVIL, "--yes"],
    ["diag", EVIL, "8"],
    ["diag", "CONFIG", EVIL],
    ["diag", "CONFIG", "8", "--gsd", EVIL],
    ["diag", "--port", f"/nowhere/{EVIL}", "--baud", "500000", "8"],
    ["address", "--port", f"/nowhere/{EVIL}", "126", "5", "--ident", "0x1234"],
    ["baud", "--port", f"/nowhere/{EVIL}", "--timeout", "0.1"],
    ["capture", "--port", f"/nowhere/{EVIL}"],
    ["capture", "--port", "pty", "--write", f"/nowhere/{EVIL}"],
    ["capture", "--port", "pty", "--write", f"/nowhere/{EVIL}", "--ring", "2", "--size", "1"],
    ["capture", "--port", "pty", "--trigger", EVIL],
    ["capture", "--port", "pty", "--filter", EVIL],
    ["monitor", EVIL],
    ["monitor", "--port", f"/nowhere/{EVIL}"],
    ["monitor", EVIL, "--gsd", EVIL],
    ["monitor", EVIL, "--thresholds", EVIL],
    ["monitor", EVIL, "--report", f"/nowhere/{EVIL}"],
    ["web", EVIL],
    ["web", "CONFIG", "--listen", EVIL],
    ["web", "CONFIG", "--token", EVIL],
    ["web", "CONFIG", "--tls", EVIL, EVIL],
    ["web", "--replay", EVIL],
    ["decode", EVIL],
    ["decode", "E5", "--filter", EVIL],
    ["decode", "--diagnosis", f"0 0C {EVIL}"],
    ["decode", "--diagnosis", "00 0C 00 02 12 34", "--address", EVIL],
    ["wireshark", EVIL],
    ["mcp", EVIL],
    ["mcp", "--dir", EVIL],
    ["mcp", "CONFIG", "--dir", EVIL],
    ["doctor", "--port", f"/nowhere/{EVIL}"],
    ["ports", EVIL],
    ["demo", "--baud", EVIL],
    ["gsd", "find", EVIL, "/proc/self/fd"],
    ["gsd", "diff", "GSD", EVIL],
    ["gsd", "show", EVIL],
    ["gsd", "check", EVIL],
    ["gsd", "copy", EVIL, "x"],
    ["gsd", "copy", "io-station", f"/nowhere/{EVIL}"],
    ["gsd", "configure", EVIL],
    [EVIL],
]


@pytest.mark.parametrize("argv", NAMES, ids=lambda argv: " ".join(argv).replace(EVIL, "EVIL"))
@pytest.mark.parametrize("more", ["", "\udcff"], ids=["text", "octet"])
def test_names_of_files_and_arguments(
    argv: list[str], more: str, config: Path, alone: None, capsys: pytest.CaptureFixture[str]
) -> None:
    there = {"CONFIG": str(config), "GSD": str(config.parent / "evil.gsd")}
    argv = [there.get(arg, arg) + (more if EVIL in arg else "") for arg in argv]
    code, _, err = run(capsys, *argv)
    assert code in (1, 2)
    assert err or argv[0] == "doctor"


def test_every_command_is_in_the_list() -> None:
    assert {argv[0] for argv in NAMES} == {*program._COMMANDS, EVIL}


READY = DriveStatus(
    state=State.READY, running=False, reached=False, remote=True, setpoint=0.5, speed=0.5, frequency_hz=25.0
)
#: every text and every list of texts that a drive's status has
STATUS = {
    key: EVIL if isinstance(value, str) else [EVIL, EVIL] if isinstance(value, list) else value
    for key, value in READY.as_dict().items()
}
ANSWER: dict[str, Any] = {
    "kind": EVIL,
    "port": EVIL,
    "name": EVIL,
    "config": EVIL,
    "started": EVIL,
    "pid": 1,
    "commands": [dict.fromkeys(("command", "args", "text", "example"), EVIL)],
    "drive": EVIL,
    "type": "demag-dedrive",
    "address": 3,
    "status": STATUS,
    "slave": EVIL,
    "slot": 1,
    "index": 2,
    "data": "1b5d",
    "length": 2,
    "object": 1,
    "ident": 0x1234,
    "im": {"0": {"serial_number": EVIL, EVIL: EVIL}},
    "events": [
        {
            "time": EVIL,
            "slot": 1,
            "signal": 2,
            "state": 1,
            "state_text": EVIL,
            "kind": 1,
            "kind_text": EVIL,
        }
    ],
    "reading": {
        "address": 8,
        "own": 2,
        "source": EVIL,
        "status": EVIL,
        "errors": {EVIL: EVIL},
        "diagnosis": "080c0002123402ff",
        "config": "1020",
        "inputs": "1b5d",
        "outputs": None,
    },
    "parameter": {"name": EVIL, "data_set": None, "value": 1, "unit": EVIL},
    EVIL: {EVIL: {EVIL: [EVIL]}, "list": [{EVIL: EVIL}]},
}
RECORDS = [
    {"number": 1, "name": EVIL, "format": "VisibleString", "values": [EVIL]},
    {"number": 2, "name": EVIL, "format": "", "unreadable": EVIL},
]


PA_VALUE = {"name": EVIL, "slot": 1, "index": 2, "type": EVIL, "access": EVIL, "text": EVIL, "quality": EVIL}
PA_TEXTS = ("maker", "device", "serial", "software", "hardware", "tag", "descriptor", "message", "installed", "profile")
PA: dict[str, Any] = {
    "identity": {**dict.fromkeys(PA_TEXTS, EVIL), "ident_selector": EVIL, "maker_id": 1},
    "diagnosis": {"octets": "", "category": EVIL, "texts": [EVIL], "extension": "", "extension_texts": [EVIL]},
    **dict.fromkeys(("write_protection", "name", "text", "device", "serial", "profile"), EVIL),
    "directory": 1,
    "maker": 1,
    "remarks": [EVIL],
    "parameter": PA_VALUE,
}
PA_BLOCK = {**dict.fromkeys(("name", "kind", "tag", "target_mode", "mode", "alarms"), EVIL), "slot": 1, "index": 2}
PA_LISTS: dict[str, list[dict[str, Any]]] = {
    "show": [{**PA_BLOCK, "values": [PA_VALUE, {**PA_VALUE, "unreadable": EVIL}]}],
    "read": [PA_VALUE, {**PA_VALUE, "unreadable": EVIL}],
    "write": [],
    "dump": [
        {"name": EVIL, "slot": 1, "number": 2, "type": EVIL, "group": EVIL, "values": [EVIL], "text": EVIL},
        {"name": "x", "slot": 1, "number": 3, "type": EVIL, "group": EVIL, "unreadable": EVIL},
    ],
}


def _answer(request: dict[str, Any]) -> dict[str, object]:
    word = request["args"][1] if len(request["args"]) > 1 else request["command"]
    match word:
        case "clear" | "stop" | "write":
            return {"ok": False, "error": EVIL, "kind": "DriveFault", "drive": EVIL}
        case "pa":
            asked = request["args"][2] if len(request["args"]) > 2 else "show"
            return {"ok": True, "result": {**ANSWER, **PA, "asked": asked, "parameters": PA_LISTS[asked]}}
        case "parameters":
            return {"ok": True, "result": {**ANSWER, "order": "parameters", "parameters": RECORDS}}
        case "status" | "start":
            return {"ok": True, "result": {key: value for key, value in ANSWER.items() if key != "parameter"}}
    return {"ok": True, "result": {**ANSWER, "order": word}}


@pytest.fixture
def peer(alone: None, config: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A program that knows the control socket and nothing else: raw UTF-8 in its JSON. The port it answers for."""
    monkeypatch.setitem(ANSWER, "config", str(config))
    port = f"/tmp/peer-{os.getpid()}"
    listening = socket.socket(socket.AF_UNIX)
    with Sockets(make=True) as sockets, sockets.locked():
        for name in (port, own_name("run", port)):
            path = socket_of(name)
            if name == port:
                listening.bind(str(path))
                path.chmod(0o600)
                first = path
            else:
                path.symlink_to(first.name)
    listening.listen()

    def serve() -> None:
        while True:
            try:
                connection, _ = listening.accept()
            except OSError:
                return
            with connection, connection.makefile("rwb") as file:
                for line in file:
                    told = json.dumps(_answer(json.loads(line)), ensure_ascii=False)
                    file.write(told.encode() + b"\n")
                    file.flush()

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    yield port
    listening.shutdown(socket.SHUT_RDWR)
    listening.close()
    thread.join()


@pytest.mark.parametrize(
    ("argv", "code"),
    [
        (["ctl", "PORT"], 0),
        (["ctl", "PORT", "status"], 0),
        (["ctl", "PORT", "stats"], 0),
        (["ctl", "PORT", "clear"], 1),
        (["drive", "CONFIG", "hoist", "status"], 0),
        (["drive", "CONFIG", "hoist", "read", "412"], 0),
        (["drive", "CONFIG", "hoist", "start"], 0),
        (["drive", "CONFIG", "hoist", "stop"], 1),
        (["acyclic", "CONFIG", "8", "im"], 0),
        (["acyclic", "CONFIG", "8", "stamps", "100"], 0),
        (["pa", "CONFIG", "8"], 0),
        (["pa", "CONFIG", "8", "read", "ai1"], 0),
        (["pa", "CONFIG", "8", "write", "ai1.out", "1"], 0),
        (["pa", "CONFIG", "8", "dump"], 0),
        (["diag", "CONFIG", "8"], 1),
        (["acyclic", "CONFIG", "8", "read", "1", "2"], 0),
        (["acyclic", "CONFIG", "8", "write", "1", "2", "00"], 1),
        (["acyclic", "CONFIG", "8", "parameters"], 0),
        (["acyclic", "CONFIG", "8", "dump", "DUMP"], 0),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_answers_of_another_program(
    reader: str, argv: list[str], code: int, peer: str, config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config.write_text(config.read_text("utf-8").replace('"virtual"', f'"{peer}"'), "utf-8")
    names = {"PORT": peer, "CONFIG": str(config), "DUMP": str(config.parent / "dump.toml")}
    argv = [names.get(arg, arg) for arg in argv]
    got, out, err = run(capsys, *argv)
    assert got == code, err
    assert r"\x1b]0;owned" in out + err or "5D" in out or argv[0] == "acyclic"
    run(capsys, *argv, "--json")
    dump = Path(names["DUMP"])
    if dump.exists():
        assert_clean(dump.read_text("utf-8"))


def test_a_run_with_another_configuration(
    reader: str, peer: str, config: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(ANSWER, "config", EVIL)
    config.write_text(config.read_text("utf-8").replace('"virtual"', f'"{peer}"'), "utf-8")
    code, _, err = run(capsys, "drive", str(config), "hoist", "stop")
    assert code == 2
    assert r"has the configuration \x1b]0;owned" in err


def test_where_an_error_comes_from(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DPSTACK_DEBUG", "1")
    code, _, err = run(capsys, "plan", EVIL)
    assert code == 2
    assert "Traceback" in err
