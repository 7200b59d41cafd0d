"""Examples with packages of others: the notebook in a kernel of Jupyter; the sessions of docs/how-to/blocking.md in
IPython on a pty; the HTTP service by an HTTP client, Parquet files by pyarrow; types by pyright."""

from __future__ import annotations

import ast
import asyncio
import base64
import json
import os
import pty
import re
import runpy
import select
import shutil
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, Final

import pytest
from far_ends import eventually

import dpstack
from dpstack.events import MasterStopped

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


class Service:
    """The service on a free HTTP port, in a thread of its own; ``events`` of its bus."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        import uvicorn

        self.events: list[dpstack.Event] = []
        monkeypatch.setattr(dpstack, "open_bus", partial(dpstack.open_bus, on_event=self.events.append))
        app = runpy.run_path(str(EXAMPLES / "fastapi_service.py"))["service"]()
        self.server = uvicorn.Server(uvicorn.Config(app, host="127.0.0.1", port=0, log_level="warning"))
        self.thread = threading.Thread(target=self.server.run)
        self.thread.start()
        eventually(lambda: self.server.started or not self.thread.is_alive(), "the server starts")
        assert self.server.started
        self.url = f"http://127.0.0.1:{self.server.servers[0].sockets[0].getsockname()[1]}"

    def ask(self, method: str, path: str, body: object = None) -> tuple[int, Any]:
        data = None if body is None else json.dumps(body).encode()
        headers = {"Content-Type": "application/json"}
        request = urllib.request.Request(self.url + path, data, headers, method=method)
        try:
            with urllib.request.urlopen(request, timeout=60) as answer:
                return answer.status, json.load(answer)
        except urllib.error.HTTPError as error:
            return error.code, json.load(error)

    def end(self) -> None:
        self.server.should_exit = True
        self.thread.join(30)
        assert not self.thread.is_alive()


@pytest.fixture
def service(monkeypatch: pytest.MonkeyPatch) -> Iterator[Service]:
    found = Service(monkeypatch)
    yield found
    found.end()


def test_the_http_service_reads_and_orders_and_ends_its_bus(service: Service) -> None:
    exchanging = ["data_exchange"] * 3
    eventually(lambda: [one["state"] for one in service.ask("GET", "/slaves")[1]] == exchanging, "data exchange")
    assert service.ask("PUT", "/slaves/valves/outputs", {"flap": True}) == (200, {"flap": True})
    code, told = service.ask("PUT", "/slaves/valves/outputs", {"flop": True})
    assert (code, told["detail"]) == (422, "slave 8 (valves): no output is called 'flop'; did you mean flap?")
    assert service.ask("PUT", "/drives/fan/speed", {"fraction": 0.1}) == (200, {"setpoint": 0.1})
    code, status = service.ask("POST", "/drives/fan/start")
    assert (code, status["state"], status["running"]) == (200, "running", True)
    code, status = service.ask("POST", "/drives/fan/stop")
    assert (code, status["running"]) == (200, False)
    assert service.ask("POST", "/drives/fan/dance")[0] == 422
    code, told = service.ask("POST", "/drives/hoist/start")
    assert code == 409
    assert "412 is 44: control not by the bus" in told["detail"]
    (valves,) = [one for one in service.ask("GET", "/slaves")[1] if one["name"] == "valves"]
    assert valves == {
        "name": "valves",
        "address": 8,
        "state": "data_exchange",
        "inputs": {"limit": True},  # the simulated slave gives back its outputs
        "fault": None,
    }
    service.end()
    stopped = [event for event in service.events if isinstance(event, MasterStopped)]
    assert [event.cleared for event in stopped] == [True]


def test_the_parquet_logger_rotates_and_pyarrow_reads_all_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import pyarrow.parquet

    monkeypatch.setattr(asyncio, "run", dpstack.run_virtual)
    monkeypatch.setattr(sys, "argv", ["parquet_logger.py", "virtual", str(tmp_path)])
    runpy.run_path(str(EXAMPLES / "parquet_logger.py"), run_name="__main__")
    written, read = capsys.readouterr().out.splitlines()
    files = sorted(tmp_path.glob("*.parquet"))
    tables = [pyarrow.parquet.read_table(file) for file in files]
    rows = sum(table.num_rows for table in tables)
    assert len(files) > 1
    assert written == f"{rows} rows, 0 lost"
    assert read == f"{len(files)} files, {rows} rows, level 0 to 100 %"
    levels = [value for table in tables for value in table["tank.level"].to_pylist() if value is not None]
    assert {round(value) for value in levels} == set(range(101))  # each step of the ramp is in the files
    assert sorted(tmp_path.iterdir()) == files


def _run(*command: str) -> None:
    environment = {**os.environ, "PYRIGHT_PYTHON_IGNORE_WARNINGS": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]


def test_pyright_has_no_complaint_about_the_examples() -> None:
    _run(sys.executable, "-m", "pyright", "--pythonpath", sys.executable, "examples")
