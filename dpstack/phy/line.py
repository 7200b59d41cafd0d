"""Silence on the line as one station knows it, and the idle times after which it may send.

Silence counts from the end of the last activity that this station knows: received octets or its own transmission. Over
USB or a pty neither the 33-bit pause nor gaps between characters are visible, so octets that are delivered late make
the wait longer, never shorter.
"""

from __future__ import annotations

from dpstack.params import BusParams
from dpstack.units import BITS_PER_CHAR


class Line:
    """Silence and idle times of one station in ns, converted once from the bus parameters."""

    def __init__(self, params: BusParams, now: int = 0) -> None:
        #: end of the last known activity: the line has been silent since then
        self.idle_since = now
        self.set_params(params)

    def set_params(self, params: BusParams) -> None:
        """Convert the times of ``params`` (also after a change of the baud rate)."""
        self._baud = params.baud
        self.t_id1_ns = params.ns(params.t_id1)
        self.t_id2_ns = params.ns(params.t_id2)
        self.t_sl_ns = params.ns(params.t_sl)
        self.t_sdr_ns = params.ns(params.min_tsdr)
        self.t_to_ns = params.ns(params.t_to)
        # IEC 61158 permits no pause between characters; ports deliver late and in pieces, so a telegram counts as
        # stalled only after the pause that would end it (T_SYN = 33 bits = three characters).
        self.t_stall_ns = params.ns(3 * BITS_PER_CHAR)

    def note_activity(self, now: int) -> None:
        """Silence begins anew: octets or an edge were on the line until ``now``."""
        if now > self.idle_since:
            self.idle_since = now
