"""Events of people and scenarios that act on simulated slaves."""

from __future__ import annotations

from typing import Final

from dpstack.trace import Event

#: source of the notices about exceptions in simulated devices
SIMULATION: Final = "simulation"


class Injected(Event):
    """A command of ``dpstack ctl`` to a simulated slave or to the segment."""

    #: the command
    command: str
    #: its arguments as typed
    args: tuple[str, ...]
    #: station address of the slave; None for the segment
    address: int | None = None
    #: name of the slave; None for the segment
    name: str | None = None

    def _text(self) -> str:
        args = self.args if self.address is None else self.args[1:]
        who = "the segment" if self.address is None else f"slave {self.address} ({self.name})"
        return f"{who}: {' '.join((self.command, *args))} (dpstack ctl)"

    def as_dict(self, t: float) -> dict[str, object]:
        """The JSON line of the event at ``t`` seconds."""
        line: dict[str, object] = {"event": "injected", "t": round(t, 6)}
        if self.address is not None:
            line |= {"address": self.address, "name": self.name}
        return {**line, "command": self.command, "args": list(self.args), "text": self.text}


class ScenarioEvent(Event):
    """A step of a scenario. ``step``: its number in the file, from 1; 0: the scenario itself, without a slave.

    ``state``: "begin", "end", "failed" (``detail`` says why), "again" (the scenario begins anew), "over". ``do``: the
    kind of the step; ``lasts_s``: seconds until its end, None without one.
    """

    step: int
    state: str
    #: the step in words
    detail: str
    do: str | None = None
    #: station address of the slave; None: of no slave
    address: int | None = None
    #: name of the slave; None: of no slave
    name: str | None = None
    lasts_s: float | None = None

    def _text(self) -> str:
        if not self.step:
            return f"scenario: {self.detail}"
        word = {"end": "over: ", "failed": "failed: "}.get(self.state, "")
        lasts = f" for {self.lasts_s:g} s" if self.state == "begin" and self.lasts_s is not None else ""
        return f"scenario step {self.step}, slave {self.address} ({self.name}): {word}{self.detail}{lasts}"

    def as_dict(self, t: float) -> dict[str, object]:
        """The JSON line of the event at ``t`` seconds."""
        line: dict[str, object] = {"event": "scenario", "t": round(t, 6), "step": self.step, "state": self.state}
        if self.address is not None:
            line |= {"address": self.address, "name": self.name, "do": self.do, "for": self.lasts_s}
        return {**line, "text": self.text}
