"""Start of a bus process, if possible before its configuration is known: both programs import side by side.

The early one waits for its set-up at most :data:`WAIT_S`, then it ends. It has opened no port by then, so it may be
ended at any time. This module imports nothing of dpstack: else the imports would not be side by side.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import socket
import sys
import threading
from time import monotonic
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    import subprocess

#: signals that a terminal sends to all its processes; the application reacts to them and ends the bus process
FROM_TERMINALS: Final = (signal.SIGINT, signal.SIGHUP, signal.SIGQUIT)
#: a bus process ends when it gets no set-up in this time; the application uses none that has waited half of it
WAIT_S: Final = 20.0
#: the module that an application with a bus process has loaded: its imports are over
_CLIENT: Final = "dpstack.drivers.process.client"
#: the folder of the package dpstack, which an editable installation finds without the module path
_FOLDER: Final = os.path.abspath(__file__ + "/../../../..")
#: modules by which an installation changes each of its programs
_CUSTOM: Final = ("sitecustomize", "usercustomize")
#: rights and processors of a thread in /proc/thread-self/status
_RIGHTS: Final = ("Uid", "Gid", "Groups", "Cap", "NoNewPrivs", "Seccomp", "Cpus_allowed_list")


class Begun:
    """A bus process without a set-up. ``sock``: the application's end of its socket; ``memory``: the descriptor of the
    shared memory, still of size 0. (A plain class: a named tuple would take ten times as long to make.)"""

    def __init__(
        self, process: subprocess.Popen[bytes], sock: socket.socket, memory: int, surroundings: object
    ) -> None:
        self.process = process
        self.sock = sock
        self.memory = memory
        self.surroundings = surroundings
        self.at = monotonic()


_begun: Begun | None = None


def started(sock: int, memory: int) -> subprocess.Popen[bytes]:
    """Start the bus process with two inherited file descriptors and the module path of this process.

    It begins without the module ``site``, which would search that path again and takes as long as the interpreter;
    :func:`dpstack.drivers.process.plugins.core_at` makes up for it before plugins of others are imported.
    Signals of the terminal stay blocked until the bus process has set its handlers; Ctrl-Z stays blocked until its
    set-up says whether the application decides about it.
    """
    import subprocess  # here, as the bus process itself reads only the numbers of this module

    no_site = [] if any(name in sys.modules for name in _CUSTOM) else ["-S"]
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {*FROM_TERMINALS, signal.SIGTSTP})
    try:
        return subprocess.Popen(
            [sys.executable, "-P", *no_site, "-m", "dpstack.drivers.process", str(sock), str(memory), str(os.getpid())],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            pass_fds=(sock, memory),
            env=os.environ | {"PYTHONPATH": os.pathsep.join(map(os.path.abspath, (*sys.path, _FOLDER)))},
        )
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def begin() -> None:
    """Start a bus process for the first bus of this program, if its imports are still to come.

    Nothing is raised: if it cannot be started, the opening of the bus says why. Only in the main thread: the system
    ends the bus process together with the thread that started it.
    """
    global _begun
    main = threading.current_thread() is threading.main_thread()
    if _begun is not None or _CLIENT in sys.modules or not main or sys.platform != "linux" or not sys.executable:
        return
    with contextlib.ExitStack() as stack, contextlib.suppress(OSError):
        ours, theirs = socket.socketpair()
        stack.callback(ours.close)
        stack.callback(theirs.close)
        memory = os.memfd_create("dpstack", os.MFD_CLOEXEC)
        stack.callback(os.close, memory)
        surroundings = _surroundings()
        process = started(theirs.fileno(), memory)
        stack.pop_all()
        theirs.close()
        _begun = Begun(process, ours, memory, surroundings)
        atexit.register(drop)


def take() -> Begun | None:
    """The bus process that :func:`begin` started, if it still waits and this program is as it was then.

    The caller owns it and both descriptors.
    """
    global _begun
    begun = _begun
    if begun is None:
        return None
    try:
        same = begun.surroundings == _surroundings()
    except OSError:
        same = False
    if not same or monotonic() - begun.at > WAIT_S / 2 or begun.process.poll() is not None:
        drop()
        return None
    _begun = None
    return begun


def drop() -> None:
    """End the bus process that :func:`begin` started and nobody has taken."""
    global _begun
    begun, _begun = _begun, None
    if begun is not None:
        begun.sock.close()
        os.close(begun.memory)
        end(begun.process)


def end(process: subprocess.Popen[bytes]) -> None:
    """End a bus process that has got no set-up. In the child of a fork: only forget it, it is the parent's."""
    try:
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT)
    except ChildProcessError:
        process.returncode = 0
        return
    process.kill()
    process.wait()


def _surroundings() -> object:
    """All that a new process takes over from this one and that a program may change. Raises OSError."""
    with open("/proc/thread-self/status", encoding="utf-8", errors="replace") as file:
        rights = [line for line in file if line.startswith(_RIGHTS)]
    scheduling = os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, 0)
    return os.getpid(), os.getcwd(), dict(os.environ), list(sys.path), rights, scheduling
