"""The import direction of the design, held by walking every import statement."""

from __future__ import annotations

import ast
import collections
import functools
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tools import draw_pictures, make_pictures
from tools.syntax import import_statements

ROOT = Path(__file__).resolve().parent.parent
PURE_BASE = {"units", "errors", "trace", "text"}
PARAMS = PURE_BASE | {"params"}
PHY = PARAMS | {"phy"}
# the machine contract (Line up and down, pump) and the histogram stand below everything that runs in a machine
FDL = PHY | {"fdl", "machine", "stats"}
DP = FDL | {"dp", "dpv1", "gsd", "argcheck", "report_once"}

#: The packages of ours that each package may import, besides itself.
MAY: dict[str, set[str]] = {
    "units": set(),
    "errors": {"text"},
    "trace": {"text", "units"},
    "text": set(),
    "namespaces": set(),
    "argcheck": PURE_BASE,
    "report_once": set(),
    "stats": {"units"},
    "params": {"units", "errors"},
    "machine": {"units", "trace"},
    "boottime": {"units"},
    "entry_points": set(),
    "late_imports": set(),
    "phy": PARAMS,
    "fdl": PHY | {"machine", "stats", "namespaces"},
    "gsd": PARAMS | {"namespaces"},
    "toml": {"errors", "text", "gsd"},
    "importers": DP | {"toml"},
    "devices": DP | {"toml", "pa", "profile", "namespaces", "entry_points"},
    "tcp_address": {"errors"},
    "plant": {"dp", "monitor"} | PURE_BASE,
    "capture": PHY | {"fdl", "machine"},
    "decode": DP | {"capture", "namespaces", "ppi"},
    "monitor": DP | {"capture", "decode"},
    "dp": DP,
    "dpv1": DP,
    "record": PURE_BASE | {"dp", "plant"},
    "profile": {"dp", "dpv1", "units", "errors", "text", "namespaces", "entry_points"},
    "pa": {"dp", "dpv1", "params"} | PURE_BASE,
    "ppi": PURE_BASE | {"fdl", "namespaces"},
    "why": DP,
    "hart": {"dp", "dpv1", "units", "errors", "text"},
    "sim": DP | {"machine", "decode", "hart", "pa"},
    "ports": PURE_BASE | {"phy"},
    "drivers": DP | {"ports", "machine", "sim", "boottime", "late_imports"},
    "api": DP
    | {
        "drivers",
        "ports",
        "sim",
        "hart",
        "profile",
        "devices",
        "importers",
        "pa",
        "ppi",
        "toml",
        "capture",
        "decode",
        "monitor",
        "record",
        "plant",
        "tcp_address",
        "why",
        "bridge",
    },
    "blocking": {"api", "errors"},
    "wireshark": {"api", "capture"} | PURE_BASE,
    "service": PURE_BASE,
    "logs": {"text"},
    "web": {"api", "plant", "ports", "record", "tcp_address"} | PURE_BASE,
    "screen": {"api", "plant", "ports", "why"} | PURE_BASE,
    "bridge": {"boottime", "monitor", "plant", "record", "tcp_address"} | PURE_BASE,
    "cli": {
        "api",
        "boottime",
        "ppi",
        "bridge",
        "capture",
        "decode",
        "importers",
        "late_imports",
        "monitor",
        "plant",
        "why",
        "record",
        "screen",
        "service",
        "tcp_address",
        "testing",
        "web",
        "wireshark",
        "gsd",
        "profile",
        "devices",
        "toml",
        "trace",
    }
    | PURE_BASE,
    # public namespaces
    "__init__": {
        "api",
        "errors",
        "fdl",
        "ppi",
        "profile",
        "dp",
        "dpv1",
        "trace",
        "namespaces",
        "events",
        "slave",
        "gsd",
        "decode",
        "blocking",
        "testing",
        "why",
        "drivers",
        "params",
    },
    "events": {"api", "dp", "dpv1", "drivers", "fdl", "trace"},
    "slave": {"api", "dp", "dpv1", "errors"},
    "testing": {
        "api",
        "decode",
        "devices",
        "dp",
        "drivers",
        "fdl",
        "gsd",
        "namespaces",
        "params",
        "profile",
        "sim",
        "toml",
    }
    | PURE_BASE,
    "__main__": {"cli"},
}
#: Rooms from the ground up: each imports from lower floors only; rooms of one floor not from one another.
FLOORS: tuple[tuple[str, ...], ...] = (
    ("service",),
    ("phy",),
    ("gsd",),
    ("toml",),
    ("fdl",),
    ("ppi",),
    ("capture",),
    ("capture/waveforms",),
    ("fdl/services",),
    ("fdl/active", "fdl/passive"),
    ("dp/pdu",),
    ("pa",),
    ("dpv1/pdu",),
    ("dp", "dpv1"),
    ("importers",),
    ("dp/slave",),
    ("dpv1/slave",),
    ("pa/simulated",),
    ("decode",),
    ("monitor",),
    ("plant",),
    ("record",),
    ("bridge",),
    ("bridge/homeassistant",),
    ("bridge/mqtt", "bridge/metrics", "bridge/opcua", "bridge/epics"),
    ("dp/master",),
    ("dp/acyclic",),
    ("dp/plan",),
    ("why",),
    ("dpv1/master",),
    ("profile/model",),
    ("profile/channel",),
    ("profile/record47",),
    ("profile/simulator",),
    ("profile/master",),
    ("profile",),
    ("devices",),
    ("devices/pa",),
    ("hart",),
    ("sim",),
    ("sim/io_station",),
    ("ports",),
    ("drivers",),
    ("drivers/realtime",),
    ("drivers/line",),
    ("drivers/virtual",),
    ("drivers/segment",),
    ("drivers/process",),
    ("api",),
    ("api/config",),
    ("api/lists",),
    ("api/pa",),
    ("api/slave_side",),
    ("api/slave",),
    ("api/recording",),
    ("api/fdl",),
    ("api/ppi",),
    ("api/bus",),
    ("api/fdl_station",),
    ("api/commissioning",),
    ("api/control",),
    ("api/listen",),
    ("api/connectors",),
    ("blocking", "screen", "wireshark", "web", "testing"),
    ("cli/terminal",),
    ("cli",),
    ("cli/commands", "cli/devices", "cli/listening"),
    ("cli/looking", "cli/link"),
    ("cli/assistants",),
)
#: profile sees only these modules of dp: its public slave application and image types, and records.
PROFILE_MAY_OF_DP = {
    "dp.counter",
    "dp.process_image",
    "dp.slave_params",
    "dp.pdu.alarm_blocks",
    "dp.pdu.diagnosis",
    "dp.slave.application",
    "dp.slave.device",
}
#: From sim and dp down.
PURE = PURE_BASE | {
    "argcheck",
    "report_once",
    "stats",
    "params",
    "machine",
    "phy",
    "fdl",
    "gsd",
    "dp",
    "dpv1",
    "sim",
    "hart",
    "profile",
    "why",
}
FORBIDDEN_IN_PURE = {
    "asyncio",
    "time",
    "os",
    "logging",
    "socket",
    "threading",
    "select",
    "selectors",
    "signal",
    "subprocess",
    "multiprocessing",
    "serial",
    "serial_asyncio",
    "termios",
}
NEVER_IN_PRODUCT = {"pyprofibus"}


