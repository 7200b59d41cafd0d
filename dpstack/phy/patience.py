"""Patience: the slack added to a deadline for octets that a port delivers late, by kind of port and station.

Host slack is added to deadlines only, never to idle times. Every silent address costs it, and too little of it loses
slaves when a virtual machine stalls for 10 to 30 ms. So a station whose silence has consequences (in data exchange, or
with the token) gets ``known_ns``, an address that never answered ``unknown_ns``. Polls of a master's absent slaves may
take 1/``unknown_share`` of the bus time.

The GAP has a share of its own, else a few absent slaves would keep every other master out of the ring. It is counted
by the pass, because a new master waits for a pass: every silent address is polled once in 3 s, for which the GAP takes
1 % to 10 % of the bus. With 1 % alone a second master on a pty (HSA 126, 187.5 kbit/s, 2.6 ms a silent poll)
waited 22 to 32 s (measured), on an adapter not yet measured 4 minutes; 10 % means 3.3 s and 26 s. It is less than
hardware masters take, which poll in every rotation, and the median of the rotation does not show it. In a ring each
master asks its own part of the addresses, so all of them together take little more than one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from dpstack.params import BusParams
from dpstack.units import BITS_PER_CHAR, NS_PER_MS, NS_PER_S

#: every silent address of the GAP is polled once in this time, ...
_GAP_PASS_NS: Final = 3 * NS_PER_S
#: ... for which the GAP takes 1/10 of the bus time at most
_GAP_SHARE: Final = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class Patience:
    """Slack in ns added to deadlines. The default is none: virtual time, where octets arrive exactly."""

    known_ns: int = 0
    unknown_ns: int = 0
    #: polls of absent slaves may take 1/unknown_share of the bus time, the GAP at least as much; 0 = no limit
    unknown_share: int = 0
    #: added to the stall time of a telegram that arrives in pieces
    stall_ns: int = 0
    #: the port may send octets so much later. Idle times after a telegram without answer count from its latest
    #: possible end, else the next telegram would follow without a pause
    sending_ns: int = 0

    def silent_ns(self, params: BusParams) -> int:
        """Time-out in ns of a poll of an address that never answered. Ports deliver an octet at its end: one more."""
        return params.ns(params.t_sl + BITS_PER_CHAR) + self.unknown_ns

    def gap_share(self, polls: int, cost_ns: int) -> int:
        """Divisor of the bus time for GAP polls where a pass has ``polls`` of ``cost_ns``; 0 = no limit."""
        if not self.unknown_share:
            return 0
        in_time = _GAP_PASS_NS // max(1, polls * cost_ns)
        return min(max(in_time, _GAP_SHARE), max(self.unknown_share, _GAP_SHARE))


#: Virtual time and ports that deliver exactly.
EXACT: Final = Patience()

#: ptys, sockets and everything else whose other end is a process of this kind of machine (measured stalls 10..30 ms).
HOST: Final = Patience(known_ns=50 * NS_PER_MS, unknown_ns=2 * NS_PER_MS, unknown_share=100, stall_ns=50 * NS_PER_MS)

#: A USB adapter before it was measured: three frames of 1 ms each way and the 16 ms of an untouched latency timer.
ADAPTER: Final = Patience(
    known_ns=60 * NS_PER_MS,
    unknown_ns=20 * NS_PER_MS,
    unknown_share=100,
    stall_ns=20 * NS_PER_MS,
    sending_ns=NS_PER_MS,
)

#: The least for a measured adapter: it keeps its slaves when its latency timer is 16 ms again.
_LEAST_KNOWN_NS: Final = 20 * NS_PER_MS
_LEAST_UNKNOWN_NS: Final = 2 * NS_PER_MS


def measured(p999_ns: int) -> Patience:
    """Patience for an adapter whose answers are ``p999_ns`` late in 999 of 1000 cases.

    Three times that for known stations, once for addresses that never answered; never more than :data:`ADAPTER`,
    because the slaves' watchdogs were set for that.
    """
    return replace(
        ADAPTER,
        known_ns=min(max(3 * p999_ns, _LEAST_KNOWN_NS), ADAPTER.known_ns),
        unknown_ns=min(max(p999_ns, _LEAST_UNKNOWN_NS), ADAPTER.unknown_ns),
    )


def slack(known_ns: int, port: Patience = EXACT) -> Patience:
    """Patience from the user's ``host_slack_ms``: the same for all stations, polls of absent slaves still limited.

    ``sending_ns`` belongs to the kind of port: it comes from ``port``.
    """
    return Patience(
        known_ns=known_ns, unknown_ns=known_ns, unknown_share=100, stall_ns=known_ns, sending_ns=port.sending_ns
    )
