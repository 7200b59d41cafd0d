"""Requests to a drive that depend on its inputs, sent in the background."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, Protocol, TypeVar

from dpstack.profile.model.jobs import CommandError, Steps
from dpstack.units import NS_PER_S

T = TypeVar("T")


class LookupCore(Protocol):
    """Master side of a drive as a lookup uses it."""

    now: int

    def spawn(self, op: str, steps: Steps[dict[str, object]]) -> None: ...
    def update(self) -> None: ...


class Lookup(Generic[T]):
    """A request to the drive, ``ask(deadline)``, sent once while ``when()`` is true.

    It is repeated after the drive was offline, and after a time-out. An answer from before that does not count.
    ``patience_ns``: from the request to its deadline.
    """

    __slots__ = ("_ask", "_asked", "_patience_ns", "_turn", "_when", "value")

    def __init__(
        self, when: Callable[[], bool], ask: Callable[[int], Steps[T]], *, patience_ns: int = NS_PER_S
    ) -> None:
        self._when = when
        self._ask = ask
        self._patience_ns = patience_ns
        self._asked = False
        self._turn = 0
        #: answer of the drive; None until it came
        self.value: T | None = None

    def reset(self) -> None:
        if self._asked:
            self._asked = False
            self._turn += 1
            self.value = None

    def watch(self, core: LookupCore) -> None:
        """After new inputs: ask if due."""
        if not self._when():
            self.reset()
        elif not self._asked:
            self._asked = True
            core.spawn("lookup", self._run(core, self._turn))

    def _run(self, core: LookupCore, turn: int) -> Steps[dict[str, object]]:
        try:
            value = yield from self._ask(core.now + self._patience_ns)
        except CommandError as error:
            if error.kind == "timeout" and turn == self._turn:
                self.reset()
            raise
        if turn == self._turn:
            self.value = value
            core.update()
        return {}


Lookups = tuple[Lookup[Any], ...]
