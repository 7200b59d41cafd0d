"""Patience: the slack added to a deadline for octets that a port delivers late, by kind of port and station.

The station adds slack to deadlines only, never to idle times. Each poll of a silent address takes longer by the slack.
With too little slack the master loses slaves when a virtual machine stalls for 10 to 30 ms. So a known station (in data
exchange, or in the token ring) gets ``known_ns``, an address that never answered gets ``unknown_ns``. Polls of a
master's absent slaves may take 1/``unknown_divisor`` of the bus time.

GAP polls have a share of their own, else a few absent slaves would keep every other master out of the ring. A new
master waits until the GAP polls have gone once through all addresses. So the share is set such that this pass takes
3 s, within 1 % to 10 % of the bus time. Measured on a pty (HSA 126, 187.5 kbit/s, 2.6 ms a silent poll): with 1 % a
second master waited 22 to 32 s, with 10 % it waits 3.3 s. On an adapter not yet measured 1 % means 4 minutes, 10 %
means 26 s. Hardware masters use more: they send a GAP poll in every rotation. GAP polls do not change the median
rotation time. In a ring each master polls its own part of the addresses, so all masters together use little more than
one master alone.
"""

from __future__ import annotations

from typing import Final

from msgspec import Struct
from msgspec.structs import replace

from dpstack.params import BusParams
from dpstack.units import BITS_PER_CHAR, NS_PER_MS, NS_PER_S

#: the station polls every silent address of the GAP once in this time, ...
_GAP_PASS_NS: Final = 3 * NS_PER_S
#: ... but GAP polls take at most 1/10 of the bus time
_GAP_DIVISOR: Final = 10


#: p99.9 is taken of at least this many answers
FIRST: Final = 1_000


class Lateness(Struct, frozen=True):
    """How late a port sends and delivers in 999 of 1000 cases: host and adapter both ways, and T_SDR of the station.

    ``answers``: the number of answers that it was measured of; 0: not measured, the value is that of the kind of port.
    """

    p999_ns: int = 0
    answers: int = 0


class Patience(Struct, frozen=True, kw_only=True):
    """Slack in ns added to deadlines. The default is none: virtual time, where octets arrive exactly."""

    known_ns: int = 0
    unknown_ns: int = 0
    #: polls of absent slaves may take 1/unknown_divisor of the bus time, GAP polls that or more (see gap_divisor);
    #: 0 = no limit
    unknown_divisor: int = 0
    #: added to the stall time of a telegram that arrives in pieces
    stall_ns: int = 0
    #: longest delay between the write and the octets on the wire. The idle time after a telegram without answer counts
    #: from the latest possible end of that telegram, else the next one would follow without a pause
    sending_ns: int = 0

    def silent_ns(self, params: BusParams) -> int:
        """Time-out in ns of a poll of an address that never answered.

        T_SL ends with the first bit of the answer, but a port delivers the whole octet: one character time more.
        """
        return params.ns(params.t_sl + BITS_PER_CHAR) + self.unknown_ns

    def gap_divisor(self, polls: int, cost_ns: int) -> int:
        """GAP polls may take 1/divisor of the bus time; 0 = no limit.

        A pass over the GAP is ``polls`` silent polls of ``cost_ns`` each. The divisor makes a pass take 3 s, within 10
        (a tenth of the bus) and ``unknown_divisor``.
        """
        if not self.unknown_divisor:
            return 0
        for_pass_time = _GAP_PASS_NS // max(1, polls * cost_ns)
        return min(max(for_pass_time, _GAP_DIVISOR), max(self.unknown_divisor, _GAP_DIVISOR))


#: Patience for virtual time and ports that deliver octets without delay.
EXACT: Final = Patience()

#: Patience for ptys, sockets and other ports whose other end is a process of a host that stalls (measured 10..30 ms).
HOST: Final = Patience(known_ns=50 * NS_PER_MS, unknown_ns=2 * NS_PER_MS, unknown_divisor=100, stall_ns=50 * NS_PER_MS)

#: Patience for a USB adapter before it is measured: three frames of 1 ms each way, and 16 ms for a latency timer that
#: nobody has set.
ADAPTER: Final = Patience(
    known_ns=60 * NS_PER_MS,
    unknown_ns=20 * NS_PER_MS,
    unknown_divisor=100,
    stall_ns=20 * NS_PER_MS,
    sending_ns=NS_PER_MS,
)

#: Minimum for a measured adapter: the master keeps its slaves when a driver sets the latency timer back to 16 ms.
_LEAST_KNOWN_NS: Final = 20 * NS_PER_MS
_LEAST_UNKNOWN_NS: Final = 2 * NS_PER_MS


def measured(p999_ns: int) -> Patience:
    """Patience for an adapter whose answers are ``p999_ns`` late in 999 of 1000 cases.

    Known stations get three times ``p999_ns``, addresses that never answered get ``p999_ns``; at most the values of
    :data:`ADAPTER`, because the slaves' watchdogs were calculated with them.
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
        known_ns=known_ns, unknown_ns=known_ns, unknown_divisor=100, stall_ns=known_ns, sending_ns=port.sending_ns
    )
