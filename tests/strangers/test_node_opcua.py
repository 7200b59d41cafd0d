"""The OPC UA connector with node-opcua from npm as client: browse, subscribe, methods, alarms, history, refusals."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
from pathlib import Path
from typing import Any, Final

import pytest
from opcua_rig import Rig

from dpstack.plant.orders import DriveOrder, SetOutputs
from tests.strangers.stranger_kit import HANGS_S, npm_folder

pytestmark = pytest.mark.strangers

VERSION: Final = "2.186.4"
NO_COMMUNICATION: Final = "UncertainNoCommunicationLastUsableValue"
CLIENT: Final = Path(__file__).with_name("node_opcua_client.js")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = npm_folder(tmp_path_factory.mktemp("npm"), f"node-opcua-client@{VERSION}")
    shutil.copy(CLIENT, made)
    return made


async def test_a_foreign_client_browses_subscribes_calls_and_is_refused(folder: Path, tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.slow.set()
    rig.values["9"]["drive"] = rig.values["9"]["drive"] | {"faults": ["over temperature"]}
    async with rig.serving():
        fine = rig.values["8"]
        for change in ({"fields": {"level": 6.5}}, {"state": "fault", "fault": {"text": "no answer"}}, {}):
            rig.values["8"] = fine | change
            rig.snapshot()
            await rig.connector.write_changes()
        client = await asyncio.create_subprocess_exec(
            "node", CLIENT.name, f"opc.tcp://127.0.0.1:{rig.connector.port}",
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
    assert [event[0] for event in events[:4]] == ["ns=0;i=2787", "ns=0;i=10637", "ns=0;i=10637", "ns=0;i=2788"]
    lost = ["valves", "no answer", True, False, False, "ns=2;s=condition/slave/8/fault"]
    assert [event[1:] for event in events[1:3]] == [["hoist", "over temperature", True, True, False, fault], lost]
    told.pop("event")
    # the subscription beside it got the changes, and nothing of the refresh
    assert [line["value"] for line in lines if line["step"] == "beside"] == ["seen", "mended"]
    told.pop("beside")
    assert told == {
        "read": [5.5, "Double", "Good", "2023-11-14T22:13:20.399Z"],
        "changed": [5.5, "Good"],
        "refresh": "Good",
        "acknowledge": "Good",
        "fields": [800, "ns=2;s=slave/9", "hoist: drive fault", True, True, ["Active", "Unacknowledged"]],
        "unknown event": "BadEventIdUnknown",
        "acked": ["Acknowledged", "seen", "anna"],
        "again": "BadConditionBranchAlreadyAcked",
        "confirm": "BadMethodInvalid",
        "comment": "Good",
        "refresh of another": "BadSubscriptionIdInvalid",
        "write old": "BadInvalidTimestamp",
        "lamp": False,
        "write lamp": "Good",
        "write horn": "BadNotWritable",
        "write type": "BadTypeMismatch",
        "write refused": "BadInvalidState",
        "reason": "the run refuses 4000",
        "stop": "Good",
        "coast": "BadNotExecutable",
        "speed": "Good",
        "history": [
            "Good",
            [
                [None, "BadBoundNotFound"],
                [5.5, "Good"],
                [6.5, "Good"],
                [6.5, NO_COMMUNICATION],
                [5.5, "Good"],
                [None, "BadBoundNotFound"],
            ],
        ],
        "pages": [["BadBoundNotFound", "Good"], ["Good", NO_COMMUNICATION], ["Good", "BadBoundNotFound"]],
        "wrong password": True,
        "anonymous": "BadUserAccessDenied",
        "without security": "refused",
    }
    assert rig.given == [SetOutputs(8, {"lamp": True}), DriveOrder(9, "stop"), DriveOrder(9, "speed", 0.5)]
