"""A capture file judged by a monitor: its first port, its gaps and remarks."""

from __future__ import annotations

from collections.abc import Callable

from dpstack.capture.pcapng import Interface
from dpstack.capture.recording import GAP
from dpstack.capture.timing import LineTiming
from dpstack.capture.transmission import Transmission
from dpstack.cli.listening.source_file import bus_in
from dpstack.cli.terminal import output
from dpstack.decode.log_text import Unread
from dpstack.monitor.monitor import Monitor
from dpstack.units import AUTO, NS_PER_S


class JudgedFile:
    """Has ``monitor`` judge the capture file ``name``; :meth:`read` reads it.

    ``on_unread``, ``baud``, ``channel`` and ``on_remark``: see :func:`~dpstack.cli.listening.source_file.bus_in`.
    ``add`` takes the transmissions (default: those of the monitor), ``on_start`` gets the first one.
    """

    def __init__(
        self,
        name: str,
        monitor: Monitor,
        *,
        on_unread: Callable[[Unread], None] | None = None,
        baud: int | str = AUTO,
        channel: str = "",
        add: Callable[[Transmission], None] | None = None,
        on_start: Callable[[Transmission], None] = lambda first: None,
        on_remark: Callable[[str], None] = output.warn,
    ) -> None:
        #: the port that is judged: the first one of the file
        self.port: str | None = None
        self._monitor = monitor
        self._add = monitor.add if add is None else add
        self._on_start = on_start
        self._transmissions = bus_in(
            name, self._interface, on_unread=on_unread, baud=baud, channel=channel, on_remark=on_remark
        )

    def read(self, seconds: float | None = None) -> None:
        """Read the file, or so many seconds of it. Raises UsageError if it cannot be opened, CaptureFileError after
        all that could be read."""
        end = None
        for number, one in enumerate(self._transmissions):
            if not number:
                self._on_start(one)
                end = None if seconds is None else (one.t_ns or 0) + int(seconds * NS_PER_S)
            if one.note and one.t_ns is not None:  # without a time it is what stands before octets in a log
                self._remark(one)
            self._add(one)
            if number and end is not None and (one.t_ns or 0) >= end:
                return

    def _remark(self, one: Transmission) -> None:
        """The comment of a transmission: a gap before it, as ``dpstack capture`` writes it, or a remark."""
        monitor, t_ns = self._monitor, one.t_ns or 0
        _, gap, cause = f"; {one.note}".partition(f"; {GAP}")
        if gap:
            monitor.gap(t_ns, cause.partition("; damaged: ")[0], since_ns=monitor.counters.ended_ns)
        elif not one.damage:
            monitor.remark(t_ns, one.note)

    def _interface(self, interface: Interface) -> None:
        self.port = interface.name
        self._monitor.timing = LineTiming.parse(interface.description)
