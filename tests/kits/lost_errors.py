"""Errors of tasks and futures that nobody has asked for: a run of tests fails with them, at its end."""

from __future__ import annotations

import contextlib
import gc
import logging
import os
from collections.abc import Iterator


@contextlib.contextmanager
def no_lost_errors() -> Iterator[None]:
    """At the end raise AssertionError if asyncio has reported an error inside as "never retrieved".

    It reports one when its garbage is collected, which may be in any later test. There the report, which formats a
    traceback, would end an ``ast.parse`` of Python 3.11 with a SystemError: formatting calls ``ast.parse``, too.
    """
    process, lost = os.getpid(), list[str]()

    def keep(record: logging.LogRecord) -> bool:
        text = record.getMessage()
        if "never retrieved" not in text or os.getpid() != process:  # a child has an output of its own
            return True
        lost.append(text)
        return False

    logger = logging.getLogger("asyncio")
    logger.filters.insert(0, keep)  # before those of a run around this one
    try:
        yield
        gc.collect()
    finally:
        logger.removeFilter(keep)
    if lost:
        raise AssertionError("\n".join(["tests of this session left errors that nobody asked for:", *lost]))
