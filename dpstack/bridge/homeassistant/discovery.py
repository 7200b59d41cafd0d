"""``Discovery``: the discovery messages of a gateway that a broker keeps. Knows no network and no clock.

A message is retained and has no expiry: Home Assistant shows an entity as unavailable while the gateway is gone. So
each session first reads the messages that the broker has kept of the same gateway, whichever run sent them, and takes
away those that the plant does not have any more. It leaves the subscription then: the broker would send each message
back.
"""

from __future__ import annotations

import math
import string
from collections.abc import Callable, Iterable
from typing import Final, NamedTuple

from dpstack.bridge.homeassistant.entities import Entity
from dpstack.text import json_text

#: entities that are described; Home Assistant is slow with more, and so is its page
MOST_ENTITIES: Final = 2000
#: topics of earlier runs that are remembered
_MOST_FOUND: Final = 10_000
#: s without a message of an earlier run after which the broker has sent all of them
_QUIET_S: Final = 1.0
#: s between two beginnings of Home Assistant behind which all messages are sent again
_AGAIN_S: Final = 10.0
_PLAIN: Final = frozenset(string.ascii_letters + string.digits + "-")


class Message(NamedTuple):
    """A retained message; one without a payload takes the topic away."""

    topic: str
    payload: bytes


class Leave(NamedTuple):
    """Leave the subscription ``topic``."""

    topic: str


class Discovery:
    """``prefix``: the first levels of the topics of Home Assistant; ``base``: the id of the gateway; ``tell``: takes a
    remark for people; ``pause``: draws the s between "online" of Home Assistant, which all gateways get at the same
    moment, and the messages."""

    def __init__(
        self, prefix: str, base: str, *, tell: Callable[[str], object], pause: Callable[[], float] = lambda: 0.0
    ) -> None:
        self._status_topic = f"{prefix}/status"
        self._prefix = prefix
        self._node = topic_level(base)
        self._tell = tell
        self._pause = pause
        #: the entities by topic; None: not known yet
        self._wanted: dict[str, Entity] | None = None
        #: topics that the broker keeps: of earlier runs, and of this one
        self._kept: dict[str, None] = {}
        #: topics to take away, and to send
        self._gone: dict[str, None] = {}
        self._waiting: dict[str, None] = {}
        self._is_reading = False
        self._has_news = False
        self._quiet_at = math.inf
        self._is_asked = False
        self._send_all_at = math.inf
        self._sent_all_at = -math.inf

    @property
    def subscriptions(self) -> tuple[str, ...]:
        return self._status_topic, self._own_topics

    @property
    def _own_topics(self) -> str:
        return f"{self._prefix}/+/{self._node}/+/config"

    def show(self, entities: Iterable[Entity]) -> None:
        """The entities of the plant, in place of those before."""
        wanted: dict[str, Entity] = {}
        left_out = 0
        for entity in entities:
            if len(wanted) < MOST_ENTITIES:
                wanted[f"{self._prefix}/{entity.component}/{self._node}/{topic_level(entity.id)}/config"] = entity
            else:
                left_out += 1
        if left_out:
            self._tell(f"Home Assistant gets {MOST_ENTITIES} entities at most: {left_out} values have none")
        self._wanted = wanted
        if not self._is_reading:
            self._compare()

    def connected(self) -> None:
        """A session begins: the messages of earlier runs come."""
        self._kept.clear()
        self._gone.clear()
        self._waiting.clear()
        self._is_reading = self._has_news = True
        self._is_asked = False
        self._send_all_at = math.inf

    def receive(self, topic: str, payload: bytes, *, retained: bool) -> bool:
        """Take a message of the broker, whatever it holds. False: its topic is none of this class."""
        if topic == self._status_topic:
            # one that is kept is older than this session, which sends everything
            self._is_asked = self._is_asked or (payload == b"online" and not retained)
            return True
        levels = topic.removeprefix(f"{self._prefix}/").split("/")
        if len(levels) != 4 or levels[1] != self._node or levels[3] != "config":
            return False
        if self._is_reading and retained and payload and len(self._kept) < _MOST_FOUND:
            self._kept[topic] = None
            self._has_news = True
        return True

    def next(self, clock: float) -> Message | Leave | None:
        """The next step; None: nothing is to be done now."""
        if self._wanted is None:
            return None
        if self._is_reading:
            return self._read(clock)
        self._look_at_time(clock)
        if self._gone:
            topic = next(iter(self._gone))
            del self._gone[topic]
            return Message(topic, b"")
        if not self._waiting:
            return None
        topic = next(iter(self._waiting))
        del self._waiting[topic]
        self._kept[topic] = None
        return Message(topic, json_text(self._wanted[topic].config()).encode())

    def due(self, clock: float) -> float:
        """The time by ``clock`` at which :meth:`next` has a step, if nothing happens before; infinite: none."""
        if self._wanted is None:
            return math.inf
        if self._is_reading:
            return clock if self._has_news else self._quiet_at
        return clock if self._gone or self._waiting or self._is_asked else self._send_all_at

    def _read(self, clock: float) -> Leave | None:
        if self._has_news:
            self._has_news = False
            self._quiet_at = clock + _QUIET_S
        if clock < self._quiet_at:
            return None
        self._is_reading = False
        self._sent_all_at = clock
        self._compare()
        return Leave(self._own_topics)

    def _look_at_time(self, clock: float) -> None:
        if self._is_asked:
            self._is_asked = False
            self._send_all_at = max(clock + self._pause(), self._sent_all_at + _AGAIN_S)
        if clock >= self._send_all_at:
            self._send_all_at, self._sent_all_at = math.inf, clock
            self._compare()

    def _compare(self) -> None:
        """Take away the topics that nothing has any more; send all others."""
        assert self._wanted is not None
        for topic in [topic for topic in self._kept if topic not in self._wanted]:
            del self._kept[topic]
            self._gone[topic] = None
        self._waiting = dict.fromkeys(self._wanted)
        for topic in self._wanted:
            self._gone.pop(topic, None)


def topic_level(id_: str) -> str:
    """``id_`` as a level of a topic: Home Assistant permits ASCII letters, digits, ``_`` and ``-``. Different ids stay
    different: ``/`` becomes ``__``, each other octet of UTF-8 that is no letter or digit ``_`` and two hex digits."""
    return "".join(
        letter if letter in _PLAIN else "__" if letter == "/" else "".join(f"_{octet:02x}" for octet in letter.encode())
        for letter in id_
    )
