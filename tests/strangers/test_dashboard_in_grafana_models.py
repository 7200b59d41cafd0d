"""The dashboards in the models that Grafana's authors publish (grafana-foundation-sdk), each release in an environment
of its own: a key that Grafana does not know is missing from what they write."""

from __future__ import annotations

import copy
import json
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pytest
from prometheus_expressions import BOARDS

from tests.strangers.stranger_kit import environment

pytestmark = pytest.mark.strangers

#: an older Grafana and one of today
RELEASES: Final = ("1769699998!10.1.0", "1769699379!11.6.0")
READS_AND_WRITES: Final = """
import sys, json
from grafana_foundation_sdk.cog import plugins
from grafana_foundation_sdk.cog.encoder import JSONEncoder
from grafana_foundation_sdk.models.dashboard import Dashboard
plugins.register_default_plugins()
print(json.dumps([json.loads(JSONEncoder().encode(Dashboard.from_json(one))) for one in json.load(sys.stdin)]))
"""


def differences(ours: Any, theirs: Any, place: str = "") -> Iterator[str]:
    """The places of ``ours`` that ``theirs`` does not have, or has otherwise."""
    if isinstance(ours, dict) and isinstance(theirs, dict):
        for key, value in ours.items():
            yield from differences(value, theirs.get(key), f"{place}/{key}")
    elif isinstance(ours, list) and isinstance(theirs, list) and len(ours) == len(theirs):
        for number, (one, other) in enumerate(zip(ours, theirs, strict=True)):
            yield from differences(one, other, f"{place}/{number}")
    elif ours != theirs:
        yield place


@pytest.mark.parametrize("release", RELEASES)
def test_grafana_knows_every_key_of_the_dashboards(tmp_path: Path, release: str) -> None:
    python = environment(tmp_path / "grafana", f"grafana-foundation-sdk=={release}")
    wrong = copy.deepcopy(BOARDS["dpstack.dashboard.json"])
    wrong["panels"][0]["fieldConfig"]["defaults"]["unitt"] = "s"
    wrong["panels"][0]["targets"][0]["exprr"] = "up"
    wrong["panels"][0]["options"]["colourMode"] = "value"
    run = subprocess.run(
        [python, "-I", "-c", READS_AND_WRITES],
        input=json.dumps([*BOARDS.values(), wrong]), text=True, capture_output=True, timeout=60, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr[-2000:]
    *theirs, theirs_of_wrong = json.loads(run.stdout)
    assert list(differences([*BOARDS.values()], theirs)) == []
    assert set(differences(wrong, theirs_of_wrong)) == {
        "/panels/0/fieldConfig/defaults/unitt",
        "/panels/0/targets/0/exprr",
        "/panels/0/options/colourMode",
    }
