"""README, documents and examples are what they say: code runs, configurations load, commands exist, links lead on."""

from __future__ import annotations

import ast
import contextlib
import io
import json
import logging
import re
import runpy
import shlex
import tokenize
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from pictures_kit import FOLDER, PICTURES

import dpstack
import dpstack.profile
from bench.__main__ import BENCHMARKS
from dpstack.api.config.config import load_config, parse_config
from dpstack.api.config.connectors import CONNECTORS
from dpstack.api.connectors.kinds import KINDS
from dpstack.api.control.scenario import parse_scenario
from dpstack.api.control.simulation_handlers import slave_handlers
from dpstack.api.gsd_info import copy_gsd
from dpstack.api.listen.plant_files import load_thresholds
from dpstack.api.lists.parameter_list import ParameterList
from dpstack.cli.main import _COMMANDS, build_parser, main
from dpstack.devices import finding
from dpstack.errors import ConfigError
from dpstack.params import BusParams
from tools import make_book_docs, make_config_docs, make_reference_docs
from tools.book_commands import commands
from tools.syntax import statements

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]
#: with a process of its own: in real time
BUSY = ROOT / "examples" / "busy_program.py"
#: with packages of others: tests/strangers/test_examples_with_packages.py
WITH_PACKAGES = {ROOT / "examples" / "fastapi_service.py", ROOT / "examples" / "parquet_logger.py"}
EXAMPLES = sorted(set((ROOT / "examples").glob("*.py")) - {BUSY} - WITH_PACKAGES)
_BLOCK = re.compile(r"(?:<!-- (?P<mark>[^>]*?) -->\n)?```(?P<kind>\w+)\n(?P<text>.*?)^```", re.DOTALL | re.MULTILINE)
_ANY = re.compile(
    r"(?:<!-- (?P<mark>[^>]*?) -->\n)?^ *```(?P<kind>[^\n]*)\n(?P<text>.*?)^ *```$", re.DOTALL | re.MULTILINE
)
#: the kinds of blocks with their marks; docs/development/book.md names the test of each
_MARKS = {
    "console": {"", "beside", "parsed"},
    "json": {"", "printed"},
    "mermaid": {"picture"},
    "python": {"", "file", "readers", "tests"},
    "sql": {"readers"},
    "text": {
        "",
        "after Ctrl-C",
        "decode",
        "file",
        "filters",
        "output",
        "printed",
        "readers",
        "session",
        "symptom",
        "syntax",
    },
    "toml": {"", "device file", "file", "parameter list", "parsed", "scenario", "thresholds file"},
    "yaml": {""},
    "{eval-rst}": {""},
}
_SUDO = re.compile(r"^sudo (-u \w+ )?(\w+=\S+ )?")
_LINK = re.compile(r"\[[^\]]*\]\(([^)#\s]*)(?:#([^)\s]*))?\)")
_CITATION = re.compile(r"docs/[\w/-]+\.md(?:#[\w-]+)?")
_HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)
#: what is code in a page holds no headings and no links
_CODE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
#: facts cited by the numbers of lists that are not in the project
#: each begins with a letter or a word, which the module re finds ten times as quickly as a choice of them
_OLD_CITATIONS = [
    re.compile(text)
    for text in (
        r"protocol facts",
        r"section [A-J]\b(?! of)",
        r"[Rr]ows? [DKILF]\d+",
        r"spec p\.? ?\d",
        r"check list",
        r"\((?:[A-D]\d|J)(?:, (?:[A-D]\d|J))*\)",
    )
]
#: words that a reader has to guess: "reported" or "invalid", "no ... exists" and "if" say what is meant
_GUESSED = re.compile(
    r"(?<![`_])\btold\b(?![`_])|\b(?:is|are|was|were)[\s#:]+none\b(?! of)|"
    r"\b(?:None|empty|also|only|except|but)[\s#:]+where\b"
)
#: texts that have such words and mean them
_MEANT = ("deadlines. The default is none: virtual time",)
FIRST_PLANT = ROOT / "docs" / "tutorial" / "first-plant.md"
_ARCHITECTURE = ROOT / "docs" / "development" / "architecture.md"
SOURCES = sorted(
    path
    for room in ("dpstack", "drives", "tests", "bench", "tools", "examples")
    for path in (ROOT / room).rglob("*")
    if path.suffix in {".py", ".toml", ".gsd"} and path != Path(__file__).resolve()
)


