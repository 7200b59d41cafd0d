"""Ports: octets in and out of one line. All kinds of ports have one small interface.

==========================  =====================================================================================
``/dev/...``, ``COM3``      a serial port (Linux: :mod:`~dpstack.ports.tty`, elsewhere through pyserial-asyncio)
``socket://host:port``      a serial line behind a TCP server
``rfc2217://host:port``     the same with the rate set over the network (pyserial)
``pty``                     a pty made here; its other end is a serial port for any other program
==========================  =====================================================================================

- ``adapters``: List of the serial adapters of this computer (``dpstack ports``), and test of what one of them can do
- ``base``: Base class of all ports: octets in and out of one line, without protocol and clock
- ``fdport``: Base class of the ports that are a file descriptor: Linux ttys, ptys and sockets
- ``holders``: Finds the program that holds a port: by its lock (dpstack and pyserial set one) or by its open files in
  /proc; advice on programs that open serial ports by themselves
- ``kernel_drivers``: Serial drivers of Linux, by class: marks of damaged octets, rates, delay; what each leaves of the
  Hamming distance
- ``pacing``: Pacing: octets are delivered in slices, each at the time when its last bit would be on the wire
- ``posix``: Modules that only POSIX systems have: ``fcntl``, ``termios``, ``grp``
- ``pty``: ``--port pty``: a pty made here, whose other end any program may open as its serial port
- ``pyserial``: Serial ports through pyserial-asyncio: Windows, macOS, the BSDs, and Linux on processors without
  ``termios2``
- ``rfc2217``: ``rfc2217://host:port``: a serial port of another machine, its rate and parity set over the network
- ``runtime_dir``: The user's runtime directory for sockets and links of running programs, closed to other users
- ``sysfs``: Serial adapters in sysfs: driver, USB identity, FTDI's latency timer and event character
- ``tcp``: ``socket://host:port``: a serial line behind a TCP server (ser2net, an Ethernet-to-serial converter)
- ``termios2``: Linux ``termios2``: raw 8E1 at any rate in one call, and reading the settings back
- ``timerfd``: A Linux timerfd: a deadline on CLOCK_MONOTONIC in nanoseconds that an event loop waits for like for a
  port
- ``tty``: A serial port on Linux: 8E1 raw at any rate, read back and locked
- ``tuning``: Tuning of an open Linux serial port: low latency, RS-485 mode, error counters; restored at the end
"""

from __future__ import annotations

import sys

from dpstack.errors import PortError
from dpstack.ports.base import Delivery, Loop, Pending, Port

__all__ = ["Delivery", "Loop", "Pending", "Port", "open_port"]


def open_port(
    name: str | Port,
    baud: int,
    *,
    paced: bool | None = None,
    event_char: bool = False,
    rs485: bool = True,
    listen: bool = False,
) -> Port:
    """The port ``name`` at ``baud`` bit/s, not yet opened. A Port object is returned as it is.

    ``paced``: octets need the time of a real wire (None: depends on the kind of port). ``event_char``, ``rs485``: see
    :class:`dpstack.ports.tuning.Tuning`; they matter for a Linux tty only. ``listen``: the port is opened only for
    listening, see :class:`dpstack.ports.tty.TtyPort`. Raises PortError for a name of no port.
    """
    if isinstance(name, Port):
        return name
    scheme, separator, _rest = name.partition("://")
    if separator:
        return _by_url(scheme, name, baud, paced, listen)
    if not name:
        raise PortError("no port given: write a device (/dev/ttyUSB0), socket://host:port, rfc2217://host:port or pty")
    if sys.platform == "linux":
        from dpstack.ports import termios2  # these need modules that other systems do not have

        if name == "pty":
            from dpstack.ports.pty import PtyPort

            return PtyPort(baud, paced=bool(paced))
        if termios2.AVAILABLE:
            from dpstack.ports.tty import TtyPort

            return TtyPort(name, baud, paced=paced, event_char=event_char, rs485=rs485, listen=listen)
    if name == "pty":
        raise PortError("--port pty needs Linux; name a serial port, socket://host:port or rfc2217://host:port")
    from dpstack.ports.posix import importing_pyserial

    with importing_pyserial(name):
        from dpstack.ports.pyserial import PySerialPort

    return PySerialPort(name, baud, paced=paced is not False, listen=listen)


def _by_url(scheme: str, name: str, baud: int, paced: bool | None, listen: bool) -> Port:
    if scheme == "socket":
        from dpstack.ports.tcp import SocketPort

        return SocketPort(name, baud, paced=bool(paced))
    if scheme == "rfc2217":
        from dpstack.ports.posix import importing_pyserial

        with importing_pyserial(name):
            from dpstack.ports.rfc2217 import Rfc2217Port

        return Rfc2217Port(name, baud, paced=paced is not False, listen=listen)
    raise PortError(f"{name}: ports are /dev/..., socket://host:port, rfc2217://host:port, pty (not {scheme}://)")
