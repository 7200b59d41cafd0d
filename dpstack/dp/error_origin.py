"""The origin of an exception in the functions of a device or of a drive plugin. :data:`DEVICE_CALL` marks each call of
a device."""

from __future__ import annotations

from types import TracebackType
from typing import Final

#: key in the attributes of an exception
_ORIGIN: Final = "_dpstack_origin"


class _DeviceCall:
    """Context of one call of a function that the author of a device wrote; marks the exceptions that it raises.

    For Data_Exchange a context costs too much: there ``except`` calls :meth:`mark`.
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
        error.__dict__[_ORIGIN] = innermost_call(trace and trace.tb_next)


DEVICE_CALL: Final = _DeviceCall()


def error_text(error: BaseException) -> str:
    """The class of the exception and its message, if it has one."""
    name, text = type(error).__name__, str(error)
    return f"{name}: {text}" if text else name


def failure_text(error: BaseException) -> str:
    """The text for a failed function of a device: the exception and its origin."""
    origin = origin_of(error)
    return f"its function failed ({error_text(error)})" + (f", in {origin}" if origin else "")


def origin_of(error: BaseException) -> str:
    """Function, file and line in the device; empty if the stack raised the error itself, with a text of its own."""
    return str(error.__dict__.get(_ORIGIN, ""))


def innermost_call(trace: TracebackType | None) -> str:
    """Function, file and line of the innermost call outside asyncio and dpstack; within dpstack only if there is no
    other."""
    found, of_whom = "", 0
    while trace is not None:
        code, package = trace.tb_frame.f_code, str(trace.tb_frame.f_globals.get("__name__")).partition(".")[0]
        rank = {"asyncio": 0, "dpstack": 1}.get(package, 2)
        if rank >= of_whom and rank:
            file = code.co_filename.replace("\\", "/").rpartition("/")[2]
            found, of_whom = f"{code.co_name}(), {file} line {trace.tb_lineno}", rank
        trace = trace.tb_next
    return found
