"""Where in a device's own functions an exception comes from."""

from __future__ import annotations

from typing import Final

#: where exceptions are raised on behalf of the device: their text says it all
_OURS: Final = (
    "dpstack/dp/slave/application.py",
    "dpstack/dp/slave/state.py",
    "dpstack/dp/slave/services.py",
    "dpstack/dp/slave/cyclic_data.py",
    "dpstack/dpv1/slave/record_requests.py",
    "dpstack/api/server/async_device.py",
)


def error_text(error: BaseException) -> str:
    """Its class, and what it says where it says anything."""
    name, text = type(error).__name__, str(error)
    return f"{name}: {text}" if text else name


def failure_text(error: BaseException) -> str:
    """Of a function that serves: what it raised, and where."""
    origin = origin_of(error)
    return f"its function failed ({error_text(error)})" + (f", in {origin}" if origin else "")


def origin_of(error: BaseException) -> str:
    """Function, file and line; empty where it was raised on behalf of the device. What asyncio raised (a time-out)
    and an error that cannot be made so come from whoever called it."""
    trace, found = error.__traceback__, ""
    while trace is not None:
        code = trace.tb_frame.f_code
        path = code.co_filename.replace("\\", "/")
        if "/asyncio/" not in path and not path.endswith("dpstack/errors.py"):
            file = path.rpartition("/")[2]
            found = "" if path.endswith(_OURS) else f"{code.co_name}(), {file} line {trace.tb_lineno}"
        trace = trace.tb_next
    return found
