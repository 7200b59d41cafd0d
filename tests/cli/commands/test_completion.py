"""``dpstack completion``: every command, option and choice of the parsers is in each script."""

from __future__ import annotations

import argparse
import importlib.util
import re
from collections.abc import Mapping

import pytest
from cli_kit import Cli

from dpstack.cli.commands import completion
from dpstack.cli.main import _COMMANDS, build_parser
from dpstack.cli.parser import Parser

#: of arguments whose value is neither a path, nor a port, nor one of a few words
FREE = {
    "S", "N", "A", "I", "M", "T", "X", "P", "MB", "OLD", "NEW", "ADDRESS", "NAME", "HOST:PORT", "SLAVE=HEX",
    "SECONDS", "SIZE|TIME", "EXPR", "COND", "COMMAND", "ARG", "ORDER", "MODULE:NAME", "URL", "GROUP", "GROUP/NODE",
    "GROUP/NODE|all", "WORD", "TITLE", "CHANNEL", "HEX",
}  # fmt: skip


@pytest.fixture(scope="module")
def parsers() -> list[Parser]:
    return list(completion.parsers_below(build_parser()))


@pytest.fixture(scope="module")
def scripts() -> Mapping[str, str]:
    return {shell: completion.script(shell) for shell in completion.SHELLS}


def arguments(parser: Parser) -> list[argparse.Action]:
    """Without the commands of the parser."""
    return [action for action in parser.actions() if not isinstance(action, argparse._SubParsersAction)]


def test_every_option_and_choice_of_every_command_is_in_each_script(
    parsers: list[Parser], scripts: Mapping[str, str]
) -> None:
    assert {parser.prog.partition(" ")[2] for parser in parsers} >= set(_COMMANDS)
    for parser in parsers:
        name = re.sub(r"\W", "_", f"_shtab_{parser.prog}")
        words = parser.prog.removeprefix("dpstack").strip()
        parts = {
            "bash": "\n".join(re.findall(rf"^{name}_(?:option_strings|\w+_choices)=.*", scripts["bash"], re.MULTILINE)),
            "zsh": "".join(re.findall(rf"^{name}_options=\(\n.*?^\)", scripts["zsh"], re.MULTILINE | re.DOTALL)),
            "fish": "\n".join(
                line for line in scripts["fish"].splitlines() if f"_shtab_dpstack_using {words}".strip() in line
            ),
        }
        for action in arguments(parser):
            for option in action.option_strings:
                assert re.search(rf"[( ]{option}[) ]", parts["bash"]), (parser.prog, option)
                assert re.search(rf"[{{,\")*]{option}[\[,}}]", parts["zsh"]), (parser.prog, option)
                assert (
                    f" {option.replace('--', '-l ', 1) if option[1] == '-' else f'-s {option[1:]}'} " in parts["fish"]
                )
            for choice in action.choices or ():
                assert all(re.search(rf"[( \"]{choice}[) \"]", part) for part in parts.values()), (parser.prog, choice)


def test_every_command_is_in_each_script(parsers: list[Parser], scripts: Mapping[str, str]) -> None:
    for parser in parsers[1:]:
        name = parser.prog.rpartition(" ")[2]
        assert re.search(rf"_subparsers=\([^)]*\b{name}\b", scripts["bash"])
        assert re.search(rf"^    {name}:'", scripts["zsh"], re.MULTILINE)
        assert f" -a {name} " in scripts["fish"]


def test_every_value_is_known_to_be_a_path_a_port_a_word_or_free(parsers: list[Parser]) -> None:
    unknown = {
        (parser.prog, str(action.metavar))
        for parser in parsers
        for action in arguments(parser)
        if action.nargs != 0 and not completion.completion_of(action) and action.metavar not in FREE
    }
    assert unknown == set(), "a new kind of value: add its metavar to completion.py, or to FREE"


def test_the_shell_completes_without_a_program_of_python(scripts: Mapping[str, str]) -> None:
    for shell, text in scripts.items():
        assert not re.search(r"python|\$\(dpstack|\(dpstack |`dpstack (?!run|address|ctl|segment)", text), shell
        assert all(device in text for device in ("/dev/ttyUSB*", "/dev/serial/by-id/*")), shell


def test_the_command_prints_the_script(cli: Cli, scripts: Mapping[str, str]) -> None:
    assert cli.out("completion", "bash") == scripts["bash"].removesuffix("\n") + "\n"


def test_without_shtab_one_line_says_what_to_install(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "shtab" else find(name))
    said = "dpstack: dpstack completion needs shtab: pip install 'dpstack[completion]'\n"
    assert cli("completion", "zsh", code=2) == ("", said)
