"""The bus process: ``python -m dpstack.drivers.process SOCKET MEMORY PARENT``; started by
:mod:`dpstack.drivers.process.early_start`, early or for :mod:`dpstack.drivers.process.channel`.

SOCKET and MEMORY are numbers of file descriptors, PARENT the process id of the application. The first message is the
:class:`~dpstack.drivers.process.messages.SetUp`. The process opens no socket of its own. When its parent is gone it
makes the ordered end.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import socket
import sys
from functools import partial
from typing import Final

from dpstack.drivers.line.select_loop import SelectLoop
from dpstack.drivers.line.shutdown import ending_signals, signal_name
from dpstack.drivers.process.bus_process import Host
from dpstack.drivers.process.early_start import FROM_TERMINALS, WAIT_S
from dpstack.drivers.process.messages import (
    Answer,
    Frames,
    News,
    Question,
    SetUp,
    error_pair,
    framed,
    order_of,
)
from dpstack.drivers.process.shared_image import SharedImage
from dpstack.drivers.realtime.gc_control import Collector
from dpstack.drivers.realtime.processors import run_on
from dpstack.drivers.realtime.rights import become_real_time
from dpstack.errors import BusError
from dpstack.ports.tty import is_pty_path
from dpstack.text import traceback_text

_PR_SET_PDEATHSIG: Final = 1
_CHUNK: Final = 65_536
#: the ordered end is tried this often in a loop that an exception ended
_TRIES: Final = 3


def main(arguments: list[str]) -> int:
    """Run one bus until its end; 0 when it was an ordered one."""
    # a terminal sends these signals to both processes; the application decides about the end of this one too
    for sig in FROM_TERMINALS:
        signal.signal(sig, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, FROM_TERMINALS)  # blocked since before the start of this process
    sock_fd, memory_fd, parent = map(int, arguments)
    loop = SelectLoop()
    hosts: list[Host] = []
    for number in set(ending_signals()) - set(FROM_TERMINALS):
        loop.add_signal_handler(number, partial(_terminated, loop, hosts, number))
    # second sign that the parent is dead; the first is the end of the socket
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:
        return 1
    sock = socket.socket(fileno=os.dup(sock_fd))  # a low number, whatever the application has open
    os.close(sock_fd)
    try:
        setup = _set_up(sock)
        if setup is None:
            return 1
        if not setup.ctrl_z:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTSTP})
        image = SharedImage(memory_fd)  # not before: an early start comes before the memory has its size
        os.close(memory_fd)
        if setup.cpus:
            run_on(setup.cpus)
        host = Host(loop, sock, image, setup)
        host.open(become_real_time(pty=is_pty_path(setup.port)))
    except Exception as error:
        with contextlib.suppress(OSError):
            sock.sendall(framed(News(answer=Answer(0, error=error_pair(error)))))
        return 1
    hosts.append(host)
    collector = Collector()
    collector.begin()
    loop.on_idle = collector.idle
    for _ in range(_TRIES):
        try:
            loop.run()
            break
        except BaseException as error:  # sys.exit() in a plugin, no memory for the loop itself
            host.end(f"the loop of the bus process was left ({type(error).__name__})")
            print(traceback_text(error), file=sys.stderr, flush=True)
    loop.close()
    return 0


def _terminated(loop: SelectLoop, hosts: list[Host], number: int) -> None:
    if hosts:
        hosts[0].end_soon(f"it was ordered to end ({signal_name(number)})")
    else:
        loop.stop()


def _set_up(sock: socket.socket) -> SetUp | None:
    """The first message; None when the parent is gone, or has no use for a bus process that was started early."""
    frames = Frames(Question)
    sock.settimeout(WAIT_S)
    while octets := _received(sock):
        for question in frames.feed(octets):
            setup = order_of(question.order)
            if isinstance(setup, SetUp):
                return setup
            raise BusError("the first message is no set-up")
    return None


def _received(sock: socket.socket) -> bytes:
    try:
        octets = sock.recv(_CHUNK)
    except TimeoutError:
        return b""
    sock.settimeout(None)
    return octets
