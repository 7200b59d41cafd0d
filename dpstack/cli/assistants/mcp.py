"""``dpstack mcp``: read-only tools for assistants, over the Model Context Protocol on standard input and output."""

from __future__ import annotations

import argparse
import os
import signal
from pathlib import Path

from dpstack.api.config.config import load_config
from dpstack.cli import options
from dpstack.cli.parser import Parser
from dpstack.errors import UsageError


def add_to(parser: Parser) -> None:
    parser.epilog = (
        "examples: dpstack mcp plant.toml\n"
        "          dpstack mcp plant.toml --dir recordings --dir gsd\n"
        "An assistant starts it, see docs/how-to/assistants.md. Nothing is sent to the bus, and no file is written."
    )
    parser.value(
        "config", "CONFIG", "the plant: its bus may be looked at, its folder may be read", nargs="?", type=Path
    )
    what = "a further folder whose files may be read; can be given several times"
    parser.value("--dir", "DIR", what, action="append", default=[], type=Path, dest="folders")
    parser.run_by(execute, json=False)


def execute(args: argparse.Namespace) -> int:
    """Exit code 0 when standard input ends."""
    options.require("mcp", "dpstack mcp", "mcp")
    from dpstack.api.control.socket_path import directory
    from dpstack.cli.assistants.fence import Fence
    from dpstack.cli.assistants.folders import Folders
    from dpstack.cli.assistants.server import serve
    from dpstack.cli.assistants.tools import Toolbox

    path: Path | None = args.config
    folders = Folders([*([] if path is None else [path.parent]), *args.folders])
    port = None
    if path is not None:
        if path.is_symlink():
            raise UsageError(f"{path}: is a link; name the file itself, whose folder the tools may read")
        path = path.resolve()
        port = load_config(path).port
    _find_runtime_directory()
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # it has nothing to end in order
    box = Toolbox(path, folders)
    Fence(folders, port, directory()).install()
    serve(box)
    return 0


def _find_runtime_directory() -> None:
    """Assistants start servers with few variables of the environment: without XDG_RUNTIME_DIR no run of a login session
    would be found."""
    user = os.geteuid() if hasattr(os, "geteuid") else None
    usual = f"/run/user/{user}"
    if "XDG_RUNTIME_DIR" not in os.environ and os.path.isdir(usual) and os.stat(usual).st_uid == user:
        os.environ["XDG_RUNTIME_DIR"] = usual
