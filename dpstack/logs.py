"""Records of ``logging`` as JSON lines.

::

    from dpstack.logs import JsonFormatter

    handler = logging.StreamHandler()
    handler.setFormatter(JsonFormatter())
    logging.basicConfig(level=logging.INFO, handlers=[handler])
"""

from __future__ import annotations

import logging
from typing import Final

from dpstack.text import iso_time, json_text, printable

__all__ = ["JsonFormatter"]

#: keys of each line, which fields of an event do not replace
_OWN: Final = ("time", "level", "logger", "text")


class JsonFormatter(logging.Formatter):
    """Formats any record as one JSON object: ``time`` (UTC), ``level``, ``logger`` and ``text``; of an exception its
    traceback as ``error``; of an event of a bus its fields, as in ``dpstack run --json``. Control characters are
    escaped."""

    def format(self, record: logging.LogRecord) -> str:
        line: dict[str, object] = {
            "time": iso_time(record.created),
            "level": record.levelname.lower(),
            "logger": record.name,
            "text": printable(record.getMessage()),
        }
        if record.exc_info:
            line["error"] = self.formatException(record.exc_info)
        fields = getattr(record, "dpstack", {})
        return json_text(line | {key: value for key, value in fields.items() if key not in _OWN})
