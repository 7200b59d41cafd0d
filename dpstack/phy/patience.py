"""Patience by consequence: how much later than the wire's deadline a port may deliver, and for whom we wait.

Host slack enters deadlines only, never minimum gaps. It is paid for every silent address, and too little of it loses
slaves when a virtual machine stalls 10 to 30 ms: so a station whose silence has consequences (in data exchange, or
just given the token) is given ``known_ns``, an address that never answered ``unknown_ns``. Silent polls of the latter
take at most 1/``unknown_share`` of the bus time for the GAP, and as much for a master's absent slaves: one account for
both would let a few absent slaves keep every other master out of the ring.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from dpstack.units import NS_PER_MS


@dataclass(frozen=True, slots=True, kw_only=True)
class Patience:
    """Slack in ns added to deadlines. The default is none: virtual time, where everything arrives exactly."""

    known_ns: int = 0
    unknown_ns: int = 0
    #: silent polls of addresses that never answered may take 1/unknown_share of the bus time (see above); 0 = no limit
    unknown_share: int = 0
    #: added to the stall time of a telegram that arrives in pieces
    stall_ns: int = 0
    #: what is given to the port may go on the wire so much later. The end of an own telegram that nobody answers is
    #: known no better, so idle times count from its latest: else the next one would follow without a pause
    sending_ns: int = 0


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
