"""Measurement of an adapter without a bus (``dpstack doctor --measure``): turn-around, rates, marks of damaged octets.

Only a loop may be connected: the port hears what it sends (echo, or transmitter and receiver joined), or a second port
of this computer is at the other end of the line. No octet that is sent begins a telegram.
"""

from __future__ import annotations

import contextlib
import os
import platform
import select
import sys
import time
from typing import Final

from dpstack.errors import BaudError, PortError, UsageError
from dpstack.ports import termios2
from dpstack.ports.sysfs import CHIPS, Adapter
from dpstack.ports.tty import TtyPort
from dpstack.stats import Histogram
from dpstack.units import BAUD_RATES, BITS_PER_CHAR, NS_PER_S, NS_PER_US

#: start delimiters of FDL telegrams and the short acknowledgement; FF, which ttys double where they mark octets
_NEVER_SENT: Final = frozenset(bytes.fromhex("10 68 A2 DC E5 FF"))
_OCTETS: Final = bytes(octet for octet in range(256) if octet not in _NEVER_SENT)
#: a turn-around is measured with this many octets: a Data_Exchange with 12 octets of data
_SHORT: Final = 21
#: two blocks whose times differ by this long on the line show the rate that is made
_BLOCK_NS: Final = NS_PER_S // 4
_ROUNDS: Final = 1_000
#: a loop that gives nothing back within this time, and the time of a whole block, is no loop
_LOST_S: Final = 0.25
#: before anything is sent, the line is listened to for this long at each of these rates
_LISTEN_S: Final = 0.3
_LISTEN_RATES: Final = (9_600, 187_500, 1_500_000)


def measure(
    path: str, loop: str | None, *, rounds: int = _ROUNDS, rates: tuple[int, ...] = tuple(BAUD_RATES)
) -> dict[str, object]:
    """Measure the adapter at ``path``. ``loop``: the path of the port at the other end of the line; "": the port hears
    what it sends; None: nothing is sent, and only the rates that the port takes are found.

    Linux only. Raises PortError; UsageError if octets come on the line, which is no loop then.
    """
    if sys.platform != "linux" or not termios2.AVAILABLE:
        raise PortError(f"{path}: an adapter is measured on Linux only")
    adapter = Adapter(path)
    chip = CHIPS.get(adapter.usb or "", ("", 0))[0]
    found: dict[str, object] = {
        "port": path,
        "chip": chip,
        "usb": adapter.usb,
        "driver": adapter.driver,
        "linux": platform.release(),
        "loop": {None: None, "": "echo"}.get(loop, loop),
        "rounds": rounds if loop is not None else 0,
        "latency_ms": None,
        "rates": [],
        "refused": {},
        "marks": None,
    }
    if loop is not None:
        for rate in _LISTEN_RATES:
            _refuse_a_bus(path, rate)
    taken: list[dict[str, object]] = []
    refused: dict[str, str] = {}
    for rate in rates:
        with contextlib.ExitStack() as open_ports:
            try:
                near = _opened(path, rate, open_ports)
                far = near if not loop else _opened(loop, rate, open_ports)
            except BaudError as error:
                refused[str(rate)] = str(error)
                continue
            found["latency_ms"] = Adapter(path).latency_ms()
            taken.append({"baud": rate} if loop is None else _at_rate(near, far, rate, rounds))
            if loop and found["marks"] is None:
                found["marks"] = _marks(near, far)
    return {**found, "rates": taken, "refused": refused}


def _opened(path: str, rate: int, open_ports: contextlib.ExitStack) -> TtyPort:
    port = TtyPort(path, rate)
    port.open_now()
    open_ports.callback(port.close)
    return port


def _refuse_a_bus(path: str, rate: int) -> None:
    """Raises UsageError if octets come without being asked for."""
    port = TtyPort(path, rate, listen=True)
    try:
        port.open_now()
        time.sleep(_LISTEN_S)
        heard = len(port.read_now())
    except BaudError:
        return
    finally:
        port.close()
    if heard:
        what = f"{heard} octets came although nothing was sent"
        raise UsageError(f"{path}: {what}: this is a bus, and nothing is sent on it")