def test_the_bus_process_starts_without_asyncio() -> None:
    heavy = "{'asyncio', 'dpstack.api', 'dpstack.profile'}"
    program = f"import sys, dpstack.drivers.process.program; print(*{heavy} & {{*sys.modules}})"
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert told.stdout.split() == []


def modules(under: Path) -> list[Path]:
    return sorted(path for path in under.rglob("*.py") if "__pycache__" not in path.parts)


def names_used(path: Path) -> set[str]:
    """The names and attributes that ``path`` uses."""
    nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"), str(path))))
    names = {node.id for node in nodes if isinstance(node, ast.Name)}
    return names | {node.attr for node in nodes if isinstance(node, ast.Attribute)}


def imports(path: Path) -> Iterator[tuple[int, str, str]]:
    """Line, module and target of every import of ``path``; the target of ``from package import module`` is that module,
    else the target is the module."""
    for node in import_statements(path):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name, alias.name) for alias in node.names)
        else:
            assert node.level == 0, f"{path}:{node.lineno}: relative import; write the whole name"
            module = node.module or ""
            for alias in node.names:
                dotted = f"{module}.{alias.name}"
                yield node.lineno, module, dotted if exists(dotted) else module


def package_of(path: Path) -> str:
    return path.relative_to(ROOT / "dpstack").with_suffix("").parts[0]


