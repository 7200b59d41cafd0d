"""Kit of the blocking names: Ctrl-C in a waiting call, and what stands behind a proxy."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from far_ends import eventually


@contextlib.contextmanager
def interrupted(*, until: Callable[[], bool]) -> Iterator[None]:
    """SIGINT to this process once ``until()``: the main thread waits. The block raises KeyboardInterrupt."""

    def interrupt() -> None:
        eventually(until, "the moment of Ctrl-C")
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    try:
        yield
    except KeyboardInterrupt:
        thread.join()
    else:
        pytest.fail("no KeyboardInterrupt")


def target_of(proxy: Any) -> Any:
    """The asynchronous object behind ``proxy``."""
    return proxy._target


def waits(items: Any) -> bool:
    """Whether an iterator has begun to wait for an item."""
    return bool(items._pending)