def _at_rate(near: TtyPort, far: TtyPort, rate: int, rounds: int) -> dict[str, object]:
    """Turn-around and the rate that is made. ``far``: the same port for an echo."""
    times, lost = Histogram(), 0
    octets = _OCTETS[:_SHORT]
    for _ in range(rounds):
        passed = _round(near, far, octets)
        if passed is None:
            lost += 1
            if lost > 3 and not times.count:
                break
        else:
            times.add(passed)
    quantiles = (("p50", 0.5), ("p99", 0.99), ("p999", 0.999))
    summary = {name: round(times.quantile_ns(q) / NS_PER_US) for name, q in quantiles}
    return {
        "baud": rate,
        "turn_around_us": summary if times.count else None,
        "lost": lost,
        "octets_per_s": _made(near, far, rate) if times.count else None,
        "wanted_octets_per_s": round(rate / BITS_PER_CHAR),
    }


def _made(near: TtyPort, far: TtyPort, rate: int) -> int | None:
    """Octets a second on the line: the time of a long block less that of a short one, the shortest of three each."""
    long = max(2 * _SHORT, _BLOCK_NS * rate // BITS_PER_CHAR // NS_PER_S)
    block = (_OCTETS * (long // len(_OCTETS) + 1))[:long]
    # one way only: the second port would send the block back, and count it twice
    times = [[_sent(near, far, octets) for _ in range(3)] for octets in (block, block[:_SHORT])]
    if any(passed is None for one in times for passed in one):
        return None
    shortest = [min(passed for passed in one if passed is not None) for one in times]
    return round((long - _SHORT) * NS_PER_S / max(1, shortest[0] - shortest[1]))


def _round(near: TtyPort, far: TtyPort, octets: bytes) -> int | None:
    """The time until ``octets`` are back; the second port sends them back."""
    begun = time.monotonic_ns()
    if _sent(near, far, octets) is None:
        return None
    if far is not near and _sent(far, near, octets) is None:
        return None
    return time.monotonic_ns() - begun


def _sent(sender: TtyPort, receiver: TtyPort, octets: bytes) -> int | None:
    """Send ``octets``; the time in ns until all have arrived at ``receiver``, None if some are missing."""
    assert sender.fd is not None
    assert receiver.fd is not None
    begun = time.monotonic_ns()
    end = begun + round(_LOST_S * NS_PER_S) + 2 * len(octets) * BITS_PER_CHAR * NS_PER_S // sender.baud
    rest, arrived = memoryview(octets), 0
    while arrived < len(octets):
        left_s = (end - time.monotonic_ns()) / NS_PER_S
        if left_s <= 0:
            receiver.read_now()
            return None
        readable, writable, _ = select.select([receiver.fd], [sender.fd] if rest else [], [], left_s)
        if writable:
            with contextlib.suppress(BlockingIOError):
                rest = rest[os.write(sender.fd, rest) :]
        if readable:
            arrived += len(receiver.read_now())
    return time.monotonic_ns() - begun


def _marks(near: TtyPort, far: TtyPort) -> dict[str, object]:
    """The second port sends with odd parity: each octet has a parity error for the first one."""
    assert far.fd is not None
    before = near.damage()
    termios2.set_odd_parity(far.fd, True)
    time.sleep(0.05)
    near.read_now()
    os.write(far.fd, _OCTETS[:_SHORT])
    time.sleep(_LOST_S)
    passed = len(near.read_now())
    termios2.set_odd_parity(far.fd, False)
    after = near.damage()
    counted = {cause: count - before.get(cause, 0) for cause, count in after.items() if count != before.get(cause, 0)}
    return {"sent": _SHORT, "passed_as_good": passed, "counted": counted}
