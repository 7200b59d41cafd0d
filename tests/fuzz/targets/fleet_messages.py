"""Messages of a broker, whatever they hold, for the view of a fleet.

The input is pieces: the first octet of each chooses the topic, the rest of the message expiry and the session of a
will, the rest is the payload, or bends a right status. Judged: nothing raises; memory is bounded; every text of the
view is printable; nothing that is old is shown as alive; right messages are shown afterwards.
"""

from __future__ import annotations

import json
from typing import Any

from dpstack.bridge.mqtt.fleet import Fleet, State
from dpstack.bridge.mqtt.payload import node_death
from dpstack.bridge.mqtt.status import FAILED, MOST_LOST, MOST_REASONS
from tests.fuzz.bent_json import bent, text_of
from tests.fuzz.frame import Cutter, Target, assert_plain

_GOOD: dict[str, Any] = {
    "version": 1, "sent": 1.5, "session": 5, "versions": {"dpstack": "0.1.0"}, "state": "running", "verdict": "good",
    "reasons": ["x"], "slaves": 3, "lost": [{"address": 8, "name": "valves", "state": "offline"}], "more_lost": 0,
}  # fmt: skip
_TOPICS = (
    "dpstack/g/n/status", "dpstack/g/m/status", "dpstack/g/\x1b/status", "spBv1.0/g/NDEATH/n", "spBv1.0/g/NBIRTH/n",
    "dpstack/g/n/m/status", "dpstack/g/k/status", "dpstack/g/n/online",
)  # fmt: skip
_MOST = 2


def run(octets: bytes) -> None:
    fleet, now = Fleet(most=_MOST), 0.0
    for piece in Cutter(octets).pieces():
        choice, payload = piece[0] if piece else 0, piece[1:]
        now += 0.5
        if choice & 0x40:
            payload = text_of(bent(_GOOD, Cutter(payload))).encode()
        expiry, session = choice & 0x38, choice >> 3 & 7
        if choice & 0x80:
            fleet.receive(_TOPICS[choice % 8], payload, now, expiry=expiry, session=session)
        else:
            fleet.receive(_TOPICS[choice % 8], payload, now, retained=bool(choice & 8), wall=now)
        _judge(fleet)
    fleet.tick(now + 31)
    assert all(one.state in (State.DEAD, State.SILENT, State.ENDED) or one.status.state == FAILED for one in fleet)
    _judge(fleet)
    fresh = Fleet()
    for at, (topic, payload) in enumerate(((_TOPICS[0], json.dumps(_GOOD).encode()), (_TOPICS[3], node_death(5, 1)))):
        for one in (fleet, fresh):
            one.receive(topic, payload, now + 40 + at)
    assert [one.state for one in fresh] == [State.DEAD]
    assert fleet.get("g", "n") is not None or len(fleet) == _MOST


def _judge(fleet: Fleet) -> None:
    assert len(fleet) <= _MOST
    assert_plain(fleet.why_broken)
    for one in fleet:
        status = one.status
        assert len(status.lost) <= MOST_LOST
        assert len(status.reasons) <= MOST_REASONS
        texts = [one.group, one.node, *status.reasons, *(slave.name + slave.state for slave in status.lost)]
        for text in (*texts, *status.versions, *status.versions.values()):
            assert_plain(text)
            assert len(text) <= 140


TARGET = Target(
    run,
    covers=("dpstack.bridge.mqtt.fleet", "dpstack.bridge.mqtt.status"),
    executions=100_000,
    max_len=300,
    words=(
        b'"version":1',
        b'"state":"ended"',
        b'"state":"failed"',
        b'"verdict":"critical"',
        b"bdSeq",
        b"[",
        b"{",
        b'"lost":',
    ),
)
