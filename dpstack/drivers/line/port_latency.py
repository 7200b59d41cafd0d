"""Latency of a port: how late the first octets after a transmission arrive, and the patience derived from it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dpstack.phy.patience import ADAPTER, FIRST, HOST, Patience, measured
from dpstack.ports import Delivery, Port
from dpstack.stats import Histogram

#: Called with the derived patience and the time in ns.
Tune = Callable[[Patience, int], None]
#: The patience is derived from p99.9 of :data:`FIRST` answers, and anew after every 10000.
_EVERY: Final = 10_000


def patience_of(port: Port) -> Patience:
    """The patience for the kind of a port, used until it is measured."""
    return ADAPTER if port.delivery is Delivery.ADAPTER else HOST


class PortLatency:
    """Histogram of latencies in ns; with ``tune`` it also derives the patience.

    A latency is the time from the last bit of a transmission to the delivery of the octets after it, less the time of
    these on the wire: the sum of host, adapter and the answering station's T_SDR. Only answers count.
    """

    __slots__ = ("_due", "_tune", "histogram", "patience", "sent_at")

    def __init__(self, tune: Tune | None = None) -> None:
        self.histogram = Histogram()
        self.patience: Patience | None = None
        #: end of the transmission without octets after it, 0 for none
        self.sent_at = 0
        self._tune = tune
        self._due = FIRST

    def add_answer(self, sent_at: int, wire_ns: int, now: int) -> None:
        """The port delivered octets of duration ``wire_ns`` at ``now``, after a transmission that ended at ``sent_at``.

        The caller sets the attribute ``sent_at`` to 0 when they arrive, and may call this after its next request.
        """
        histogram = self.histogram
        histogram.add(now - sent_at - wire_ns)
        if self._tune is not None and histogram.count >= self._due:
            self._due = histogram.count + _EVERY
            patience = measured(histogram.quantile_ns(0.999))
            if patience != self.patience:
                self.patience = patience
                self._tune(patience, now)
