"""The pages of the drives cannot rot: every section of docs/drives is shown by tests of both ends, with literal octets.

A section is a row here, by its second anchor (``<a id="d10">``).
A test names its rows in its own name (``test_d7_...``, ``test_k9_k12_...``). Which end it shows is read from its
source, with whatever of its module and of the kits it uses: the plugin is made by ``PluginBench`` or ``core()``, the
simulated drive by ``DeviceBench`` or ``device()``. A test of both against each other shows neither: they share a table
and would be wrong together.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Final

import pytest

TESTS: Final = Path(__file__).parent.parent
_PAGES: Final = Path(__file__).resolve().parents[2] / "docs" / "reference" / "drives"
ROWS: Final = tuple(
    name.upper()
    for page in sorted(_PAGES.glob("*.md"))
    for name in re.findall(r'<a id="([dkilf]\d+)"></a>', page.read_text(encoding="utf-8"))
)
PLUGIN, DRIVE = "plugin", "simulated drive"
#: names in the source that make one end; those of PAIR make both and have them talk to each other
MAKES: Final = {"PluginBench": PLUGIN, "core": PLUGIN, "DeviceBench": DRIVE, "device": DRIVE}
PAIR: Final = "PairBench"
#: rows that have one end only, and why
ONE_END: Final = {
    ("D22", PLUGIN): "SYNC is an order of the bus to a group of slaves, plugins know nothing of it",
    ("L10", PLUGIN): "I&M is a matter of program and slave, plugins know nothing of it",
    ("K1", PLUGIN): "the services are those of the bus's slave handler, which every drive has",
}
_NAMED: Final = re.compile(r"test_((?:[dkilf]\d+_)+)")
_OCTETS: Final = re.compile(r"\b[0-9A-Fa-f]{2}(?: [0-9A-Fa-f]{2})+\b")


def kit_file(module: str) -> Path:
    """A kit is in ``tests/kits``, or beside these tests."""
    beside = module.removeprefix("tests.drives.")
    return (TESTS / "kits" / f"{module}.py") if beside == module else Path(__file__).parent / f"{beside}.py"


@cache
def definitions(path: Path) -> dict[str, ast.AST]:
    """The definitions at the top of a module, and those that it imports from kits, by name."""
    found: dict[str, ast.AST] = {}
    for node in ast.parse(path.read_text()).body:
        match node:
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
                found[name] = node
            case ast.Assign(targets=[ast.Name(id=name)]) | ast.AnnAssign(target=ast.Name(id=name)):
                found[name] = node
            case ast.ImportFrom(module=str(module), names=names) if (path_of_kit := kit_file(module)).exists():
                kit = definitions(path_of_kit)
                found |= {(one.asname or one.name): kit[one.name] for one in names if one.name in kit}
    return found


def fixtures(known: dict[str, ast.AST]) -> set[str]:
    """They are used by those that ask for them as an argument; a variable may have the same name."""
    made = {name: node for name, node in known.items() if isinstance(node, ast.FunctionDef)}
    return {name for name, node in made.items() if "pytest.fixture" in map(ast.unparse, node.decorator_list)}


def used(node: ast.AST, known: dict[str, ast.AST]) -> Iterator[ast.AST]:
    """The nodes of a definition and of all that it uses; the benches themselves are names only."""
    seen: set[str] = set()
    todo = [node]
    asked = fixtures(known)
    while todo:
        for inner in ast.walk(todo.pop()):
            yield inner
            match inner:
                case ast.Name(id=name) if name not in asked:
                    pass
                case ast.arg(arg=name) if name in asked:
                    pass
                case _:
                    continue
            if name in known and name not in (*seen, *MAKES, PAIR):
                seen.add(name)
                todo.append(known[name])


def ends(test: ast.AST, known: dict[str, ast.AST]) -> set[str]:
    """The ends that a test shows against literal octets."""
    found: set[str] = set()
    octets = False
    for node in used(test, known):
        match node:
            case ast.Name(id="PairBench"):
                return set()
            case ast.Name(id="PluginBench" | "DeviceBench" as name):
                found.add(MAKES[name])
            case ast.Call(func=ast.Attribute(attr=name)) if name in MAKES:
                found.add(MAKES[name])
            case ast.Constant(value=str(text)) if _OCTETS.search(text):
                octets = True
            case ast.Constant(value=bytes()):
                octets = True
    return found if octets else set()


@cache
def shown() -> dict[tuple[str, str], list[str]]:
    """The tests of every row and end."""
    found: dict[tuple[str, str], list[str]] = {(row, end): [] for row in ROWS for end in (PLUGIN, DRIVE)}
    for path in sorted(TESTS.rglob("test_*.py")):
        if not re.search(r"def test_[dkilf]\d+_", path.read_text()):
            continue
        known = definitions(path)
        for name, node in known.items():
            if (match := _NAMED.match(name)) is None:
                continue
            for row in match[1].upper().strip("_").split("_"):
                for end in ends(node, known):
                    found.setdefault((row, end), []).append(f"{path.name}::{name}")
    return found


@pytest.mark.parametrize("end", [PLUGIN, DRIVE])
@pytest.mark.parametrize("row", ROWS)
def test_a_row_is_shown_at_both_ends(row: str, end: str) -> None:
    tests = shown()[row, end]
    if (row, end) in ONE_END:
        assert not tests, f"row {row} is shown at the {end} after all: take it out of ONE_END"
    else:
        assert tests, f"no test named test_{row.lower()}_... shows the {end} against literal octets"


def test_no_test_names_a_row_that_is_not_there() -> None:
    assert set(shown()) == {(row, end) for row in ROWS for end in (PLUGIN, DRIVE)}


#: every worked example of the manuals that has octets: what shows it at the plugin and at the simulated drive
EXAMPLES: Final[dict[str, tuple[str, str]]] = {
    "Demag 11.1.6, 400 is read": ("test_d6_read_400", "test_d6_examples"),
    "Demag 11.1.6, -300 Hz to 480 of set 3": ("test_d6_write_480_in_data_set_3", "test_d6_examples"),
    "Demag 11.2.2, 30 Hz of 60": ("test_d11_set_point_of_the_example", "test_d11_references"),
    "Demag 11.2.2, 375 = 50 and 390 = 100": (
        "test_d11_field_weakening_of_the_example",
        "test_d11_field_weakening_of_the_example",
    ),
    "Demag 11.2.5, FFFF, +30 %, -55.36 %, 30 Hz in PZD5": (
        "test_d14_the_words_of_the_plugin",
        "test_d14_the_sources_of_the_drive",
    ),
    "Demag 11.3, the lines of 281 and 284": ("test_d16_the_lines_of_the_manual_from_live_data", ""),
    "KEB, basics: oP.3 := 20 Hz": (
        "test_k4_the_confirmation_of_the_manual_is_one",
        "test_k4_the_example_of_the_manual",
    ),
    "KEB, a word as four octets": (
        "test_k3_k4_the_plugin_writes_with_four_octets_and_judges_handshake_and_result_only",
        "test_k3_any_parameter_with_four_octets",
    ),
    "KEB, map examples 1 and 2": (
        "test_k7_the_requests_of_write_map",
        "test_k7_the_enable_is_answered_by_an_error_and_the_map_acts_after_power_on",
    ),
    "KEB, 12 and 10 octets in two blocks": (
        "test_k11_k12_block_2_by_the_users_indexes_and_an_enable_that_falls_back",
        "test_k9_k12_two_blocks_take_two_telegrams_and_half_the_rate",
    ),
    "IMO 2.4, address 10": ("test_i3_the_read_of_the_manual", "test_i3_the_read_of_the_manual"),
    "IMO 2.4, PZD3 as rpm": ("test_i4_the_rpm_of_the_manual", "test_i4_the_rpm_of_the_manual"),
    "IMO 2.4, PZD3 as PID reference": ("test_i4_received", "test_i4_received_and_transmitted"),
    "LS 4.2, F000 and C000": ("test_l5_per_cent_of_dr_20", "test_l3_reverse_only_by_sign_and_l5_f000_is_15_hz"),
    "LS 5.1, 04B0 is 1200 rpm": ("test_l5_rpm", "test_l5_rpm"),
    "LS 5.2, 965, 964[1], 0h1101": ("test_l6_reads", "test_l6_l9_orders_and_replies"),
    "Fuji 7.2, the run": ("test_f3_worked_run_of_the_master", "test_f3_worked_run_of_the_drive"),
    "Fuji 7.2 (6), reverse by the sign": ("test_f3_reverse_by_the_sign", "test_f3_worked_run_of_the_drive"),
    "Fuji 8.2, F26 is 041A": ("test_f5_words_of_the_plugin", "test_f5_the_drive_takes_them_at_power_on"),
    "Fuji 8.3, examples 1 to 3": ("test_f6_the_plugin_to_the_byte", "test_f6_orders_and_replies"),
    "Fuji 8.3, the errors of them": ("test_f14_errors_by_their_text", "test_f6_orders_and_replies"),
    "Fuji 8.3, PNU 947": ("test_f6_the_plugin_to_the_byte", "test_f6_f7_f9_malfunction_history"),
}


@pytest.mark.parametrize("example", EXAMPLES)
def test_every_example_of_the_manuals_is_shown_both_ways(example: str) -> None:
    for test, end in zip(EXAMPLES[example], (PLUGIN, DRIVE), strict=True):
        if test:
            found = {one.partition("::")[2] for (_, shows), tests in shown().items() if shows == end for one in tests}
            assert test in found, f"{test} does not show the {end} against literal octets"