@functools.cache
def exists(dotted: str) -> bool:
    base = ROOT.joinpath(*dotted.split("."))
    return base.with_suffix(".py").exists() or base.is_dir()


def wrong_imports(path: Path) -> Iterator[str]:
    own = package_of(path)
    assert own in MAY, f"{own} is no package of the design: add it to the table"
    for line, _, name in imports(path):
        parts = name.split(".")
        if parts[0] == "dpstack_drives":
            yield f"{path}:{line}: {name}; drives are found by entry point, never imported"
        if parts[0] != "dpstack" or len(parts) < 2 or not exists(name):
            continue
        target = parts[1]
        if target != own and target not in MAY[own]:
            yield f"{path}:{line}: {own} may not import {name}"
        if own == "profile" and target == "dp" and name.removeprefix("dpstack.") not in PROFILE_MAY_OF_DP:
            yield f"{path}:{line}: profile may not import {name}"


def test_direction() -> None:
    wrong = [text for path in modules(ROOT / "dpstack") for text in wrong_imports(path)]
    assert not wrong, "\n".join(wrong)


def room_of(dotted: str) -> str:
    """The folder of a module; a package is in its own."""
    path = ROOT.joinpath(*dotted.split("."))
    return (path if path.is_dir() else path.parent).relative_to(ROOT / "dpstack").as_posix()


def modules_named(path: Path) -> set[str]:
    """The modules of ours that ``path`` imports."""
    return {target for _, _, target in imports(path) if target.split(".")[0] == "dpstack"}


def test_rooms_import_downwards() -> None:
    floor = {room: number for number, rooms in enumerate(FLOORS) for room in rooms}
    upwards: dict[str, set[str]] = {}
    for path in modules(ROOT / "dpstack"):
        own = path.parent.relative_to(ROOT / "dpstack").as_posix()
        for name in modules_named(path):
            room = room_of(name)
            if "." not in (own, room) and own != room and floor[room] >= floor[own]:
                dotted = ".".join(path.relative_to(ROOT / "dpstack").with_suffix("").parts)
                upwards.setdefault(dotted, set()).add(name.removeprefix("dpstack."))
    assert upwards == {}


#: files in a room at most, with its map
ROOM = 20
#: modules of at most so many lines that at most one other module uses, and how many of them there may be
SMALL_LINES, SMALL_MODULES = 80, 15
#: who imports by a name in a string: the lazy public names, the commands, optional packages, a drive's plugin
BY_STRING = {
    "api.streams",
    "api.user_code",
    "__init__",
    "namespaces",
    "cli.parser",
    "drivers.process.plugins",
    "late_imports",
    "ports.posix",
}


def dotted_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def import_graph() -> dict[str, set[str]]:
    """The imports of each module, under TYPE_CHECKING and inside functions too."""
    return {dotted_of(path): modules_named(path) - {dotted_of(path)} for path in modules(ROOT / "dpstack")}


def test_no_import_circle() -> None:
    """No module is left after those without imports, or without users, among the rest are removed again and again."""
    graph = import_graph()
    while free := {name for name, named in graph.items() if not named & graph.keys()}:
        graph = {name: named - free for name, named in graph.items() if name not in free}
    while ends := graph.keys() - {name for named in graph.values() for name in named}:
        graph = {name: named for name, named in graph.items() if name not in ends}
    assert graph == {}


LOADERS = {"import_module", "__import__"}


def test_by_string_only_what_is_loaded_late() -> None:
    found = set()
    for path in modules(ROOT / "dpstack"):
        text = path.read_text(encoding="utf-8")
        if any(name in text for name in LOADERS) and names_used(path) & LOADERS:
            found.add(dotted_of(path).removeprefix("dpstack.") if path.parent != ROOT / "dpstack" else path.stem)
    assert found == BY_STRING


def test_rooms_are_not_too_full() -> None:
    rooms = {path.parent for path in modules(ROOT / "dpstack")}
    full = {str(room.relative_to(ROOT)): len(list(room.glob("*.py"))) for room in rooms}
    assert {room: count for room, count in full.items() if count > ROOM} == {}