def blocks(page: Path, kind: str) -> list[tuple[str, str]]:
    """(mark, text) of every block of ``kind``."""
    found = _BLOCK.finditer(page.read_text(encoding="utf-8"))
    return [(match["mark"] or "", match["text"]) for match in found if match["kind"] == kind]


@pytest.fixture
def fast(monkeypatch: pytest.MonkeyPatch) -> None:
    """``asyncio.run`` in virtual time: examples take no longer than their computing."""
    monkeypatch.setattr("asyncio.run", dpstack.run_virtual)


def write_files(page: Path, folder: Path) -> list[str]:
    """The configurations that ``page`` gives a file name, written into ``folder``."""
    files = {mark.removeprefix("file: "): text for mark, text in blocks(page, "toml") if mark.startswith("file: ")}
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    return list(files)


@pytest.mark.usefixtures("fast")
def test_the_drives_of_the_tutorial_obey(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every `dpstack drive plant.toml` of the first plant."""
    assert write_files(FIRST_PLANT, tmp_path) == ["plant.toml"]
    monkeypatch.chdir(tmp_path)
    lines = [line for _, text in blocks(FIRST_PLANT, "console") for line in text.splitlines()]
    orders = [shlex.split(line)[2:] for line in lines if line.startswith("$ dpstack drive plant.toml")]
    assert ["drive", "plant.toml", "hoist", "start", "speed", "0.5", "reached"] in orders
    for words in orders:
        assert main([*words, "--seconds", "1"]) == 0, capsys.readouterr().err
    assert "hoist: running at 50.0% (25.0 Hz), set point 50.0%" in capsys.readouterr().out


@pytest.mark.usefixtures("fast")
def test_a_hoist_as_delivered_says_where_set_412_goes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (plant,) = [text for mark, text in blocks(FIRST_PLANT, "toml") if mark == "file: plant.toml"]
    bare = "\n".join(line for line in plant.splitlines() if "set_412" not in line)
    (tmp_path / "plant.toml").write_text(bare, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    assert main(["drive", "plant.toml", "hoist", "start"]) == 1
    told = capsys.readouterr().err.splitlines()[-1]
    assert "412 is 44: control not by the bus; write 412 = 1 in the active data set (1)" in told
    assert "set_412 = true" in told
    assert 'configuration file, table [slave.options] below the [[slave]] table with name = "hoist"' in told
    # what it says is what works
    lines = bare.splitlines()
    (at,) = [number for number, line in enumerate(lines) if line.startswith('drive = "demag-dedrive"')]
    said = [*lines[: at + 1], "[slave.options]", "set_412 = true", *lines[at + 1 :]]
    (tmp_path / "plant.toml").write_text("\n".join(said), encoding="utf-8")
    assert main(["drive", "plant.toml", "hoist", "start", "--seconds", "1"]) == 0


def test_the_example_with_a_bus_process_runs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A busy computer may let its slaves wait, and its bus process, whose stall would end the outputs."""
    opened = dpstack.open_bus
    patient: dict[str, Any] = {"max_retry": 15, "after_stall": "resume"}
    monkeypatch.setattr(dpstack, "open_bus", lambda **given: opened(**given | patient))
    runpy.run_path(str(BUSY), run_name="__main__")
    assert capsys.readouterr().out.splitlines() == [
        "the bus went round while the program stood still: True",
        "the fan runs: True",
    ]


@contextlib.contextmanager
def logging_as_before() -> Iterator[None]:
    """Put levels and handlers back that an example sets for its program."""
    root = logging.getLogger()
    handlers = list(root.handlers)
    yield
    root.handlers[:] = handlers
    for logger in list(logging.Logger.manager.loggerDict.values()):
        if isinstance(logger, logging.Logger) and logger.name.startswith(("dpstack", "plant")):
            logger.setLevel(logging.NOTSET)


@pytest.mark.usefixtures("fast")
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda p: p.stem)
def test_examples_run(example: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("sys.argv", [str(example)])
    with logging_as_before():
        runpy.run_path(str(example), run_name="__main__")
    out = capsys.readouterr().out
    wanted = {
        "auto_baud": [
            "the slaves follow to 1500000 bit/s, master 5 found 1500000",
            "the slaves follow to 187500 bit/s, master 5 found 187500",
        ],
        "fixed_cycle": [
            "200 cycles, the two never more than 0 apart, 0 missed",
            "the lamp was told 0.25 times a cycle",
        ],
        "fdl_controllers": [
            "station 2 has received b'block 0' from 1",
            "station 1 has received b'block 0' from 2",
            "station 2 has received b'block 2' from 1",
            "station 1 has received b'block 2' from 2",
        ],
        "own_slave": ["level 40 %", "ext_diag, wd_on 80 40 07", "valve closed"],
        "alarms": [
            "pull alarm, slot 2; module status: slot 2 no module; slots with a diagnosis: 2 (8 DO)",
            "  slots 00 03 00",
            "plug alarm, slot 2; module status: all modules ok",
            "process alarm, slot 1",
        ],
        "im_inventory": [
            "  1  master in ring",
            "  3  ident 0x4711, master 1: V-8, serial number 0042, V1.0.0, cooling",
            "  4  ident 0x4711, master 1: refuses I&M (0xB0)",
            "  5  ident 0x1234, master 1: no class 2 connection (or none free)",
        ],
        "dpv1_slave": [
            "b'water' b'milk'",
            "over class 2: b'water', MIX-1",
            "slave 9 (mixer): process alarm, slot 1, data 01",
            "1 of 1 parameters",
            "10 Ramp time (50,)",
            "slave 9 refuses Write of slot 1, index 12: write length error (80 B1 00: class access, code 1); "
            "give the record exactly the octets its manual names",
            "slave 9 (mixer): Write of slot 1, index 13 of master 2 refused: its function failed "
            "(OSError: disk full), in write(), dpv1_slave.py line 36",
        ],
        "conveyor_and_pump": [
            "not started: the tank is empty, or the stop button is pressed",
            "running: pump and conveyor turn",
            "idle: the tank is empty",
            "fault: conveyor: without a name: PPO3 and PPO4 do not carry it, the keypad shows it",
            "  pump stopped",
            "fault: pump: stopped answering during Data_Exchange",
            "  conveyor stopped",
            "  pump did not stop by order",
            "idle: acknowledged",
        ],
        "plant_watcher": ["stopped, missing: no slave; diagnoses: none; masters: [2]"],
        "soft_slave": [
            "mixer: in data exchange with master 2",
            "PLC: slot 1 (2 octets in, 1 octet out), input channel 0 (unspecific): mixer too hot (let it cool down)",
            "PLC: inputs 01 3e",
            "PLC: no diagnosis any more",
            "mixer: off",
        ],
        "two_drives": ["hoist at 25 Hz", "fan at 24 Hz", "fan at -24 Hz"],
        "valves_in_step": [
            "step 3 {'north': '03', 'south': '03'}",
            "north is deactivated",
            "north is in groups (1, 2) and watches for 500 ms",
        ],
        "class_2": [
            "3: ident 0x0696, master 2, config f3 71",
            "outputs {'flap': True}",
            "inputs {'limit': True}",
            "slave 126 does not answer Slave_Diag; check address and power; `dpstack scan` shows who is there",
        ],
        "blocking_script": ["the flap is open", "the fan is at 10%"],
        "watch_events": ["slave 3 (hoist): data_exchange", "8 valves data_exchange 00"],
    }[example.stem]
    assert [line for line in wanted if line not in out] == []


def test_the_page_lists_every_example_with_its_one_command() -> None:
    folder = ROOT / "examples"
    rows = re.findall(
        r"^\| `([^`]+)` \|", (ROOT / "docs" / "how-to" / "examples.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    starts = {".py": "python", ".ipynb": "jupyter lab"}
    programs = {f"{starts[path.suffix]} examples/{path.name}" for path in folder.iterdir() if path.suffix in starts}
    folders = {"pytest examples/test_bench", "pip install ./examples/thirdparty_drive", "sh examples/ci/job.sh"}
    commands = {row for row in rows if row.startswith("dpstack ")}
    assert sorted(rows) == sorted(programs | folders | commands)
    named = {name for row in rows for name in re.findall(r"examples/([\w.]+)", row)}
    assert named == {path.name for path in folder.iterdir() if path.name != "__pycache__"}
    for command in commands:
        build_parser().parse_args(shlex.split(command)[1:])


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_configurations_load(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)  # files they name are of the checkout
    for name, file in re.findall(r"^\$ dpstack gsd copy (\S+) (\S+)", page.read_text(encoding="utf-8"), re.MULTILINE):
        copy_gsd(name, tmp_path / file)
    for mark, text in blocks(page, "toml"):
        try:
            if mark.startswith("parsed:"):  # listed on docs/development/book.md
                tomllib.loads(text)
            elif mark == "device file" or (text.startswith("format = 1\n") and "\nbase = " in text):
                data = tomllib.loads(text)
                if "gsd" in data and not (tmp_path / data["gsd"]).exists():  # one that has these modules
                    sensor = ROOT / "dpstack" / "devices" / "library" / "simodrive-sensor.gsd"
                    (tmp_path / data["gsd"]).write_bytes(sensor.read_bytes())
                path = tmp_path / f"{data['name']}.toml"
                path.write_text(text, encoding="utf-8")
                finding.read(path)
            elif 'drive = "./' in text:  # a plant with a device file of the page
                (tmp_path / "plant.toml").write_text(text, encoding="utf-8")
                load_config(tmp_path / "plant.toml")
            elif mark == "thresholds file":
                (tmp_path / "limits.toml").write_text(text, encoding="utf-8")
                load_thresholds(tmp_path / "limits.toml")
            elif mark == "parameter list":
                ParameterList.parse(text, page.name)
            elif mark == "scenario":
                bench = dpstack.simulate(dpstack.World(), load_config(ROOT / "examples" / "plant.toml").slaves)
                parse_scenario(text, bench, slave_handlers(bench), page.name)
            else:
                parse_config(text, page.name)
        except ConfigError as error:
            pytest.fail(f"{error}\n{text}")


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_json_is_json(page: Path) -> None:
    """A file, or JSON lines."""
    for _, text in blocks(page, "json"):
        for one in [text] if text.startswith("{\n") else text.splitlines():
            json.loads(one)


_parser = cache(build_parser)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_commands_exist(page: Path) -> None:
    parser = _parser()
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for mark, text in blocks(page, "console"):
        for line in re.split(r"\n| && | \| ", "\n".join(commands(text))):
            words = shlex.split(re.split(r" >>? ", _SUDO.sub("", line))[0], comments=True)
            if Path(words[0]).name == "dpstack":
                try:
                    parser.parse_args(words[1:])
                except SystemExit as end:  # --version
                    assert end.code == 0, line  # noqa: PT017 - another exception fails as it is
            elif words[:2] == ["pip", "install"]:
                folder = words[2].partition("[")[0]  # before the extras
                assert (ROOT / folder / "pyproject.toml").exists()
            elif words[:3] == ["python", "-m", "bench"]:
                assert words[3] in {*BENCHMARKS, "compare", "goals"}
            elif words[0] == "make":
                assert all(f"\n{word}:" in makefile for word in words[1:]), line
            else:
                assert mark.startswith("parsed: "), line


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_block_is_of_a_kind_and_a_mark_with_a_test(page: Path) -> None:
    found = [(match["kind"], match["mark"] or "", match["text"]) for match in _ANY.finditer(page.read_text("utf-8"))]
    kinds = [(kind, mark.partition(":")[0]) for kind, mark, _ in found]
    assert [one for one in kinds if one[1] not in _MARKS.get(one[0], ())] == []
    plain = [text for kind, mark, text in found if (kind, mark) == ("text", "")]
    assert [text for text in plain if re.search(r"^(\$ |(dpstack|import|async|await|from) )", text, re.MULTILINE)] == []


def slug(heading: str) -> str:
    """The anchor that GitHub makes of a heading: "RD_Inp, RD_Outp" -> rd_inp-rd_outp."""
    return re.sub(r"[^\w -]", "", heading.strip().lower()).replace(" ", "-")


@cache
def anchors(page: Path) -> frozenset[str]:
    """Of headings and of ``<a id="...">``; two of the same name would lead to the first one only."""
    text = _CODE.sub("", page.read_text(encoding="utf-8"))
    names = [slug(heading) for heading in _HEADING.findall(text)] + re.findall(r'<a id="([^"]+)">', text)
    doubled = [name for name, times in Counter(names).items() if times > 1]
    assert page.name == "CHANGELOG.md" or not doubled, f"{page.name}: {doubled}"
    return frozenset(names)


def test_each_picture_is_taken_by_a_test_from_a_plant_that_its_page_names() -> None:
    assert {path.name for path in FOLDER.glob("*.png")} == set(PICTURES)
    for name, test in PICTURES.items():
        text = (ROOT / "tests" / "strangers" / test).read_text(encoding="utf-8")
        assert "picture_folder(" in text, test
        assert "shows_no_place(" in text or name == "plot.png", test  # its title has the name of the file alone
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        taken = {name for name in PICTURES if f"/{name})" in text}
        own = {name for name in taken if name.startswith("tutorial-")}
        assert not own or "<!-- file: motor.toml -->" in text
        assert taken == own or ("pictures/plant.toml)" in text and "simulated plant" in text), page


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    for target, anchor in _LINK.findall(_CODE.sub("", page.read_text(encoding="utf-8"))):
        if "://" in target:
            continue
        found = (page.parent / target).resolve() if target else page
        assert found.exists(), f"{page.name}: {target}"
        assert not anchor or anchor in anchors(found), f"{page.name}: {target}#{anchor}"


def missing(text: str) -> list[str]:
    """The citations of documents in ``text`` that lead nowhere."""
    found = (citation.partition("#") for citation in _CITATION.findall(text))
    return [
        f"{file}#{anchor}"
        for file, _, anchor in found
        if not (ROOT / file).is_file() or (anchor and anchor not in anchors(ROOT / file))
    ]


def old_form(text: str) -> list[str]:
    return [found for pattern in _OLD_CITATIONS for found in pattern.findall(text)]


@pytest.mark.parametrize("find", [missing, old_form], ids=["leads nowhere", "old form"])
def test_citations_in_the_sources_lead_to_an_anchor(find: Callable[[str], list[str]]) -> None:
    wrong = {path: find(path.read_text(encoding="utf-8", errors="replace")) for path in SOURCES}
    assert {str(path.relative_to(ROOT)): found for path, found in wrong.items() if found} == {}


def test_a_citation_of_nothing_is_found() -> None:
    assert missing("docs/reference/protocol.md#t-sl, docs/reference/protocol.md") == []
    assert missing("docs/reference/protocol.md#nothing and docs/nothing.md") == [
        "docs/reference/protocol.md#nothing",
        "docs/nothing.md#",
    ]
    assert old_form("(protocol facts B6), row D17 (C3, J)") == ["protocol facts", "row D17", "(C3, J)"]


def guessed(text: str) -> list[str]:
    """The words of ``text`` that a reader has to guess, with the words around them."""
    found = (text[max(match.start() - 30, 0) : match.end() + 30] for match in _GUESSED.finditer(text))
    return [" ".join(one.split()) for one in found if not any(meant in one for meant in _MEANT)]


def prose(source: str) -> Iterator[str]:
    """The docstrings and the comments of a program."""
    for node in statements(ast.parse(source)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.value.value
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    yield "\n".join(token.string for token in tokens if token.type == tokenize.COMMENT)


def test_pages_say_reported_invalid_and_if() -> None:
    found = {
        str(page.relative_to(ROOT)): guessed(_CODE.sub("", page.read_text(encoding="utf-8")))
        for page in PAGES
        if page.name != "CHANGELOG.md"
    }
    assert {page: words for page, words in found.items() if words} == {}


@pytest.mark.parametrize("room", ["dpstack", "drives"])
def test_docstrings_and_comments_say_reported_invalid_and_if(room: str) -> None:
    found = {}
    for path in (ROOT / room).rglob("*.py"):
        source = path.read_text(encoding="utf-8")
        if _GUESSED.search(source):  # in a message or a name, perhaps
            found[str(path.relative_to(ROOT))] = [words for text in prose(source) for words in guessed(text)]
    assert {path: words for path, words in found.items() if words} == {}


def test_words_to_guess_are_found() -> None:
    assert guessed("An item that is none changes nothing, and is\ntold once.") == [
        "An item that is none changes nothing, and is told",
        "none changes nothing, and is told once.",
    ]
    assert guessed("It is none of them; ``told`` is a name. None\n    where nobody knows") == [
        "of them; ``told`` is a name. None where nobody knows"
    ]
    assert list(prose('"""A page."""\nname = "told"  #: a line')) == ["A page.", "#: a line"]


def test_every_command_and_option_is_documented() -> None:
    text = (ROOT / "docs" / "reference" / "commands.md").read_text(encoding="utf-8")
    for name in _COMMANDS:
        assert f"`dpstack {name}" in text


def test_the_syntax_of_the_commands_names_options_that_they_have() -> None:
    ((_, text),) = [found for found in blocks(ROOT / "docs/reference/commands.md", "text") if found[0] == "syntax"]
    known = {
        command.prog: {option for action in command.actions() for option in action.option_strings}
        for command, _ in make_reference_docs.commands(build_parser())
    }
    lines = re.sub(r"\n +", " ", text).splitlines()
    assert len(lines) > len(_COMMANDS)
    for line in lines:
        words = line.split()
        options = known.get(" ".join(words[:3])) or known[" ".join(words[:2])]
        assert set(re.findall(r"--[\w-]+", line)) <= options, line


def test_readme_and_purpose_say_where_to_begin_alike() -> None:
    """The README's table has all rows of the page about the purpose, with its own way to the pages."""
    rows = [
        {
            (wish, link.removeprefix("docs/").removeprefix("../"))
            for wish, link in re.findall(
                r"^\| ([^|]+) \| \[[^\]]+\]\(([^)]+)\) \|$", page.read_text("utf-8"), re.MULTILINE
            )
        }
        for page in (ROOT / "docs" / "explanation" / "purpose.md", ROOT / "README.md")
    ]
    assert len(rows[0]) > 5
    assert rows[0] <= rows[1]


def test_every_path_of_the_walk_through_the_code_is_there() -> None:
    text = re.sub(r"```.*?```", "", _ARCHITECTURE.read_text(encoding="utf-8"), flags=re.DOTALL)
    paths = set(re.findall(r"`([\w./-]+/[\w.-]*\w\.(?:py|js|toml))`", text))
    assert len(paths) > 80
    assert [path for path in sorted(paths) if not ((ROOT / path).exists() or (ROOT / "dpstack" / path).exists())] == []


def test_every_control_command_is_documented() -> None:
    from dpstack.api.control.commands import KINDS as COMMANDS

    text = (ROOT / "docs" / "reference" / "commands.md").read_text(encoding="utf-8")
    names = {spec.name for specs in COMMANDS.values() for spec in specs}
    assert [name for name in sorted(names) if not re.search(rf"`{name}[ `]", text)] == []


def test_the_tables_of_keys_are_those_of_the_readers() -> None:
    for path, text in make_config_docs.pages().items():
        assert path.read_text(encoding="utf-8") == text, f"{path.name}: run python -m tools.make_config_docs"


def test_the_pages_made_from_the_sources_are_up_to_date() -> None:
    wrong = [str(path.relative_to(ROOT)) for path in make_reference_docs.differing()]
    assert wrong == [], "run python -m tools.make_reference_docs"


def test_the_page_about_the_book_names_every_outside_link_and_every_command_that_does_not_run() -> None:
    page = make_book_docs.TARGET.read_text(encoding="utf-8")
    assert page == make_book_docs.render(page), "run python -m tools.make_book_docs"


def test_the_table_of_bus_parameters_is_the_programs() -> None:
    text = (ROOT / "docs" / "reference" / "bus-parameters.md").read_text(encoding="utf-8")
    rows = [row.strip("|").split("|") for row in text.splitlines() if re.match(r"\| [\d.]", row)]
    seen = 0
    for row in rows:
        names, *numbers = (cell.strip() for cell in row)
        for rate in names.split(","):
            p = BusParams.preset(round(float(rate) * 1000))
            wanted = [p.t_sl, p.min_tsdr, p.max_tsdr, p.t_set, p.t_qui, p.gap, p.max_retry, p.t_tr]
            assert [int(n.replace(" ", "")) for n in numbers] == wanted, rate
            seen += 1
    assert seen == 11


def test_every_fault_is_in_the_troubleshooting() -> None:
    from dpstack.dp.master.events import FaultKind

    text = (ROOT / "docs" / "reference" / "troubleshooting.md").read_text(encoding="utf-8")
    assert [kind.value for kind in FaultKind if f"| `{kind.value}` |" not in text] == []


def test_the_table_of_neighbours_is_the_programs() -> None:
    from dpstack.phy.neighbours import Neighbours
    from dpstack.phy.patience import ADAPTER, measured

    text = (ROOT / "docs" / "reference" / "bus-parameters.md").read_text(encoding="utf-8")
    rows = re.findall(r"\| (not measured, 20|measured (\d)) ms(?:, lowest other master (\d))? \|(.*)\|", text)
    for _, ms, lowest, cells in rows:
        patience = measured(int(ms) * 1_000_000) if ms else ADAPTER
        for cell, baud in zip(cells.split("|"), (187_500, 500_000, 1_500_000), strict=True):
            wanted = Neighbours(BusParams.preset(baud), patience, int(lowest or 0)).t_sl
            assert ("none" in cell) if wanted > 16_383 else int(cell.replace(" ", "")) == wanted
    assert len(rows) == 3


def _file(name: str) -> Path:
    """A file that the walk through the code names."""
    return next((path for path in (ROOT / "dpstack" / name, ROOT / name) if path.exists()), ROOT / name)


def test_the_walk_names_files_that_exist() -> None:
    named = re.findall(r"`([\w/.-]+(?:\.py|/))`", _ARCHITECTURE.read_text(encoding="utf-8"))
    assert len(named) > 80
    assert [name for name in named if not _file(name).exists() and name != "__init__.py"] == []


def test_each_connector_has_what_the_list_for_a_further_one_asks() -> None:
    """Table, package, kind, extra, row of the imports, section of the configuration, tests."""
    steps = _ARCHITECTURE.read_text(encoding="utf-8").partition("## A further connector")[2].partition("\n## ")[0]
    assert re.findall(r"^\d\. \*\*(\w+)", steps, re.MULTILINE) == [
        "Table", "Package", "Kinds", "Extra", "Names", "Orders", "Docs", "Tests",
    ]  # fmt: skip
    assert list(KINDS) == list(CONNECTORS)
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    pages = (ROOT / "docs" / "reference" / "configuration.md").read_text(encoding="utf-8")
    imports = (ROOT / "tests" / "test_imports.py").read_text(encoding="utf-8")
    for name, kind in KINDS.items():
        assert kind.module.startswith(f"dpstack.bridge.{name}.")
        assert extras[name]
        assert name in extras["test"][0]
        assert f'"bridge/{name}"' in imports
        assert re.search(rf"^#+ .*\[{name}\]", pages, re.MULTILINE), name
        assert (ROOT / "tests" / f"bridge_{name}").is_dir()


def test_the_walk_finds_what_a_newcomer_asks_for() -> None:
    """Functions and tables named beside a question are in the files of that row; no cell is an essay."""
    lines = _ARCHITECTURE.read_text(encoding="utf-8").splitlines()
    rows = [line.strip("|").split("|") for line in lines if line.startswith("| ") and line.count("|") == 4]
    questions = [row for row in rows if row[0].strip().endswith("?")]
    assert len(questions) >= 10
    for question, *cells in questions:
        words = re.findall(r"`([^`]+)`", " ".join(cells))
        source = "".join(_file(word).read_text(encoding="utf-8") for word in words if word.endswith(".py"))
        names = [part for word in words if not word.endswith(".py") for part in word.split(".")]
        assert [name for name in names if not re.search(rf"(?:def|class) {name}\b|^{name}\b", source, re.M)] == [], (
            question
        )
    assert [cell for row in rows for cell in row if len(cell.split()) > 45] == []
