"""Capture files judged by a monitor: the first port, gaps and remarks."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Final

from dpstack.capture.pcapng import Interface
from dpstack.capture.recording import GAP
from dpstack.capture.timing import LineTiming
from dpstack.capture.transmission import Columns, Transmission
from dpstack.cli.listening.source_file import bus_by_jobs, bus_in
from dpstack.cli.terminal import output
from dpstack.decode.log_text import Unread
from dpstack.errors import CaptureFileError, UsageError
from dpstack.monitor.counters import SILENT_NS
from dpstack.monitor.exchanges import Batch, Exchanges
from dpstack.monitor.monitor import Monitor
from dpstack.units import AUTO, NS_PER_S

if TYPE_CHECKING:
    from dpstack.cli.listening.file_jobs import FileJobs

#: if nothing was captured for so long between two files, nobody listened: after this time a slave counts as silent
_APART_NS: Final = SILENT_NS


class JudgedFiles:
    """Has ``monitor`` judge the capture files ``names``, one after the other, as one; :meth:`read` reads them.

    ``on_unread``, ``baud``, ``channel`` and ``on_remark``: see :func:`~dpstack.cli.listening.source_file.bus_in`.
    ``add_all`` takes the transmissions (default: the monitor), ``on_start`` gets the first one, ``on_octets`` the name
    of a file and the number of its octets that were read. ``jobs``: processes that read pcapng files. ``is_over``:
    True if nobody wants the rest.
    """

    def __init__(
        self,
        names: Sequence[str],
        monitor: Monitor,
        *,
        on_unread: Callable[[Unread], None] | None = None,
        baud: int | str = AUTO,
        channel: str = "",
        add_all: Callable[[Batch], None] | None = None,
        on_start: Callable[[Transmission], None] = lambda first: None,
        on_octets: Callable[[str, int], None] = lambda name, octets: None,
        on_remark: Callable[[str], None] = output.warn,
        jobs: FileJobs | None = None,
        is_over: Callable[[], bool] = lambda: False,
    ) -> None:
        #: the port that is judged: the first one of the first file
        self.port: str | None = None
        #: of several files: why one of them could not be read, or not to its end
        self.damage: list[str] = []
        self._names = names
        self._monitor = monitor
        self._add_all = monitor.add_all if add_all is None else add_all
        self._on_unread = on_unread
        self._baud = baud
        self._channel = channel
        self._on_start = on_start
        self._on_octets = on_octets
        self._on_remark = on_remark
        self._jobs = jobs
        self._is_over = is_over
        self._last = ""  # the file before
        self._heard: Batch = ()  # its last transmissions
        self._whole = True  # it was read to its end

    def read(self, seconds: float | None = None) -> None:
        """Read the files, or so many seconds of them. Raises UsageError if the only one cannot be opened, and
        CaptureFileError after all that could be read of it; of several files :attr:`damage` says so."""
        batches = self._all()
        for batch in batches if seconds is None else _first(batches, int(seconds * NS_PER_S)):
            if self._is_over():
                return
            if isinstance(batch, (Columns, Exchanges)):
                self._add_all(batch)
                continue
            for one in batch:
                if one.note and one.t_ns is not None:  # without a time it is what stands before octets in a log
                    self._remark(one)
                self._add_all((one,))

    def _all(self) -> Iterator[Batch]:
        """The transmissions of all files."""
        for name in self._names:
            begun = False
            try:
                for batch in self._of(name):
                    if not begun:
                        begun = True
                        self._begin(name, next(iter(batch)))
                    self._heard = batch
                    yield batch
            except (CaptureFileError, UsageError) as error:
                if len(self._names) == 1:
                    raise
                self.damage.append(str(error))
                self._whole = False

    def _of(self, name: str) -> Iterator[Batch]:
        def on_octets(octets: int) -> None:
            self._on_octets(name, octets)

        if self._jobs is not None:
            return bus_by_jobs(self._jobs, name, self._interface, self.port, self._baud, self._on_remark, on_octets)
        return bus_in(
            name,
            self._interface,
            port=self.port,
            on_unread=self._on_unread,
            baud=self._baud,
            channel=self._channel,
            on_remark=self._on_remark,
            on_octets=on_octets,
        )

    def _begin(self, name: str, first: Transmission) -> None:
        """The file ``name`` begins with ``first``: octets may be missing between it and the one before."""
        last, self._last = self._last, name
        whole, self._whole = self._whole, True
        if not last:
            self._on_start(first)
            return
        t_ns, ended_ns = first.t_ns or 0, self._monitor.counters.ended_ns
        # not its end: behind a pty or an adapter a telegram may seem to begin before the one before it has ended
        if t_ns < (deque(self._heard, 1).pop().t_ns or 0):
            self._on_remark(f"{name} begins before {last} ends: telegrams of the time between count twice")
        elif not whole or t_ns - ended_ns >= _APART_NS:
            why = "nothing was captured" if whole else "a file is damaged or missing"
            between = f"between {os.path.basename(last)} and {os.path.basename(name)}"
            self._monitor.gap(t_ns, f"{why} {between}", since_ns=ended_ns)

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


def _first(batches: Iterator[Batch], limit_ns: int) -> Iterator[Batch]:
    """The transmissions of the first ``limit_ns``, and the one after them."""
    end = None
    for batch in batches:
        found = list(batch)
        begin = 0
        if end is None:
            end, begin = (found[0].t_ns or 0) + limit_ns, 1
        for number in range(begin, len(found)):
            if (found[number].t_ns or 0) >= end:
                yield found[: number + 1]
                return
        yield batch