def test_few_small_modules_have_one_user() -> None:
    """Commands are used by string; what is left is only read together with its user, and could stand there."""
    graph = import_graph()
    users = collections.Counter(name for named in graph.values() for name in named)
    small = [
        name
        for path in modules(ROOT / "dpstack")
        if path.name not in ("__init__.py", "__main__.py")
        and (path.parent.parent.name != "cli" or path.parent.name == "terminal")
        for name in (dotted_of(path),)
        if users[name] <= 1 and len(path.read_text(encoding="utf-8").splitlines()) <= SMALL_LINES
    ]
    assert len(small) <= SMALL_MODULES, small


@pytest.mark.parametrize("room", [room for rooms in FLOORS for room in rooms])
def test_each_room_has_a_map(room: str) -> None:
    folder = ROOT / "dpstack" / room
    text = ast.get_docstring(ast.parse((folder / "__init__.py").read_text(encoding="utf-8"))) or ""
    listed = re.findall(r"^- ``([\w/]+)``: ", text, re.MULTILINE)
    rooms = sorted(f"{path.parent.name}/" for path in folder.glob("*/__init__.py"))
    assert listed == rooms + sorted(path.stem for path in folder.glob("*.py") if path.stem != "__init__")


def test_pure() -> None:
    paths = [p for p in modules(ROOT / "dpstack") if package_of(p) in PURE] + modules(ROOT / "drives")
    found = [
        f"{path}:{n}: {name}"
        for path in paths
        for n, name, _ in imports(path)
        if name.split(".")[0] in FORBIDDEN_IN_PURE
    ]
    assert not found, "a machine owns no clock, no socket, no thread:\n" + "\n".join(found)


@pytest.mark.parametrize("path", modules(ROOT / "drives"), ids=lambda p: str(p.relative_to(ROOT)))
def test_drives_see_profile_and_devices_only(path: Path) -> None:
    for line, name, _ in imports(path):
        if name.split(".")[0] == "dpstack":
            seen = name == "dpstack.profile" or name.startswith("dpstack.devices.")
            assert seen, f"{path}:{line}: {name}; a drive imports dpstack.profile, and modules of dpstack.devices"


def test_no_gpl_in_the_product() -> None:
    paths = modules(ROOT / "dpstack") + modules(ROOT / "drives")
    assert not [
        f"{path}:{n}: {name}"
        for path in paths
        for n, name, _ in imports(path)
        if name.split(".")[0] in NEVER_IN_PRODUCT
    ]


def test_pictures_are_made_by_the_tool() -> None:
    """Here, as one of them is made of the imports."""
    text = make_pictures.ARCHITECTURE.read_text(encoding="utf-8")
    assert text == make_pictures.architecture(text), "run tools/make_pictures.py"
    assert make_pictures.STATES.read_text(encoding="utf-8") == make_pictures.states(), "run tools/make_pictures.py"
    assert make_pictures.RING.read_text(encoding="utf-8") == make_pictures.token_ring(), "run tools/make_pictures.py"


@pytest.mark.parametrize("name", make_pictures.PICTURES)
def test_the_drawn_pictures_are_those_of_the_pages(name: str) -> None:
    """The file says what it was drawn from, and has a box for each room or state and all words at the arrows."""
    source = make_pictures.PICTURES[name]()
    assert draw_pictures.source_of(name) == source, "run python -m tools.make_pictures"
    drawn = ElementTree.parse(draw_pictures.path_of(name)).iter("{http://www.w3.org/2000/svg}text")
    words = collections.Counter(" ".join("".join(text.itertext()) for text in drawn).split())
    labels = re.findall(r'\["(.*)"\]|: (.*)', source)
    ends = re.findall(r"(\w+) <?-->|--> (\w+)", source) if source.startswith("state") else []
    wanted = " ".join([*map("".join, labels), *dict.fromkeys(map("".join, ends))])
    assert words == collections.Counter(wanted.split())


def test_the_walk_finds_something() -> None:
    found = {name for path in modules(ROOT / "dpstack") for _, _, name in imports(path)}
    assert "dpstack.units" in found
