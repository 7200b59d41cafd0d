"""Real-time rights on Linux: priority, locked memory, exact timers, a short time slice.

The bus process requests them, ``dpstack doctor`` checks them beforehand. A refusal is a notice with a remedy, no error.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import struct
import sys
from typing import Final

from msgspec import Struct

from dpstack.drivers.realtime.cpu_budget import is_real_time

#: Of SCHED_FIFO: above all ordinary processes, below the 50 of Linux's threaded interrupts: those of UART and USB
#: controller deliver the octets.
PRIORITY: Final = 45
#: In front of a pty, see :func:`become_real_time`.
NICENESS: Final = -20
#: Octets to be locked at least: the interpreter with its modules.
MEMORY: Final = 64 << 20

#: Remedy for missing rights, for people.
SET_UP: Final = "run once what `dpstack doctor --fix` says (it needs root), then log in again"

_CONTAINER: Final = "in a container: --cap-add SYS_NICE --cap-add IPC_LOCK"
_CAP_IPC_LOCK: Final = 14  # linux/capability.h
_CAP_SYS_NICE: Final = 23
_MCL_CURRENT: Final = 1  # sys/mman.h
_MCL_FUTURE: Final = 2
_PR_SET_TIMERSLACK: Final = 29  # linux/prctl.h
_STATUS: Final = "/proc/self/status"

#: The shortest time slice of an ordinary process that Linux permits, in ns; the usual one is 0.7 to 2.8 ms.
SLICE_NS: Final = 100_000
#: sched_setattr(2) by machine, 64 bits only: Python and older C libraries have no function for it
_SYS_SCHED_SETATTR: Final = {"x86_64": 314, "aarch64": 274, "riscv64": 274}
#: size, sched_policy, sched_flags, sched_nice, sched_priority, sched_runtime, sched_deadline, sched_period
_SCHED_ATTR: Final = struct.Struct("IIQiIQQQ")


class Rights(Struct, frozen=True):
    """Limits of a process: ``priority``, ``memory`` in octets, None for none. ``privileged``: they do not apply."""

    privileged: bool
    priority: int | None
    memory: int | None

    def no_priority(self) -> str:
        """Why it cannot have a real-time priority; "" when it can."""
        if self.privileged or self.priority != 0:
            return ""
        return "no real-time priority is allowed (RLIMIT_RTPRIO 0): a busy computer holds the bus up"

    def no_memory(self) -> str:
        """Why it cannot lock enough memory; "" when it can."""
        if self.privileged or self.memory is None or self.memory >= MEMORY:
            return ""
        return f"only {self.memory >> 10} KiB may be locked in memory (RLIMIT_MEMLOCK): swapping holds the bus up"


def limit(name: str) -> int | None:
    """A soft limit of this process by its name in ``resource``, None for none."""
    try:
        import resource
    except ImportError:  # a system without limits
        return None
    soft, _hard = resource.getrlimit(getattr(resource, name))
    return None if soft == resource.RLIM_INFINITY else soft


def is_privileged() -> bool:
    """Whether the limits do not apply to this process: for root, unless a container has removed the capabilities."""
    try:
        with open(_STATUS, encoding="utf-8") as file:
            (line,) = (line for line in file if line.startswith("CapEff:"))
        capabilities = int(line.split()[1], 16)
    except (OSError, ValueError):
        return hasattr(os, "geteuid") and os.geteuid() == 0
    return bool(capabilities >> _CAP_SYS_NICE & capabilities >> _CAP_IPC_LOCK & 1)


def rights() -> Rights:
    """The rights of this process. Linux only."""
    return Rights(is_privileged(), limit("RLIMIT_RTPRIO"), limit("RLIMIT_MEMLOCK"))


def become_real_time(*, pty: bool = False) -> list[str]:
    """Request all rights of a bus process. Returns the notices of the refusals. Linux only.

    ``pty``: its port is a pty, whose octets pass through an ordinary worker of the kernel. Beside a SCHED_FIFO process
    that worker was late: ten slaves at 500 kbit/s took 15.7 ms a rotation, with a niceness of -20 11.5 to 12.1 ms,
    a loop without any protocol 11.4 (``bench rotation`` on two processors).
    """
    refusals = (set_niceness() if pty else set_priority(), lock_memory(), exact_timers())
    if not is_real_time():
        shorten_slice()
    return [refusal for refusal in refusals if refusal]


def set_niceness() -> str:
    """Highest precedence among ordinary processes."""
    try:
        os.setpriority(os.PRIO_PROCESS, 0, NICENESS)
    except OSError as exc:
        return f"no niceness of {NICENESS} ({exc}): a busy computer holds the bus up; {SET_UP}; {_CONTAINER}"
    return ""


def set_priority(priority: int = PRIORITY) -> str:
    """SCHED_FIFO at ``priority``, or at the limit if lower; child processes do not inherit it."""
    mine = rights()
    if mine.no_priority():
        return f"{mine.no_priority()}; {SET_UP}; {_CONTAINER}"
    if not mine.privileged and mine.priority is not None:
        priority = min(priority, mine.priority)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except OSError as exc:
        return (
            f"no real-time priority: SCHED_FIFO {priority} is refused ({exc.strerror}) although the limits allow it; "
            f"{_CONTAINER}; where control groups have a real-time share, give this one some (cpu.rt_runtime_us)"
        )
    return ""


def lock_memory() -> str:
    """Keep present and future memory from being swapped out."""
    mine = rights()
    if mine.no_memory():
        return f"{mine.no_memory()}; {SET_UP}; {_CONTAINER}"
    # Under a limit only present memory: beyond the limit later allocations would fail.
    later = _MCL_FUTURE if mine.privileged or mine.memory is None else 0
    lib = ctypes.CDLL(None, use_errno=True)
    if lib.mlockall(_MCL_CURRENT | later):
        reason = os.strerror(ctypes.get_errno())
        return f"memory is not locked ({reason}): swapping holds the bus up; {SET_UP}; {_CONTAINER}"
    return ""


def unlocked(octets: int) -> mmap.mmap:
    """Memory that nobody is going to write: it only takes addresses, although this process has locked its memory."""
    memory = mmap.mmap(-1, octets, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    at = ctypes.addressof(ctypes.c_char.from_buffer(memory))
    if not ctypes.CDLL(None).munlock(ctypes.c_void_p(at), ctypes.c_size_t(octets)):
        memory.madvise(mmap.MADV_DONTNEED)
    return memory


def exact_timers() -> str:
    """Timer slack of this thread 1 ns instead of 50 us; it counts without real-time priority."""
    lib = ctypes.CDLL(None, use_errno=True)
    if lib.prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0):
        return f"timers stay up to 50 us late (PR_SET_TIMERSLACK: {os.strerror(ctypes.get_errno())})"
    return ""


def shorten_slice() -> bool:
    """Ask for a time slice of :data:`SLICE_NS` for this process, which is an ordinary one. False: it was not taken.

    Linux (since 6.6) lets a program that computes without end finish its slice although this process has woken up,
    whatever its niceness, unless the slice of this process is the shorter one (since 6.12; an older kernel ignores the
    request). No right is needed. Beside such a program on the same processor a wake-up waited for 47 us on average,
    with the short slice for 8 us (docs/explanation/real-time.md).
    """
    number = _SYS_SCHED_SETATTR.get(os.uname().machine)
    if number is None or sys.maxsize < 1 << 32:
        return False
    nice = os.getpriority(os.PRIO_PROCESS, 0)
    attr = _SCHED_ATTR.pack(_SCHED_ATTR.size, os.SCHED_OTHER, 0, nice, 0, SLICE_NS, 0, 0)
    return not ctypes.CDLL(None).syscall(number, 0, attr, 0)
