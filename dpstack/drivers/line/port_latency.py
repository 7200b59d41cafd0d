"""What a port costs: how late the first octets after a transmission arrive, and the patience that follows from it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dpstack.phy.patience import ADAPTER, HOST, Patience, measured
from dpstack.ports import Delivery, Port
from dpstack.stats import Histogram

#: Takes the patience that was derived, and the time in ns.
Tune = Callable[[Patience, int], None]
#: p99.9 of fewer answers says nothing; then the patience is derived anew from time to time.
FIRST: Final = 1_000
_EVERY: Final = 10_000


def patience_of(port: Port) -> Patience:
    """The patience a port's kind needs until it was measured."""
    return ADAPTER if port.delivery is Delivery.ADAPTER else HOST


class Lateness:
    """Counts always; with ``tune`` it also derives the patience. Durations in ns.

    Counted is the time from the last bit of a transmission to the delivery of what follows, less the time that took on
    the wire: host, adapter, and the T_SDR of who answers. Who does not answer is not counted: the next transmission
    takes the place of the one before.
    """

    __slots__ = ("_due", "_tune", "histogram", "patience", "sent_at")

    def __init__(self, tune: Tune | None = None) -> None:
        self.histogram = Histogram()
        #: what was derived last
        self.patience: Patience | None = None
        #: the end of the transmission that nothing has followed yet, 0 for none
        self.sent_at = 0
        self._tune = tune
        self._due = FIRST

    def heard(self, sent_at: int, wire_ns: int, now: int) -> None:
        """Octets that took ``wire_ns`` on the wire were delivered at ``now``, after the transmission of ``sent_at``.

        It can wait until the next request is out: the caller takes ``sent_at`` and sets it to 0 when they arrive.
        """
        histogram = self.histogram
        histogram.add(now - sent_at - wire_ns)
        if self._tune is not None and histogram.count >= self._due:
            self._due = histogram.count + _EVERY
            patience = measured(histogram.quantile_ns(0.999))
            if patience != self.patience:
                self.patience = patience
                self._tune(patience, now)
