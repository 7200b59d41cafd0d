"""Work for which a running bus has no time, in a thread beside its loop: imports of plugins and of construct."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable
from functools import partial
from typing import Final, TypeVar

from dpstack.drivers.line.select_loop import SelectLoop
from dpstack.errors import ConfigError

T = TypeVar("T")
#: the loop gets the interpreter this long after it asks for it, or after one long call of the interpreter itself (such
#: as reading the byte code of a module); Python's own 5 ms hold a bus up
_SWITCH_S: Final = 0.000_1
#: of the thread; locked memory counts all of it
_STACK: Final = 1 << 20


def do_beside(
    loop: SelectLoop, work: Callable[[], T], done: Callable[[T | None, Exception | None], object]
) -> threading.Thread:
    """Call ``work`` in a thread, then ``done`` in ``loop`` with its result or its exception. Raises RuntimeError if the
    system has no thread left."""

    def run() -> None:
        result, failed = None, None
        try:
            _give_way()
            result = work()
        except Exception as error:
            failed = error
        except BaseException as error:  # sys.exit() in a plugin
            failed = ConfigError(f"a plugin ended its import with {type(error).__name__}")
        if not loop.is_closed():
            loop.call_soon_threadsafe(partial(done, result, failed))

    sys.setswitchinterval(_SWITCH_S)  # for good: it has no effect on one thread
    threading.stack_size(_STACK)
    thread = threading.Thread(target=run, daemon=True, name="beside the bus")
    thread.start()
    return thread


def _give_way() -> None:
    """Leave the signals to the thread of the loop, and run behind it, but before all ordinary programs: while one of
    those has the processor, this thread could hold the interpreter."""
    signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
    priority = os.sched_getparam(os.getpid()).sched_priority  # of the main thread, which runs the loop
    if priority:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(max(1, priority - 1)))
