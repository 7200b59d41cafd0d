"""Events of a bus as records of ``logging``: loggers ``dpstack.bus`` and, for each slave, ``dpstack.slave.NAME``.

A record has the text of the event as its message, its severity as its level, and as the attribute ``dpstack`` the
fields of the event as ``run --json`` has them, with the port. An event whose level is disabled makes no record.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Final

from dpstack.api.bus.events_json import event_json
from dpstack.api.streams import LEVELS, ROOT, logger_below
from dpstack.dp.master.events import SlaveEvent
from dpstack.trace import Event
from dpstack.units import ns_to_s

_BUS: Final = logging.getLogger("dpstack.bus")


class EventLogging:
    """Logs the events of one bus. ``origin`` returns the machine time of its start in ns, and the name of its port."""

    def __init__(self, origin: Callable[[], tuple[int, str]]) -> None:
        self._origin = origin
        self._slaves: dict[str, logging.Logger] = {}

    def __call__(self, event: Event) -> None:
        logger = self._of_slave(event.name) if isinstance(event, SlaveEvent) else _BUS
        level = LEVELS[event.severity]
        if not logger.isEnabledFor(level):
            return
        started_ns, port = self._origin()
        fields = event_json(event, ns_to_s(event.t_ns - started_ns))
        if fields is not None:  # else the answer to an order
            fields.pop("text", None)
            logger.log(level, "%s", event.text, extra={"dpstack": {**fields, "port": port}})

    def _of_slave(self, name: str) -> logging.Logger:
        logger = self._slaves.get(name)
        if logger is None:
            logger = self._slaves[name] = logging.getLogger(slave_logger_name(name))
        return logger


def slave_logger_name(name: str) -> str:
    """The logger of the slave ``name`` of a bus."""
    return logger_below("slave", name)


def log_or_print(level: int, text: str) -> None:
    """Log ``text``; on standard error where the program has not configured logging: for what somebody must read."""
    if _is_handled(ROOT):
        ROOT.log(level, "%s", text)
    elif logging.lastResort is not None:
        logging.lastResort.handle(ROOT.makeRecord(ROOT.name, level, __file__, 0, text, (), None))


def _is_handled(logger: logging.Logger) -> bool:
    """Whether a handler that is no NullHandler gets the records of ``logger``."""
    at: logging.Logger | None = logger
    while at is not None:
        if not all(isinstance(handler, logging.NullHandler) for handler in at.handlers):
            return True
        at = at.parent if at.propagate else None
    return False
