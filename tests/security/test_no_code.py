"""No file runs code: crafted configurations, exports, GSD files, captures, recordings, scenarios and lists are read by
every command that reads them, in a process that reports each import, each program and each file that is opened; and the
places in the source that could load code, start programs or open sockets are those that are listed here.
"""

from __future__ import annotations

import functools
import json
import os
import pickle
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

import dpstack
import dpstack_drives
from dpstack.record import plot

ROOTS = (Path(dpstack.__file__).parent, Path(dpstack_drives.__file__).parent)


class Bomb:
    """Makes a file where it is unpickled."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.system, ("touch exploded",)


PICKLE = pickle.dumps(Bomb())
CODE = '__import__("os").system("touch exploded")'
YAML = f"!!python/object/apply:os.system ['touch exploded']\nx: {{'{CODE}'}}\n"
BUS = '[bus]\nport = "virtual"\nbaud = 500000\n'


def slave(*lines: str) -> str:
    return BUS + '[[slave]]\nname = "a"\naddress = 8\n' + "\n".join(lines) + "\n"


RAW = ("ident = 0x1234", 'config = "20 10"')
#: files by name; those of one ending are read by the commands of COMMANDS
FILES: dict[str, bytes | str] = {
    "drive.toml": slave('drive = "os:system"'),
    "drive_place.toml": slave('drive = "evil:DRIVE"'),
    "drive_path.toml": slave('drive = "../evil"'),
    "gsd_code.toml": slave('gsd = "evil.py"'),
    "gsd_above.toml": slave('gsd = "../../../../../../etc/hostname"'),
    "gsd_shell.toml": slave('gsd = "$(touch exploded).gsd"'),
    "gsd_good.toml": slave('gsd = "crafted.gsd"'),
    "function.toml": slave(*RAW, 'simulate = { function = "evil:inputs" }'),
    "recording.toml": slave(*RAW, 'simulate = { recording = "pickle.csv" }'),
    "names.toml": slave(*RAW).replace('"a"', f"'{CODE}'"),
    "format.toml": slave(*RAW).replace('"a"', '"{0.__class__.__init__.__globals__} %(x)s {e.__dict__}"'),
    "port.toml": slave(*RAW).replace('"virtual"', '"spy://virtual?file=exploded"'),
    "port_code.toml": slave(*RAW).replace('"virtual"', '"evil://x"'),
    "yaml.toml": YAML,
    "pickle.toml": PICKLE,
    "crafted.gsd": f'#Profibus_DP\nGSD_Revision = 3\nVendor_Name = "{CODE}"\nModel_Name = "$(touch exploded)"\n'
    'Bitmap_Device = "../../etc/passwd"\nPrmText = 1\nText(0) = "`touch exploded`"\nEndPrmText\n'
    'Ident_Number = 0x1234\nModule = "a" 0x20\nEndModule\nMax_Input_Len = 1\n',
    "pickle.gsd": PICKLE,
    "yaml.gsd": YAML,
    "pickle.pcapng": PICKLE,
    "code.pcapng": CODE,
    "pickle.csv": PICKLE,
    "code.csv": f"time,t,a.{CODE}\n2026-11-22T20:00:00.000Z,0.0,=cmd|'/C calc'!A0\n",
    "code.jsonl": '{"py/object":"os.system","py/reduce":[{"py/function":"os.system"},["touch exploded"]]}\n',
    "pickle.list": PICKLE,
    "code.list": f'format = 1\ndrive = "evil:DRIVE"\nname = "{CODE[:9]}"\naddress = 3\nparameters = []\n',
    "function.scenario": '[[step]]\nat = 0.0\nslave = "a"\ndo = "set"\nfunction = "evil:inputs"\n',
    "pickle.scenario": PICKLE,
    "pickle.cfg": PICKLE,
    "crafted.cfg": 'FILEVERSION "3.2"\r\n#STEP7_VERSION $(touch exploded)\r\nSTATION S7300 , "evil:DRIVE"\r\nBEGIN \r\n'
    '  COMMENT "`touch exploded`"\r\nEND \r\nDPSUBSYSTEM 1, "x"\r\nBEGIN \r\nEND \r\n'
    'DPSUBSYSTEM 1, DPADDRESS 9, "../evil.py", "$(touch exploded)"\r\nBEGIN \r\n  PNO_IDENT_NO "4660"\r\nEND \r\n'
    'DPSUBSYSTEM 1, DPADDRESS 9, SLOT 1, "evil:DRIVE", "x"\r\nBEGIN \r\n  SLAVE_CFG_DATA "01 00 20"\r\nEND \r\n',
    "evil.py": "open('exploded', 'w')\n",
    "matplotlibrc": "backend: module://evil\ntext.usetex: True\n",
    "sitecustomize.py": "open('exploded', 'w')\n",
    "pyproject.toml": '[tool.dpstack]\nplugin = "evil"\n',
}
COMMANDS: dict[str, tuple[str, ...]] = {
    ".toml": ("plan {}",),
    ".gsd": ("gsd show {}", "gsd check {}", "gsd configure {}"),
    ".pcapng": ("decode {}", "monitor {}"),
    ".csv": ("plot {} --json",),
    ".jsonl": ("plot {} --json",),
    ".cfg": ("import {}",),
    ".scenario": ("sim plain.toml --port pty --scenario {}",),
    "function.toml": ("sim {} --port pty",),
    "recording.toml": ("sim {} --port pty",),
    ".py": ("plan {}", "decode {}"),
}
#: those that `make test` reads; the others in `make soak`
QUICK: tuple[str, ...] = (
    "drive_place.toml",
    "function.toml",
    "pickle.toml",
    "crafted.gsd",
    "pickle.gsd",
    "pickle.pcapng",
    "code.csv",
)
QUICK += ("function.scenario", "evil.py", "crafted.cfg")
#: reports events of the interpreter once it is armed: by then the commands' own modules are loaded
PROGRAM = r"""
import contextlib, io, json, os, sys
armed, seen = False, []
CODE = ("import", "exec", "compile", "pickle.find_class", "marshal.loads", "marshal.load", "code.__new__",
        "os.system", "os.exec", "os.fork", "os.forkpty", "os.posix_spawn", "os.spawn", "subprocess.Popen", "pty.spawn",
        "ctypes.dlopen", "socket.bind", "socket.connect", "os.remove", "os.rename", "os.symlink", "os.chmod")
