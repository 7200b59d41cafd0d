"""The status of a segment as one retained JSON message: made by its gateway, read by ``dpstack fleet``.

docs/reference/segment-status.md has the schema. The caller publishes it with a message expiry of
:data:`EXPIRY_S`, so that a broker forgets the status of a gateway that is gone. Knows no network and no clock.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from dpstack.bridge.mqtt.json_payload import read_object
from dpstack.bridge.mqtt.session_file import NUMBERS
from dpstack.monitor.verdict import UNKNOWN, VERDICTS
from dpstack.plant.judge import DATA_EXCHANGE
from dpstack.plant.quality import clean
from dpstack.plant.tree import Change, Changed, PlantTree
from dpstack.plant.verdicts import Judge
from dpstack.text import json_text, printable, shortened

VERSION: Final = 1
#: s after which the broker forgets a status, and between two of them
EXPIRY_S: Final = 30
RENEW_S: Final = 10.0
#: s between two changes, and between two looks at the verdict, which also changes with the time
_CHANGE_S: Final = 1.0
#: octets of a status
MOST_OCTETS: Final = 32_768
#: lost slaves and reasons that are named, and the characters of each text
MOST_LOST: Final = 24
MOST_REASONS: Final = 8
_MOST_NAME: Final = 60
_MOST_TEXT: Final = 120
_MOST_VERSION: Final = 40

#: states of a bus; the last one: a fault has ended it
RUNNING: Final = "running"
ENDED: Final = "ended"
FAILED: Final = "failed"


def topic_of(group: str, node: str) -> str:
    """The topic of the status of a gateway."""
    return f"dpstack/{group}/{node}/status"


@dataclass(frozen=True, slots=True)
class LostSlave:
    """A slave that is lost at the moment of the status (:meth:`dpstack.plant.verdicts.Judge.lost`)."""

    address: int
    name: str
    state: str


@dataclass(frozen=True, slots=True)
class Status:
    """The status of a segment, bounded and printable. ``more_lost``: lost slaves beyond :attr:`lost`. ``session``: the
    bdSeq of the Sparkplug session. ``sent``: by the clock of the gateway, in s since 1970, which may be wrong."""

    state: str
    verdict: str
    reasons: tuple[str, ...]
    slaves: int
    lost: tuple[LostSlave, ...]
    more_lost: int
    versions: Mapping[str, str]
    session: int
    sent: float

    @property
    def lost_count(self) -> int:
        return len(self.lost) + self.more_lost


def content_of(tree: PlantTree, judge: Judge) -> dict[str, Any]:
    """The verdict of ``judge`` on a segment, and its slaves that are lost at this moment, as the status has them."""
    slaves = tree.slaves
    verdict, reasons = judge.judge()[0]
    lost = judge.lost()
    return {
        "state": FAILED if tree.has_failed else ENDED if tree.has_ended else RUNNING,
        "verdict": verdict,
        "reasons": _first_ones(reasons),
        "slaves": len(slaves),
        "lost": [_lost_one(tree, address, slaves[address].name) for address in lost[:MOST_LOST]],
        "more_lost": max(0, len(lost) - MOST_LOST),
    }


def _first_ones(reasons: Sequence[str]) -> list[str]:
    """The worst reasons; if there are more, the last one is their number."""
    found = [_short(one, _MOST_TEXT) for one in reasons[:MOST_REASONS]]
    if len(reasons) > MOST_REASONS:
        found[-1] = f"and {len(reasons) - MOST_REASONS + 1} more"
    return found


def _lost_one(tree: PlantTree, address: int, name: str) -> dict[str, Any]:
    state = clean(tree.slave_values(address).state) or UNKNOWN
    # one that is in data exchange and not born has no valid inputs yet
    shown = "no valid inputs" if state == DATA_EXCHANGE else state
    return {"address": address, "name": _short(name, _MOST_NAME), "state": _short(shown, _MOST_VERSION)}


class StatusSource:
    """The status of ``tree``, when it is due: at the begin of a session, on a change, every :data:`RENEW_S`.

    ``versions``: of programs, by name. ``clock``: s by a clock that nobody sets; ``wall``: s since 1970.
    """

    def __init__(self, tree: PlantTree, versions: Mapping[str, str]) -> None:
        self._tree = tree
        self._judge = Judge(tree)
        self._versions = dict(versions)
        self._session = 0
        self._sent: dict[str, Any] | None = None
        self._sent_at = self._looked_at = -math.inf
        self._is_urgent = False

    def begin(self, session: int) -> None:
        """A connection has begun: the next status is due at once."""
        self._session, self._sent = session, None
        self._sent_at = self._looked_at = -math.inf

    def take(self, changes: Sequence[Change]) -> None:
        """Take changes of the tree. Births, deaths and conditions are shown at once, values at the next look."""
        self._judge.take(changes)
        self._is_urgent = self._is_urgent or not all(isinstance(one, Changed) for one in changes)

    def due(self, clock: float) -> float:
        """The time by ``clock`` at which :meth:`next` should be asked."""
        if self._is_urgent:
            return self._sent_at + _CHANGE_S
        return min(self._looked_at + _CHANGE_S, self._sent_at + RENEW_S)

    def next(self, clock: float, wall: float) -> bytes | None:
        """The payload that is to be published now; None: none."""
        if clock < self.due(clock):
            return None
        self._is_urgent, self._looked_at = False, clock
        content = content_of(self._tree, self._judge)
        if content == self._sent and clock < self._sent_at + RENEW_S:
            return None
        self._sent, self._sent_at = content, clock
        return self._payload(content, wall)

    def last(self, wall: float) -> bytes:
        """The payload at the end of the run: what it says does not change any more."""
        content = content_of(self._tree, self._judge)
        if content["state"] == RUNNING:
            content["state"] = ENDED
        return self._payload(content, wall)

    def _payload(self, content: Mapping[str, Any], wall: float) -> bytes:
        head = {"version": VERSION, "sent": round(wall, 3), "session": self._session, "versions": self._versions}
        return json_text(head | dict(content)).encode()


def read_status(octets: bytes) -> Status:
    """The status in a payload, whoever sent it. Keys that are not known are left out. Raises ValueError with the
    reason if it is invalid."""
    given = read_object(octets, MOST_OCTETS)
    if given.get("version") != VERSION:
        raise ValueError(f"this program knows version {VERSION} of a status")
    state, verdict = given.get("state"), given.get("verdict")
    if state not in (RUNNING, ENDED, FAILED) or verdict not in VERDICTS:
        raise ValueError("state or verdict is not one that a status has")
    lost = [_lost_slave(one) for one in _list(given, "lost")]
    versions = given.get("versions")
    if not isinstance(versions, dict):
        raise ValueError("versions is no object")
    known = {
        _short(name, _MOST_VERSION): _short(one, _MOST_VERSION)
        for name, one in tuple(versions.items())[:MOST_REASONS]
        if isinstance(one, str)
    }
    sent = given.get("sent")
    is_time = isinstance(sent, (int, float)) and not isinstance(sent, bool) and 0 <= sent < 1e12
    reasons = [_short(one, _MOST_TEXT) for one in _list(given, "reasons")[:MOST_REASONS] if isinstance(one, str)]
    return Status(
        state,
        verdict,
        tuple(reasons),
        _count(given, "slaves", 127),
        tuple(lost[:MOST_LOST]),
        _count(given, "more_lost", 127) + max(0, len(lost) - MOST_LOST),
        known,
        _count(given, "session", NUMBERS - 1),
        float(sent) if is_time and sent is not None else 0.0,
    )


def _lost_slave(given: object) -> LostSlave:
    if not isinstance(given, dict):
        raise ValueError("a lost slave is no object")
    name, state = given.get("name"), given.get("state")
    if not isinstance(name, str) or not isinstance(state, str):
        raise ValueError("a lost slave has no name or state")
    return LostSlave(_count(given, "address", 126), _short(name, _MOST_NAME), _short(state, _MOST_VERSION))


def _list(given: Mapping[str, object], key: str) -> list[Any]:
    found = given.get(key)
    if not isinstance(found, list):
        raise ValueError(f"{key} is no list")
    return found


def _count(given: Mapping[str, object], key: str, most: int) -> int:
    found = given.get(key)
    if not isinstance(found, int) or isinstance(found, bool) or not 0 <= found <= most:
        raise ValueError(f"{key} is no number from 0 to {most}")
    return found


def _short(text: str, most: int) -> str:
    return shortened(printable(text[: most + 1]), most)
