"""A guard between the link layer and its users: what it refuses never becomes a telegram.

The one place where a read-only bus is enforced: it stands in front of every user of a guarded station, so that no
defect further up can write. A refusal is told once for each kind of request and counted; the user hears of it as a
failure.
"""

from __future__ import annotations

from collections.abc import Callable

from dpstack.fdl.interface import Failure, LinkUser, Request
from dpstack.fdl.telegram import Telegram
from dpstack.trace import Event

#: Says why a request may not be sent, or None when it may.
Guard = Callable[[Request], str | None]
#: Takes the text of a refusal, the time, and whether it is the first of its kind.
OnRefusal = Callable[[str, int, bool], None]


class GuardedUser:
    """``user`` (a LinkUser) behind ``guard``."""

    __slots__ = ("_guard", "_on_refusal", "_told", "user")

    def __init__(self, user: LinkUser, guard: Guard, on_refusal: OnRefusal) -> None:
        self.user = user
        self._guard = guard
        self._on_refusal = on_refusal
        self._told: set[str] = set()

    def token_received(self, now: int) -> None:
        self.user.token_received(now)

    def next_request(self, now: int, high_only: bool) -> Request | None:
        """The user's, unless the guard refuses it; then it has no further turn in this hold."""
        request = self.user.next_request(now, high_only)
        if request is None:
            return None
        why = self._guard(request)
        if why is None:
            return request
        self._on_refusal(why, now, why not in self._told)
        self._told.add(why)
        self.user.result(request, Failure.REFUSED, now)
        return None

    def started(self, request: Request, at: int) -> None:
        self.user.started(request, at)

    def result(self, request: Request, outcome: Telegram | Failure, now: int) -> None:
        self.user.result(request, outcome, now)

    def command(self, command: object, now: int) -> bool:
        return self.user.command(command, now)

    def wake_at(self) -> int:
        return self.user.wake_at()

    def tick(self, now: int) -> None:
        self.user.tick(now)

    def take_events(self) -> list[Event]:
        return self.user.take_events()