def hook(name, args):
    if armed and (name in CODE or name == "open"):
        if name == "import" and (args[0] in sys.builtin_module_names or args[0].startswith(("encodings.", "_"))):
            return
        seen.append([name, *(repr(one) for one in args[:2])])
sys.addaudithook(hook)
from dpstack.cli.main import main
from dpstack.api.lists.parameter_list import ParameterList
from dpstack.api.lists.record_list import RecordList
from dpstack.errors import DpError
commands, lists = json.load(sys.stdin)
def run(words):
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as told:
        try:
            code = main(words)
        except SystemExit as end:
            code = end.code
    return [" ".join(words), code, told.getvalue()]
def read(path):
    for kind in (ParameterList, RecordList):
        try:
            kind.load(path)
        except DpError as error:
            return str(error)
for words in commands:  # loads what they need
    run(words)
for path in lists:
    read(path)
armed = True
ends = [run(words) for words in commands]
for path in lists:
    ends.append([path, 2, read(path)])
armed = False
print(json.dumps({"ends": ends, "seen": seen}))
"""


@pytest.mark.parametrize("chosen", ["one of each kind", pytest.param("all", marks=pytest.mark.soak)])
def test_crafted_files_run_nothing_and_lead_nowhere(chosen: str, tmp_path: Path) -> None:
    for name, content in FILES.items():
        tmp_path.joinpath(name).write_bytes(content if isinstance(content, bytes) else content.encode())
    tmp_path.joinpath("plain.toml").write_text(slave(*RAW))
    tmp_path.joinpath("linked.gsd").symlink_to("/etc/passwd")
    tmp_path.joinpath("loop.toml").symlink_to("loop.toml")
    names = sorted([*FILES, "linked.gsd", "loop.toml"])
    commands = [
        words.format(name).split()
        for name in (names if chosen == "all" else QUICK)
        for key in (name, Path(name).suffix)
        for words in COMMANDS.get(key, ())
    ]
    lists = [name for name in names if name.endswith(".list")]
    done = subprocess.run(
        [sys.executable, "-P", "-c", PROGRAM],
        input=json.dumps([commands, lists]),
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
        cwd=tmp_path,
    )
    found = json.loads(done.stdout)
    assert not tmp_path.joinpath("exploded").exists()
    assert [one for one in found["seen"] if one[0] != "open"] == []
    opened = {one[1].strip("'") for one in found["seen"]}
    outside = {path for path in opened if path.startswith("/") and not path.startswith((*map(str, ROOTS), sys.prefix))}
    assert {path for path in outside if not path.startswith(str(tmp_path))} <= {"/etc/passwd", "/etc/hostname"}
    refused = {words.split()[-1] for words, code, _ in found["ends"] if code == 2}
    assert refused >= {"drive_place.toml", "pickle.toml", "evil.py", "pickle.list"}
    assert {code for words, code, _ in found["ends"] if words == "import crafted.cfg"} == {0}
    assert any("--allow-code" in told for words, _, told in found["ends"] if words.startswith("sim function.toml"))
    assert not [
        told for _, code, told in found["ends"] if "Traceback" in told or "root:" in told or code not in (0, 1, 2)
    ]
    assert all("__globals__': " not in told for _, _, told in found["ends"])


@functools.cache
def sources() -> dict[str, str]:
    return {
        path.relative_to(root.parent).as_posix(): path.read_text(encoding="utf-8")
        for root in ROOTS
        for path in root.rglob("*.py")
    }


@pytest.mark.parametrize(
    ("what", "pattern", "places"),
    [
        ("objects or code out of octets", r"\b(?<!never )(pickle|marshal|shelve|dill|yaml|jsonpickle)\b", set()),
        ("evaluated text", r"(?<![\w.])(eval|exec|compile|__import__)\(", set()),
        ("a shell", r"os\.system|os\.popen|shell=True|subprocess\.getoutput", set()),
        (
            "modules by name",
            r"import_module\(|run_module\(|entry_points\(|spec_from_file",
            {
                "__init__.py",  # its own lazy names
                "namespaces.py",  # the lazy names of all namespaces
                "cli/parser.py",  # the modules of its commands
                "ports/posix.py",  # fcntl, termios, grp
                "entry_points.py",  # of installed packages
                "profile/registry.py",  # drives by entry point
                "devices/finding.py",  # packages with device files, by entry point
                "devices/profiles.py",  # Python that a package has registered for a device file
                "late_imports.py",  # modules of Python whose import is put off
                "drivers/process/plugins.py",  # the same in the bus process
                "api/streams.py",  # modules of ours that a running bus needs, see the test below
                "api/user_code.py",  # functions with --allow-code, slaves named on the command line
                "web/child.py",  # dpstack run
            },
        ),
        (
            "programs",
            r"subprocess\.(run|Popen|call)|create_subprocess|os\.(fork|exec|posix_spawn|spawn)\w*\(",
            {
                "api/recording/parquet.py",
                "drivers/process/channel.py",
                "drivers/process/early_start.py",
                "screen/process.py",
                "service/host_setup.py",  # the set-up script
                "web/child.py",
                "wireshark/installation.py",  # tshark
                "wireshark/extcap.py",  # dpstack capture
            },
        ),
        (
            "connections to other computers",
            r"create_connection\(|sock_connect\(|rfc2217\.Serial|urllib\.request|http\.client|import requests"
            r"|ClientSession|aiomqtt\.Client\(|(?<!class )LimitedClient\(",
            {"ports/tcp.py", "ports/rfc2217.py", "bridge/mqtt/connection.py"},
        ),
        (
            "datagrams",
            r"sendto\(|sendmsg\(",
            {
                "bridge/epics/server.py",  # answers to searches, beacons
                "service/notify.py",  # systemd, over a Unix socket
            },
        ),
    ],
)
def test_the_places_in_the_source(what: str, pattern: str, places: set[str]) -> None:
    wanted = re.compile(pattern)
    assert {name for name, text in sources().items() if wanted.search(text)} == {f"dpstack/{one}" for one in places}, (
        what
    )


def test_a_running_bus_loads_only_modules_named_in_the_source() -> None:
    """No command, configuration or octets of others decide about the modules that ``load_beside`` imports."""
    found = {words for text in sources().values() for words in re.findall(r"await load_beside\((.*)\)", text)}
    literal = {word for words in found for word in words.split(", ") if word.startswith('"dpstack.')}
    connectors = "*(kind.module for kind in kinds.values())"
    assert {word for words in found for word in words.split(", ")} - literal == {
        "place",
        "*_WHY",
        "_KNOWN",
        '"construct"',
        connectors,
    }
    modules = re.findall(r"ConnectorKind\((\S+),", sources()["dpstack/api/connectors/kinds.py"])
    assert modules
    assert all(re.fullmatch(r'"dpstack\.bridge\.\w+\.\w+"', word) for word in modules)
    assert 'place = f"{__package__}.{module}"' in sources()["dpstack/api/control/handlers.py"]
    assert '_KNOWN: Final = "dpstack.' in sources()["dpstack/api/control/handlers.py"]
    by_need = re.findall(r"_by_need\((\S+), (\S+), bus", sources()["dpstack/api/control/handlers.py"])
    assert by_need
    assert all(re.fullmatch(r'"\w+"', word) for words in by_need for word in words)
    assert '_WHY: Final = ("dpstack.' in sources()["dpstack/cli/terminal/causes.py"]


def test_children_take_no_modules_of_the_working_directory() -> None:
    """Each program that is started with this interpreter gets -P, which keeps the working directory out of sys.path."""
    started = re.compile(r"[\[(]\s*sys\.executable,\s*(?:#[^\n]*\s*)?(\S+)")
    found = {name: words for name, text in sources().items() if (words := started.findall(text))}
    assert len(found) == 6
    assert found.pop("dpstack/wireshark/extcap.py") == ["*program],"]
    assert 'program = ["-P", ' in sources()["dpstack/wireshark/extcap.py"]
    assert {word for words in found.values() for word in words} == {'"-P",', '*("-P",'}


def test_matplotlib_reads_no_settings_of_the_working_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """matplotlib reads ``matplotlibrc`` where it is imported: it can start latex, and load a module as a backend."""
    package = tmp_path / "matplotlib"
    package.mkdir()
    package.joinpath("__init__.py").write_text("import os\nimported_in = os.getcwd()\n")
    package.joinpath("dates.py").write_text("")
    for name in [one for one in sys.modules if one.partition(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.syspath_prepend(str(tmp_path))
    work = tmp_path / "recordings"
    work.mkdir()
    monkeypatch.chdir(work)
    made = SimpleNamespace(**vars(plot._matplotlib()))
    for name in ("matplotlib", "matplotlib.dates"):
        monkeypatch.delitem(sys.modules, name)
    assert Path(made.imported_in) == Path(plot.__file__).parent
    assert Path.cwd() == work
