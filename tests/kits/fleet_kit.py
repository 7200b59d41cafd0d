"""Statuses, births and deaths of a segment, as a gateway publishes them."""

from __future__ import annotations

import json
from typing import Any

GOOD: dict[str, Any] = {
    "version": 1, "sent": 4e9, "session": 5, "versions": {"dpstack": "0.1.0"}, "state": "running", "verdict": "good",
    "reasons": [], "slaves": 3, "lost": [], "more_lost": 0,
}  # fmt: skip
LOST = {"verdict": "critical", "lost": [{"address": 8, "name": "valves", "state": "offline"}]}
TOPIC = "dpstack/hall 3/line 7/status"
ONLINE = "dpstack/hall 3/line 7/online"
DEATH, BIRTH = "spBv1.0/hall 3/NDEATH/line 7", "spBv1.0/hall 3/NBIRTH/line 7"


def status(**changes: Any) -> bytes:
    return json.dumps(GOOD | changes).encode()
