"""Ports: octets in and out of one line, all kinds behind one small interface.

==========================  =====================================================================================
``/dev/...``, ``COM3``      a serial port (Linux: :mod:`~dpstack.ports.tty`, elsewhere through pyserial-asyncio)
``socket://host:port``      a serial line behind a TCP server
``rfc2217://host:port``     the same with the rate set over the network (pyserial)
``pty``                     a pty made here; its other end is a serial port for any other program
==========================  =====================================================================================
"""

from __future__ import annotations

import sys

from dpstack.errors import PortError
from dpstack.ports.base import Delivery, Loop, OnData, OnLost, Pending, Port
from dpstack.ports.memory import MemoryPort, memory_pair
from dpstack.ports.posix import importing_pyserial

__all__ = [
    "Delivery",
    "Loop",
    "MemoryPort",
    "OnData",
    "OnLost",
    "Pending",
    "Port",
    "PortError",
    "memory_pair",
    "open_port",
]


def open_port(
    name: str | Port, baud: int, *, paced: bool | None = None, event_char: bool = False, rs485: bool = True
) -> Port:
    """The port ``name`` at ``baud`` bit/s: ready for ``await port.open()``, which touches it for the first time.

    ``paced`` overrides whether octets take their time on it (None: known by the kind). A port object is passed through.
    ``event_char``, ``rs485``: see :class:`dpstack.ports.tuning.Tuning`; only a Linux tty takes notice of them.
    Raises PortError for a name that can be no port.
    """
    if isinstance(name, Port):
        return name
    scheme, separator, _rest = name.partition("://")
    if separator:
        return _by_url(scheme, name, baud, paced)
    if not name:
        raise PortError("no port given: write a device (/dev/ttyUSB0), socket://host:port, rfc2217://host:port or pty")
    if sys.platform == "linux":
        from dpstack.ports import termios2  # these need modules that other systems do not have

        if name == "pty":
            from dpstack.ports.pty import PtyPort

            return PtyPort(baud, paced=bool(paced))
        if termios2.AVAILABLE:
            from dpstack.ports.tty import TtyPort

            return TtyPort(name, baud, paced=paced, event_char=event_char, rs485=rs485)
    if name == "pty":
        raise PortError("--port pty needs Linux; name a serial port, socket://host:port or rfc2217://host:port")
    with importing_pyserial(name):
        from dpstack.ports.pyserial import PySerialPort

    return PySerialPort(name, baud, paced=paced is not False)


def _by_url(scheme: str, name: str, baud: int, paced: bool | None) -> Port:
    if scheme == "socket":
        from dpstack.ports.tcp import SocketPort

        return SocketPort(name, baud, paced=bool(paced))
    if scheme == "rfc2217":
        with importing_pyserial(name):
            from dpstack.ports.rfc2217 import Rfc2217Port

        return Rfc2217Port(name, baud, paced=paced is not False)
    raise PortError(f"{name}: ports are /dev/..., socket://host:port, rfc2217://host:port, pty (not {scheme}://)")
