"""Events of the link layer: the token ring, stations that come and go, requests that fit into no cycle."""

from __future__ import annotations

from typing import Final

from dpstack.fdl.telegram import StationType
from dpstack.trace import Event, Notice, Severity
from dpstack.units import ms_text

#: a request that is too long for every time window between two cycles waits for this number of cycles; then the station
#: sends it, and at most one such request in this number of cycles
HELD_BACK_CYCLES: Final = 8


class RingJoined(Event):
    """This station holds its first token: it claimed the token on a silent bus, or another master passed it."""

    #: address of this station
    address: int
    #: True: this station made the token itself
    claimed: bool
    #: addresses of the masters in the ring, with this one
    masters: tuple[int, ...]

    def _text(self) -> str:
        how = "claimed the token on a silent bus" if self.claimed else "was given the token"
        others = [str(m) for m in self.masters if m != self.address]
        return f"station {self.address} {how}" + (f"; other masters: {', '.join(others)}" if others else "")


class RingLeft(Event):
    """This station is no longer in the ring."""

    #: address of this station
    address: int
    #: why it left, for people
    reason: str

    TEMPLATE = "station {e.address} left the token ring: {e.reason}"


class MasterSeen(Event):
    """Another master joined or left the list of active stations (LAS)."""

    #: station address of the other master, 0..126
    address: int
    #: True: it joined; False: it left
    present: bool
    #: the master was in the ring before this station, so the time of its joining is unknown
    before: bool = False

    def _text(self) -> str:
        if self.present and self.before:
            return f"master {self.address} is in the token ring"
        return f"master {self.address} {'joined' if self.present else 'left'} the token ring"


class AddressCollision(Event):
    """Another station sends with this station's address."""

    SEVERITY = Severity.ERROR

    #: address of this station, which the other one uses, too
    address: int

    TEMPLATE = (
        "another station on the bus sends as address {e.address}: staying out of the ring; "
        "give one of the two another address"
    )


class TokenLost(Event):
    """The bus was silent for T_TO; this station claims the token."""

    SEVERITY = Severity.WARNING

    #: address of this station
    address: int

    TEMPLATE = "station {e.address}: no token for T_TO, claiming it"


class StationFound(Event):
    """A new station answered a poll, or a known station no longer answers (kind None)."""

    #: station address, 0..126
    address: int
    #: type of the station; None: it no longer answers
    kind: StationType | None

    def _text(self) -> str:
        if self.kind is None:
            return f"station {self.address} no longer answers"
        return f"station {self.address} found: {self.kind.text}"


def le3_notice(source: str, sender: int, now: int) -> Notice:
    """Notice about a ``sender`` of SD2 telegrams with LE = 3; the caller reports it once for each sender."""
    message = (
        f"station {sender} sends SD2 telegrams without a data unit (LE = 3), which no standard knows; "
        "they are taken as empty"
    )
    return Notice(t_ns=now, source=source, message=message, severity=Severity.WARNING)


class DoesNotFit(Event):
    """A request that fits between no two cycles is sent after its wait; reported once for each service."""

    SEVERITY = Severity.WARNING

    #: name of the service
    service: str
    #: station address of the request, 0..126
    address: int
    #: longest duration of the request, in ns
    takes_ns: int
    #: slack of the port in each of its slot times, in ns
    slack_ns: int

    def _text(self) -> str:
        slack = f", {ms_text(self.slack_ns)} for a late port in each attempt" if self.slack_ns else ""
        less = "a longer cycle_ms or a smaller host_slack_ms" if self.slack_ns else "a longer cycle_ms"
        return (
            f"{self.service} to station {self.address} fits between no two cycles: it can take "
            f"{ms_text(self.takes_ns)} (silence and repetitions{slack}); such requests go out in every "
            f"{HELD_BACK_CYCLES}th cycle at most, and the next one may begin late; {less} makes room"
        )
