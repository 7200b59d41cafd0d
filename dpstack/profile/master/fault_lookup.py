"""What a status word only announces (a fault, a warning) and the parameter channel names."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from dpstack.profile.model.jobs import CommandError, Steps
from dpstack.units import NS_PER_S

if TYPE_CHECKING:
    from dpstack.profile.master.core import DriveCore

T = TypeVar("T")


class Lookup(Generic[T]):
    """Asked once while ``when()`` is true: ``ask(deadline)``. ``value`` is None until the drive has told.

    Asked again after the drive was away, and after a time-out; an answer never counts for what came later.
    """

    __slots__ = ("_ask", "_asked", "_turn", "_when", "value")

    def __init__(self, when: Callable[[], bool], ask: Callable[[int], Steps[T]]) -> None:
        self._when = when
        self._ask = ask
        self._asked = False
        self._turn = 0
        self.value: T | None = None

    def reset(self) -> None:
        """Nothing is known, nothing was asked."""
        if self._asked:
            self._asked = False
            self._turn += 1
            self.value = None

    def watch(self, core: DriveCore) -> None:
        """Inputs have come."""
        if not self._when():
            self.reset()
        elif not self._asked:
            self._asked = True
            core.spawn("lookup", self._run(core, self._turn))

    def _run(self, core: DriveCore, turn: int) -> Steps[dict[str, object]]:
        try:
            value = yield from self._ask(core.now + NS_PER_S)
        except CommandError as error:
            if error.kind == "timeout" and turn == self._turn:
                self.reset()
            raise
        if turn == self._turn:
            self.value = value
            core.update()
        return {}


#: all that one drive is asked
Lookups = tuple[Lookup[Any], ...]


def watch(core: DriveCore) -> None:
    """Inputs have come: what is to be asked now."""
    for one in core.lookups:
        one.watch(core)


def reset(core: DriveCore) -> None:
    """The drive left data exchange."""
    for one in core.lookups:
        one.reset()
