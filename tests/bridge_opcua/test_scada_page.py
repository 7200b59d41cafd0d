"""`dpstack run` with the configuration and the client of docs/how-to/scada.md, as a program of its own."""

from __future__ import annotations

import re
import signal
from pathlib import Path
from typing import Any

import pytest
from far_ends import free_port
from opcua_rig import ANNA, make_certificate
from programs import Starter

from dpstack.bridge.opcua.users import hash_password

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "scada.md"


def block(kind: str) -> str:
    """The first block of a kind."""
    found = re.search(rf"^```{kind}\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert found is not None
    return found[1]


async def test_a_run_serves_the_plant_of_the_page_and_ends_safely(
    start: Starter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    url = f"127.0.0.1:{free_port()}"
    (tmp_path / "plant.toml").write_text(block("toml").replace("127.0.0.1:4840", url), encoding="utf-8")
    (tmp_path / "users").write_text(f"{ANNA[0]} control {hash_password(ANNA[1])}\n", encoding="utf-8")
    (tmp_path / "users").chmod(0o600)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    program = start("run", str(tmp_path / "plant.toml"), "--json")
    program.wait_for_slaves(2)
    names: dict[str, Any] = {}
    exec(compile(block("python").replace("sleep(1)", "sleep(0.3)"), str(PAGE), "exec"), names)
    cert, key = make_certificate(tmp_path, 30)
    await names["look"](f"opc.tcp://{url}", f"Basic256Sha256,SignAndEncrypt,{cert},{key}", *ANNA)
    seen = capsys.readouterr().out
    assert "value: 0.0 Good" in seen
    assert int(seen.rpartition("history: ")[2]) >= 1
    made = tmp_path / "state" / "dpstack" / "opcua"
    assert {one.name: one.stat().st_mode & 0o077 for one in made.glob("*.pem")} == {"plant.pem": 0}
    assert program.end(signal.SIGINT) == 0
    assert {state["state"] for state in program.lines[-1]["slaves"].values()} == {"data_exchange"}
    assert program.err == ""
