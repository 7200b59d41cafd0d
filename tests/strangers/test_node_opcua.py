"""The OPC UA face with node-opcua from npm as client: browse, subscribe, methods, alarms, history, refusals."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any, Final

import pytest
from opcua_rig import Rig
from stranger_kit import HANGS_S, program

pytestmark = pytest.mark.strangers

VERSION: Final = "2.186.4"
CLIENT: Final = Path(__file__).with_name("node_opcua_client.js")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("npm")
    subprocess.run(
        [program("npm"), "install", "--no-audit", "--no-fund", "--silent", "--ignore-scripts",
         f"node-opcua-client@{VERSION}"],
        cwd=made,
        check=True,
        timeout=300,
    )  # fmt: skip
    shutil.copy(CLIENT, made)
    return made


async def test_a_foreign_client_browses_subscribes_calls_and_is_refused(folder: Path, tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.slow.set()
    rig.values["9"]["drive"] = rig.values["9"]["drive"] | {"faults": ["over temperature"]}
    async with rig.serving():
        client = await asyncio.create_subprocess_exec(
            "node", CLIENT.name, f"opc.tcp://127.0.0.1:{rig.face.port}",
            cwd=folder,
            env=os.environ | {"HOME": str(tmp_path), "XDG_CONFIG_HOME": str(tmp_path)},
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
        )  # fmt: skip
        async with asyncio.timeout(HANGS_S):
            out, err = await client.communicate()
    assert client.returncode == 0, err.decode()[-2000:]
    lines = [json.loads(line) for line in out.decode().splitlines() if line.startswith("{")]
    told: dict[str, Any] = {line["step"]: line["value"] for line in lines}
    assert told.pop("endpoints") == [["http://opcfoundation.org/UA/SecurityPolicy#Basic256Sha256", 3]]
    assert {"StateMachine", "Start", "Stop", "Acknowledge", "speed"} <= set(told.pop("browse"))
    events = [line["value"] for line in lines if line["step"] == "event"]
    fault = "ns=2;s=condition/slave/9/drive/faults/over temperature"
    assert [event[0] for event in events[:3]] == ["ns=0;i=2787", "ns=0;i=10637", "ns=0;i=2788"]
    assert events[1][1:] == ["hoist", "over temperature", True, True, False, fault]
    told.pop("event")
    assert told == {
        "read": [5.5, "Double", "Good", "2023-11-14T22:13:20.099Z"],
        "changed": [5.5, "Good"],
        "refresh": "Good",
        "acknowledge": "Good",
        "again": "BadEventIdUnknown",
        "write lamp": "Good",
        "write horn": "BadNotWritable",
        "write type": "BadTypeMismatch",
        "write refused": "BadInvalidState",
        "reason": "the run refuses 4000",
        "stop": "Good",
        "coast": "BadNotExecutable",
        "speed": "Good",
        "history": ["Good", True],
        "wrong password": True,
        "anonymous": "BadUserAccessDenied",
        "without security": "refused",
    }
    assert rig.given == [("set", "8.lamp=on"), ("drive", "9", "stop"), ("drive", "9", "speed", "0.5")]
