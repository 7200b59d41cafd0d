"""The set-up of this computer by ``setup_adapter.sh``: its steps, printed or carried out as root."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from dpstack.errors import DpError, UsageError

SCRIPT: Final = Path(__file__).resolve().parent / "setup_adapter.sh"
_SHELL: Final = "/bin/sh"
_HANGS_S: Final = 60.0


def steps(environment: Mapping[str, str] = os.environ) -> list[str]:
    """The commands of the set-up, one a line as a shell takes them. Nothing is changed.

    Raises UsageError if there is no shell, or dpstack is packed into an archive.
    """
    return _lines(_call(environment, "--print"))


def carry_out(environment: Mapping[str, str] = os.environ) -> list[str]:
    """Carry the steps out. Returns them. Raises UsageError without root (and without DESTDIR), DpError for a step that
    failed."""
    if not environment.get("DESTDIR") and os.geteuid() != 0:
        raise UsageError(f"--yes needs root: {command_for_root()}")
    done = _call(environment)
    if done.returncode:
        said = [line for line in done.stderr.splitlines() if line.strip()] or [f"exit code {done.returncode}"]
        raise DpError(f"the set-up failed at {(_lines(done) or ['its first step'])[-1]}: {said[-1]}")
    return _lines(done)


def command_for_root() -> str:
    """The command line that carries the steps out."""
    return shlex.join(["sudo", *_program(), "doctor", "--fix", "--yes"])


def _program() -> list[str]:
    """The command ``dpstack`` of this interpreter; sudo and systemd know neither its PATH nor its environment."""
    command = Path(sys.executable).with_name("dpstack")
    return [str(command)] if command.exists() else [sys.executable, "-P", "-m", "dpstack"]


def _call(environment: Mapping[str, str], *options: str) -> subprocess.CompletedProcess[str]:
    if not SCRIPT.is_file() or not os.path.exists(_SHELL):
        raise UsageError(f"--fix needs {_SHELL} and the file {SCRIPT}: install dpstack with pip on Linux")
    more = {"DPSTACK": shlex.join(_program())}
    try:
        return subprocess.run(
            [_SHELL, str(SCRIPT), *options, *_user(environment)],
            env={**environment, **more},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=_HANGS_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise DpError(f"{SCRIPT}: {error}") from None


def _user(environment: Mapping[str, str]) -> list[str]:
    """The user that may use the adapters: the one that called sudo, else this one; none for root."""
    import pwd

    name = environment.get("SUDO_USER") or pwd.getpwuid(os.getuid()).pw_name
    return [] if name == "root" or name.startswith("-") else [name]


def _lines(done: subprocess.CompletedProcess[str]) -> list[str]:
    return [line.removeprefix("+ ") for line in done.stdout.splitlines() if line.startswith("+ ")]
