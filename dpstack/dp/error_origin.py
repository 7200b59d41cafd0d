"""Where in a device's own functions an exception comes from: each call of them is marked with :data:`DEVICE_CALL`."""

from __future__ import annotations

from types import TracebackType
from typing import Final

#: key in the attributes of an exception
_ORIGIN: Final = "_dpstack_origin"


class _DeviceCall:
    """Context of one call of a function that the author of a device wrote: what it raises is the device's.

    In the way of each Data_Exchange, where a context costs too much, ``except`` calls :meth:`mark`.
    """

    __slots__ = ()

    def __enter__(self) -> None:
        pass

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None:
            self.mark(error)

    def mark(self, error: BaseException) -> None:
        """The function that catches ``error`` has called the device."""
        trace = error.__traceback__
        error.__dict__[_ORIGIN] = _innermost(trace and trace.tb_next)


DEVICE_CALL: Final = _DeviceCall()


def error_text(error: BaseException) -> str:
    """Its class, and what it says where it says anything."""
    name, text = type(error).__name__, str(error)
    return f"{name}: {text}" if text else name


def failure_text(error: BaseException) -> str:
    """Of a function that serves: what it raised, and where."""
    origin = origin_of(error)
    return f"its function failed ({error_text(error)})" + (f", in {origin}" if origin else "")


def origin_of(error: BaseException) -> str:
    """Function, file and line of the device; empty where the error was raised on behalf of it: its text says it all."""
    return str(error.__dict__.get(_ORIGIN, ""))


def _innermost(trace: TracebackType | None) -> str:
    """The last call that leads to the error; what asyncio and dpstack raise there comes from whoever called them."""
    found, of_whom = "", 0
    while trace is not None:
        code, package = trace.tb_frame.f_code, str(trace.tb_frame.f_globals.get("__name__")).partition(".")[0]
        rank = {"asyncio": 0, "dpstack": 1}.get(package, 2)
        if rank >= of_whom and rank:
            file = code.co_filename.replace("\\", "/").rpartition("/")[2]
            found, of_whom = f"{code.co_name}(), {file} line {trace.tb_lineno}", rank
        trace = trace.tb_next
    return found
