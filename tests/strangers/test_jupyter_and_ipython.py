"""The notebook of the examples in a kernel of Jupyter; the sessions of docs/how-to/blocking.md in IPython on a pty."""

from __future__ import annotations

import ast
import base64
import os
import pty
import re
import select
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pytest

pytestmark = pytest.mark.strangers

ROOT: Final = Path(__file__).resolve().parent.parent.parent
EXAMPLES: Final = ROOT / "examples"
PAGE: Final = ROOT / "docs" / "how-to" / "blocking.md"
_HANG_S: Final = 60.0
_CELL: Final = re.compile(r"^In \[(\d+)\]: (.*)\n(?:(\^C)\n(\w+)\n)?(?:Out\[\1\]: (.*)\n)?", re.MULTILINE)


@pytest.fixture(scope="module")
def outputs() -> dict[int, list[Any]]:
    """The outputs of each cell with code, by its number."""
    import nbclient
    import nbformat

    notebook = nbformat.read(EXAMPLES / "notebook.ipynb", as_version=4)
    nbformat.validate(notebook)
    folder = {"metadata": {"path": str(EXAMPLES)}}
    nbclient.NotebookClient(notebook, timeout=_HANG_S, kernel_name="python3", resources=folder).execute()
    return {number: cell.outputs for number, cell in enumerate(notebook.cells) if cell.cell_type == "code"}


def test_the_notebook_shows_a_plot_and_a_lost_slave(outputs: dict[int, list[Any]]) -> None:
    (picture,) = [output for shown in outputs.values() for output in shown if output.output_type == "display_data"]
    assert base64.b64decode(picture.data["image/png"]).startswith(b"\x89PNG")
    text = "".join(output.get("text", "") for shown in outputs.values() for output in shown)
    assert "slave 9 (tank): stopped answering during Data_Exchange" in text
    assert "<Bus virtual 93.75 kbit/s operate, 1 of 2 slaves>\nfan: running\nnot_there (" in text
    assert text.count("<Bus virtual 93.75 kbit/s operate, 2 of 2 slaves>") == 1
    values = [output.data["text/plain"] for shown in outputs.values() for output in shown if "data" in output]
    assert "<Bus virtual 93.75 kbit/s operate, 2 of 2 slaves>" in values
    assert "<FaultKind.LOST: 'lost'>" in values
    assert not [output for shown in outputs.values() for output in shown if output.output_type == "error"]


class Shell:
    """IPython with plain prompts on a pty, in the folder of the examples."""

    def __init__(self, home: Path) -> None:
        self._fd, inner = pty.openpty()
        environment = {**os.environ, "IPYTHONDIR": str(home), "TERM": "dumb"}
        command = [sys.executable, "-m", "IPython", "--simple-prompt", "--no-banner", "--colors=NoColor"]
        setsid = shutil.which("setsid")
        assert setsid is not None
        self._process = subprocess.Popen(
            [setsid, "--ctty", *command], stdin=inner, stdout=inner, stderr=inner, cwd=EXAMPLES, env=environment
        )
        os.close(inner)
        self._shown = ""
        self.number = 0
        self._prompt()

    def _prompt(self) -> str:
        """The text until the next prompt."""
        end = time.monotonic() + _HANG_S
        mark = f"\nIn [{self.number + 1}]: "
        while mark not in "\n" + self._shown:
            assert time.monotonic() < end, f"IPython hangs: {self._shown[-2000:]!r}"
            if select.select([self._fd], [], [], 1.0)[0]:
                self._shown += os.read(self._fd, 65536).decode(errors="replace").replace("\r\n", "\n")
        before, _, self._shown = ("\n" + self._shown).partition(mark)
        self.number += 1
        return before

    def type(self, line: str) -> str:
        """Enter ``line``; what the shell shows for it."""
        os.write(self._fd, f"{line}\n".encode())
        return self._prompt()

    def interrupt(self, line: str, waiting: str) -> str:
        """Enter ``line``, and press Ctrl-C when the function ``waiting`` has been called by it."""
        os.write(self._fd, f"{line}\n".encode())
        end = time.monotonic() + _HANG_S
        while waiting not in self._shown:
            assert time.monotonic() < end, f"the call does not begin: {self._shown[-2000:]!r}"
            self._shown += os.read(self._fd, 65536).decode(errors="replace").replace("\r\n", "\n")
        os.write(self._fd, b"\x03")
        return self._prompt()

    def close(self) -> str:
        """Ctrl-D and yes. Returns the text of the shell to its end."""
        os.write(self._fd, b"\x04y\n")
        assert self._process.wait(_HANG_S) == 0
        os.close(self._fd)
        return self._shown


@pytest.fixture
def shell(tmp_path: Path) -> Iterator[Shell]:
    opened = Shell(tmp_path)
    yield opened
    opened.close()


def cells(mark: str) -> list[tuple[int, str, str, str]]:
    """Number, input, exception and output of each cell of the session below ``mark``."""
    (session,) = re.findall(rf"<!-- {mark} -->\n```text\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.S)
    found = [(int(number), line, error, shown) for number, line, _, error, shown in _CELL.findall(session)]
    assert len(found) == session.count("In [")
    return found


def shown_in(output: str, number: int) -> str:
    """The value behind ``Out[number]:``, or nothing."""
    found = re.search(rf"^Out\[{number}\]: (.*)", output, re.MULTILINE)
    return found[1] if found else ""


def test_ipython_shows_what_the_session_shows(shell: Shell) -> None:
    for number, line, _, shown in cells("session"):
        ast.parse(line)
        assert shell.number == number
        output = shell.type(line)
        assert "Traceback" not in output
        assert shown_in(output, number) == shown, line


def test_ctrl_c_in_ipython_ends_the_call_and_not_the_bus(shell: Shell) -> None:
    shell.type("from dpstack import blocking; bus = blocking.open_bus('plant.toml', port='virtual')")
    shell.type("bus.open(); bus.ready(); bus.operate()")
    (first, line, error, _), (second, after, _, shown) = cells("after Ctrl-C")
    assert shell.number == first
    # the condition says when it is asked for the first time
    said = line.replace("lambda: ", "lambda: print('wait' 'ing') or ")
    assert said != line
    output = shell.interrupt(said, "waiting\n")
    assert re.search(rf"^{error}\b", output, re.MULTILINE), output
    assert shell.number == second
    assert shown_in(shell.type(after), second) == shown
