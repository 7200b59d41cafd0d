"""``PortListener``: common part of the commands that listen to a port: start, interruptions, lost octets."""

from __future__ import annotations

import argparse
from abc import ABC, abstractmethod
from time import time

from dpstack.api.listen.listening import PORT_LOSSES, ListenedLine, Listening, keep_listening
from dpstack.capture.listener import OnTransmission
from dpstack.text import iso_time
from dpstack.trace import Event
from dpstack.units import AUTO, baud_text


class PortListener(ABC):
    """Listens to the port of ``args``. Subclasses say what becomes of that which is heard."""

    def __init__(self, args: argparse.Namespace) -> None:
        self._args = args
        self._json: bool = args.json
        self._line: ListenedLine | None = None  # None: it has not begun
        self._listening: Listening | None = None  # while it is entered
        self._early: list[Event] = []  # before the start line
        self._port_damage: dict[str, int] = {}

    async def _listen(self, on_transmission: OnTransmission) -> None:
        """Listen to the port; where a program that held it ends, wait until one is there again."""
        baud = None if self._args.baud == AUTO else self._args.baud
        await keep_listening(
            lambda own: Listening(self._args.port, baud, on_transmission, self._take_event, own=own),
            self._begin,
            self._interrupt,
        )

    def _begin(self, listening: Listening) -> None:
        self._listening, line = listening, listening.line
        again, self._line = self._line is not None, line
        if again:
            self._is_back(line, f"the {line.program} on {line.port} is back")
            return
        self._started(line)
        early, self._early = self._early, []
        for event in early:
            self._on_event(event)

    def _interrupt(self, reason: str) -> None:
        self._listening = None
        self._interrupted(reason)

    def _take_event(self, event: Event) -> None:
        if self._line is None:
            self._early.append(event)
        else:
            self._on_event(event)

    def _look_at_port(self, period_s: float) -> None:
        """Tell octets that the port has lost since the last look. It counts them, and does not say where they were."""
        if self._listening is None:
            return
        before, self._port_damage = self._port_damage, self._listening.damage()
        lost = sum(self._port_damage.get(cause, 0) - before.get(cause, 0) for cause in PORT_LOSSES)
        if lost > 0:
            where = f"within the last {period_s:g} s"
            self._lost(f"this computer read the port too late: {lost} octets were lost {where}")

    @abstractmethod
    def _started(self, line: ListenedLine) -> None:
        """The first octets can come."""

    @abstractmethod
    def _interrupted(self, reason: str) -> None:
        """The program that held the port has ended."""

    @abstractmethod
    def _is_back(self, line: ListenedLine, text: str) -> None:
        """A program holds the port again."""

    @abstractmethod
    def _lost(self, text: str) -> None:
        """Octets are missing."""

    @abstractmethod
    def _on_event(self, event: Event) -> None: ...


def start_json(line: ListenedLine) -> dict[str, object]:
    """The first JSON line."""
    start = {"event": "start", "time": iso_time(time()), "port": line.port, "baud": line.baud}
    return {**start, "source": line.source, "program": line.program}


def start_text(line: ListenedLine, searched: str) -> str:
    """The first line for people; ``searched``: that the rate is not known yet."""
    through = f" through the {line.program} that holds it" if line.program else ""
    return f"listening on {line.port}{through}, {searched if line.baud is None else baud_text(line.baud)}"
