"""Patience by consequence: how much later than the wire's deadline a port may deliver, and for whom we wait.

Host slack enters deadlines only, never minimum gaps. It is paid for every silent address, and too little of it loses
slaves when a virtual machine stalls 10 to 30 ms: so a station whose silence has consequences (in data exchange, or
just given the token) is given ``known_ns``, an address that never answered ``unknown_ns``. A master's absent slaves may
take 1/``unknown_share`` of the bus time in silence.

The GAP has an account of its own, else a few absent slaves would keep every other master out of the ring. It is counted
by the pass, because a pass is what a newcomer waits for: every silent address is asked about once in 3 s, for which the
GAP takes 1 % to 10 % of the bus. With 1 % alone a second master on a pty (HSA 126, 187.5 kbit/s, 2.6 ms a silent poll)
waited 22 to 32 s (measured), on an adapter not yet measured 4 minutes; 10 % means 3.3 s and 26 s. It is less than
hardware masters take, which poll in every rotation, and the median of the rotation does not show it. In a ring each
master asks its own part of the addresses, so all of them together take little more than one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from dpstack.params import BusParams
from dpstack.units import BITS_PER_CHAR, NS_PER_MS, NS_PER_S

#: every silent address of the GAP is asked about so often, ...
_GAP_PASS_NS: Final = 3 * NS_PER_S
#: ... for which 1/10 of the bus time is the most
_GAP_SHARE: Final = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class Patience:
    """Slack in ns added to deadlines. The default is none: virtual time, where everything arrives exactly."""

    known_ns: int = 0
    unknown_ns: int = 0
    #: silent polls of absent slaves may take 1/unknown_share of the bus time; the GAP has that at least (see above).
    #: 0 = no limit
    unknown_share: int = 0
    #: added to the stall time of a telegram that arrives in pieces
    stall_ns: int = 0
    #: what is given to the port may go on the wire so much later. The end of an own telegram that nobody answers is
    #: known no better, so idle times count from its latest: else the next one would follow without a pause
    sending_ns: int = 0

    def silent_ns(self, params: BusParams) -> int:
        """How long a poll of an address that never answered waits. Ports show octets at their end, hence one more."""
        return params.ns(params.t_sl + BITS_PER_CHAR) + self.unknown_ns

    def gap_share(self, polls: int, cost_ns: int) -> int:
        """Silent GAP polls may take 1/this of the bus time where a pass has ``polls`` of ``cost_ns``; 0 = no limit."""
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

#: The least that a measured adapter is given: one whose 16 ms timer comes back does not lose its slaves.
_LEAST_KNOWN_NS: Final = 20 * NS_PER_MS
_LEAST_UNKNOWN_NS: Final = 2 * NS_PER_MS


def measured(p999_ns: int) -> Patience:
    """Patience for an adapter whose answers are ``p999_ns`` late in 999 of 1000 cases.

    Three times that for stations that matter, once for addresses that never answered; never more than before it was
    measured, because the slaves' watchdogs were told that.
    """
    return replace(
        ADAPTER,
        known_ns=min(max(3 * p999_ns, _LEAST_KNOWN_NS), ADAPTER.known_ns),
        unknown_ns=min(max(p999_ns, _LEAST_UNKNOWN_NS), ADAPTER.unknown_ns),
    )


def slack(known_ns: int, port: Patience = EXACT) -> Patience:
    """Patience from the user's ``host_slack_ms``: the same for everyone, silent polls still bounded.

    When the port really sends is not the user's to say: that is taken from ``port``, the patience of its kind.
    """
    return Patience(
        known_ns=known_ns, unknown_ns=known_ns, unknown_share=100, stall_ns=known_ns, sending_ns=port.sending_ns
    )
