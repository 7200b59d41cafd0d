"""``dpstack completion``: the completion scripts of bash, zsh and fish, made from the parsers of all commands.

shtab writes the scripts. They start no Python at TAB: commands, options and choices stand in the script, paths and
serial ports come from the shell.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from typing import Any, Final

from dpstack.cli.options import require
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.devices import finding
from dpstack.units import BAUD_RATES

SHELLS: Final = ("bash", "zsh", "fish")

#: the completion of a value: the path of a file, of a TOML file, of a folder, or a serial port; "" for none
_FILE, _TOML, _FOLDER, _PORT = "file", "toml", "folder", "port"
#: by the name of the argument in the help
_BY_METAVAR: Final[dict[object, str]] = {
    "CONFIG": _TOML,
    "CONFIG ADDRESS": _TOML,
    "FILE": _FILE,
    "FILE.cfg": _FILE,
    "FILE.html": _FILE,
    "FILE.svg": _FILE,
    "FILE|DIR": _FILE,
    "FILE|HEX|-": _FILE,
    ("CERT", "KEY"): _FILE,
    "DIR": _FOLDER,
    "WORDS [DIR]": _FOLDER,
}
#: the words of the rates besides the rates
_RATE_WORDS: Final = {"B": (), "B|auto": ("auto",), "B|all": ("all",)}

_DEVICES: Final = "/dev/ttyUSB* /dev/ttyACM* /dev/ttyAMA* /dev/ttyXRUSB* /dev/serial/by-id/*"
#: The devices that are there and the word of the simulated bus; once a "/" is typed, every path (links of `dpstack
#: segment`). The name has "_file" in it, by which shtab's script has bash show and complete its words as paths.
_PORTS: Final = {
    "bash": "_dpstack_port_files",
    "zsh": "_dpstack_port_files",
    "fish": "(_dpstack_port_files)",
    "preamble": {
        "bash": f"""\
_dpstack_port_files() {{
  local port ports="virtual"
  for port in {_DEVICES}; do
    [ -e "$port" ] && ports="$ports $port"
  done
  compgen -W "$ports" -- "$1"
  case "$1" in */*) compgen -f -- "$1" ;; esac
}}
""",
        "zsh": f"""\
_dpstack_port_files() {{
  local -a ports
  ports=(virtual {" ".join(f"{pattern}(N)" for pattern in _DEVICES.split())})
  compadd -- $ports
  if [[ "$PREFIX" == */* ]]; then _files; fi
}}
""",
        "fish": f"""\
function _dpstack_port_files
  echo virtual
  for port in {_DEVICES}
    echo $port
  end
  set -l word (commandline -ct)
  if string match -q '*/*' -- "$word"
    __fish_complete_path "$word"
  end
end
""",
    },
}


def add_to(parser: Parser) -> None:
    parser.epilog = (
        "example: dpstack completion bash > ~/.local/share/bash-completion/completions/dpstack\n"
        '         dpstack completion zsh > "${fpath[1]}/_dpstack"\n'
        "         dpstack completion fish > ~/.config/fish/completions/dpstack.fish"
    )
    parser.value("shell", None, "the shell that reads the script", choices=SHELLS)
    parser.run_by(execute, json=False)


def execute(args: argparse.Namespace) -> int:
    output.raw(script(args.shell))
    return 0


def script(shell: str) -> str:
    """The completion script for ``shell``, one of :data:`SHELLS`. Raises UsageError if shtab is not installed."""
    require("shtab", "dpstack completion", "completion")
    import shtab

    from dpstack.cli.main import build_parser

    root = build_parser()
    for parser in parsers_below(root):
        for action in parser.actions():
            _complete(action)
    return str(shtab.complete(root, shell))


def parsers_below(parser: Parser) -> Iterator[Parser]:
    """``parser`` with its arguments, and the parsers of its commands with theirs."""
    parser.load()
    yield parser
    for action in parser.actions():
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                yield from parsers_below(command)


def completion_of(action: argparse.Action) -> str | tuple[str, ...]:
    """The kind of path of a value, or the words that are offered for it; "" and () for none."""
    if action.dest == "port":
        return _PORT
    if action.choices is not None:
        return tuple(map(str, action.choices))
    if action.metavar in _RATE_WORDS and action.dest == "baud":
        return (*map(str, BAUD_RATES), *_RATE_WORDS[str(action.metavar)])
    if action.dest == "drive":
        return tuple(name for name in finding.known() if re.fullmatch(r"[\w.-]+", name))
    return _BY_METAVAR.get(action.metavar, "")


def _complete(action: Any) -> None:
    """Show shtab how to complete the value of ``action``."""
    import shtab

    if action.nargs == 0 or isinstance(action, argparse._SubParsersAction):
        return
    found = completion_of(action)
    action.metavar = None  # a ":" in it would end a field of the script for zsh
    if isinstance(found, tuple):
        action.choices = found or None
    elif found:
        # two patterns: zsh takes shtab's "(*.toml)" for a qualifier of files, and finds none
        kinds = {_FILE: shtab.FILE, _TOML: shtab.glob("*.toml", "*.TOML"), _FOLDER: shtab.DIRECTORY, _PORT: _PORTS}
        action.complete = kinds[found]
