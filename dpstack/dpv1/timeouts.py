"""The time-outs and pauses of DP-V1 at both ends, in ns."""

from __future__ import annotations

from typing import Final

from dpstack.units import NS_PER_MS, NS_PER_S

#: time-out of a service from the order to its end, other services before it included; the caller may give another one
SERVICE_TIMEOUT: Final = 10 * NS_PER_S
#: how long a slave works at a service at most, if its GSD file has no C1_Response_Timeout or C2_Response_Timeout
RESPONSE_TIMEOUT: Final = NS_PER_S
#: a service that takes the slave all its time has this much more
_MARGIN: Final = NS_PER_S

#: polls that follow one another in each token hold; these pauses come before the later ones, the last pause for ever
_EAGER: Final = 4
_PAUSES: Final = (NS_PER_MS, 2 * NS_PER_MS, 5 * NS_PER_MS, 10 * NS_PER_MS)

#: the shortest send time-out of a class 2 connection by rate in bit/s: what slave chips keep to, slower ones the last
#: (docs/reference/protocol.md#initiate)
_SEND_TIMEOUTS: Final = {1_500_000: NS_PER_S, 500_000: 2 * NS_PER_S, 0: 4 * NS_PER_S}

#: a master sends Idle over a connection that was quiet for this share of its send time-out: a slave waits twice the
#: whole for a request (VPC3+), so two may be lost
QUIET_SHARE: Final = 3
#: a slave that works at a service answers Idle to the first poll after this share of it
WORKING_SHARE: Final = 2
#: send time-outs that a slave waits for a request (VPC3+); while it has something to be fetched it waits for one
PATIENCE: Final = 2


def service_timeout(response_ns: int) -> int:
    """From the order to the end of a service unless the caller gives another time, and the slave may work at it for
    ``response_ns`` (0: not known)."""
    return max(SERVICE_TIMEOUT, response_ns + _MARGIN)


def pause_before(polls: int) -> int:
    """Before the next poll for an answer, after ``polls`` of them."""
    return 0 if polls < _EAGER else _PAUSES[min(polls - _EAGER, len(_PAUSES) - 1)]


def least_send_timeout(baud: int) -> int:
    """The shortest send time-out at ``baud`` bit/s: what a slave keeps to, and what a master asks for."""
    return next(timeout for least, timeout in _SEND_TIMEOUTS.items() if baud >= least)
