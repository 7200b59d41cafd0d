"""Ports: octets in and out of one line, all kinds behind one small interface.

==========================  =====================================================================================
``/dev/...``, ``COM3``      a serial port (Linux: :mod:`~dpstack.ports.tty`, elsewhere through pyserial-asyncio)
``socket://host:port``      a serial line behind a TCP server
``rfc2217://host:port``     the same with the rate set over the network (pyserial)
``pty``                     a pty made here; its other end is a serial port for any other program
==========================  =====================================================================================

- ``adapters``: Which serial adapters there are, and what one of them can do
- ``base``: What every port offers: octets in and out of one line. No protocol and no clock; waiting is the driver's
- ``fdport``: Ports that are a file descriptor: the lean path of Linux ttys, ptys and sockets
- ``holders``: Who holds a port: by the lock dpstack and pyserial set, and by who has it open
- ``marks``: Takes the marks of damaged characters out of what a tty delivers (PARMRK), in front of the decoder
- ``memory``: Two ports joined in memory, in one event loop: for tests and for programs that are both ends themselves
- ``pacing``: Octets that take their time: delivered in slices, each when its last bit would be on the wire
- ``posix``: Modules that only POSIX systems have (``fcntl``, ``termios``, ``grp``), imported where they are
- ``pty``: ``--port pty``: a pty made here, whose other end any program may open as its serial port
- ``ptymaster``: The master end of a pty: who is at the other end, and what that end is set to
- ``pyserial``: Serial ports through pyserial-asyncio: Windows, macOS, the BSDs
- ``rfc2217``: ``rfc2217://host:port``: a serial port of another machine, its rate and parity set over the network
- ``runtime_dir``: The user's runtime directory: where sockets and links of running programs live, for this user alone
- ``sysfs``: What sysfs knows and sets of a serial adapter: driver, USB identity
- ``tcp``: ``socket://host:port``: a serial line behind a TCP server (ser2net, an Ethernet-to-serial converter)
- ``termios2``: Linux ``termios2``: raw 8E1 at any rate in one call, and what a tty is really set to
- ``timerfd``: A Linux timerfd: a deadline in nanoseconds that an event loop waits for like for a port
- ``tty``: A serial port on Linux: 8E1 raw at any rate, read back, exclusive
- ``tuning``: Makes an open serial port quick and fit for RS-485, and leaves it as it was found
- ``uart``: What a Linux serial driver can do beyond termios, by ioctl: low latency, RS-485, error counters
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
