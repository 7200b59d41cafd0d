"""Examples with packages of others: the HTTP service by an HTTP client, Parquet files by pyarrow; types by pyright."""

from __future__ import annotations

import asyncio
import json
import os
import runpy
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

import dpstack
from dpstack.events import MasterStopped

pytestmark = pytest.mark.strangers

ROOT = Path(__file__).resolve().parent.parent.parent
EXAMPLES = ROOT / "examples"


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
        end = time.monotonic() + 30
        while not self.server.started:
            assert self.thread.is_alive(), "the server has ended"
            assert time.monotonic() < end, "the server does not start"
            time.sleep(0.05)
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
    end = time.monotonic() + 30
    while [slave["state"] for slave in service.ask("GET", "/slaves")[1]] != ["data_exchange"] * 3:
        assert time.monotonic() < end
        time.sleep(0.1)
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
