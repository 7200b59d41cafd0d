"""The machine a benchmark ran on and the versions it ran with, so that figures are not compared by mistake."""

from __future__ import annotations

import os
import platform
from importlib import metadata
from pathlib import Path
from typing import Final

#: what is measured, what it stands on, and what it is measured beside
_PACKAGES: Final = ("dpstack", "pyserial", "pyserial-asyncio", "construct", "pyprofibus", "matplotlib")
_GOVERNOR: Final = Path("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor")
RT_PERIOD: Final = Path("/proc/sys/kernel/sched_rt_period_us")
RT_RUNTIME: Final = Path("/proc/sys/kernel/sched_rt_runtime_us")


def machine() -> dict[str, object]:
    """Processor, cores, kernel, governor, load average and real-time rights at this moment; versions of packages."""
    return {
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.release()}",
        "processor": _processor(),
        "processors": os.cpu_count(),
        "usable_processors": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "governor": _text(_GOVERNOR) or "not readable",
        "load": load(),
        "realtime": realtime(),
        "versions": {name: _version(name) for name in _PACKAGES},
    }


def load() -> float | None:
    """Load average of the last minute; None where the system has none."""
    return round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None


def realtime() -> dict[str, object]:
    """Rights of this process: ``priority`` is the highest SCHED_FIFO priority (0: none); throttling by the kernel.

    ``runtime_us`` in every ``period_us`` belongs to real-time processes, -1: all of it.
    """
    return {"priority": _priority(), "runtime_us": _text(RT_RUNTIME), "period_us": _text(RT_PERIOD)}


def _priority() -> int:
    """Tried, not asked for: a container may refuse what limits and capabilities allow."""
    if not hasattr(os, "sched_setscheduler"):
        return 0
    policy, param = os.sched_getscheduler(0), os.sched_getparam(0)
    for priority in (os.sched_get_priority_max(os.SCHED_FIFO), 1):
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        except OSError:
            continue
        os.sched_setscheduler(0, policy, param)
        return priority
    return 0


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "not installed"


def _text(path: Path) -> str | None:
    try:
        return path.read_text().strip()
    except OSError:
        return None


def _processor() -> str:
    for line in (_text(Path("/proc/cpuinfo")) or "").splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.processor() or "unknown"
